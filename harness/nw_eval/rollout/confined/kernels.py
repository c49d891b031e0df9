"""Imported by the fork server: kernels, if they have been compiled: a child has them at once."""

from nw_eval.splat.warmup import is_warm, warmup

__all__ = ["WARM"]

WARM = is_warm()
"""Whether kernels are loaded. To compile them here would keep all children waiting."""

if WARM:
    warmup()
