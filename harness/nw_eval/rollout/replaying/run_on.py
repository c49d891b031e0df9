"""Runs a trial from where it stands."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.rollout.fault import is_interrupt
from nw_eval.rollout.result import TrialResult
from nw_eval.rollout.trial import ended, failed

if TYPE_CHECKING:
    from nw_eval.rollout.episode import Observer
    from nw_eval.rollout.prepare import OpenTrial


def run_on(trial: OpenTrial, *observers: Observer) -> TrialResult:
    """Run a trial from where it stands to its end; whatever a policy throws is its result."""
    try:
        outcome = trial.episode.run(*observers)
    except BaseException as error:
        if is_interrupt(error):
            raise
        return failed(TrialResult.so_far(trial.episode), error)  # As in a run, it is the result.
    return ended(trial, outcome)
