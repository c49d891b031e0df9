"""Imported by the nursery: what a process needs for a trial, whatever the policy.

Kernels are loaded too, if they have been compiled: a child has them at once.
"""

from nw_eval.rollout.library import Library
from nw_eval.rollout.trial import run_trial
from nw_eval.splat.warmup import is_warm, warmup

__all__ = ["WARM", "Library", "run_trial"]

WARM = is_warm()
"""Whether kernels are loaded. To compile them here would keep all children waiting."""

if WARM:
    warmup()
