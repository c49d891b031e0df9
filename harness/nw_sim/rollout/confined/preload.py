"""Imported by the fork server: what a process needs for a trial, whatever the policy."""

from nw_scenes.robots import BUILT_IN, get_robot
from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial

__all__ = ["ROBOTS", "Library", "run_trial"]

ROBOTS = tuple(get_robot(name) for name in BUILT_IN)
"""Read and compiled here, once: every child opens cards and scenes for one of them, or imports what
reads another."""
