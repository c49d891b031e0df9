"""Imported by the fork server: kernels that have been compiled: a child has them at once."""

from nw_sim.warmup import warm_kernels, warmup

__all__ = ["WARM"]

WARM = warm_kernels()
"""Which kernels are loaded. To compile others here would keep all children waiting."""

if WARM:
    warmup(kernels=WARM)
