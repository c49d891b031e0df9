"""Imported by the fork server: what a process needs for a trial, whatever the policy."""

from nw_eval.rollout.library import Library
from nw_eval.rollout.trial import run_trial

__all__ = ["Library", "run_trial"]
