"""Imported by the fork server: what a process needs for a trial, whatever the policy."""

from nw_sim.rollout.library import Library
from nw_sim.rollout.trial import run_trial

__all__ = ["Library", "run_trial"]
