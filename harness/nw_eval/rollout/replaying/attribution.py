"""Lets a baseline take over a failed trial at many moments, to find the last that it completes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from nw_eval.errors import StoreError
from nw_eval.rollout.library import Library
from nw_eval.rollout.mcap.messages import SimState
from nw_eval.rollout.prepare import OpenTrial, open_trial
from nw_eval.rollout.replaying.logged import read_logged_trial
from nw_eval.rollout.replaying.policy_switch import driver, lead, run_on
from nw_eval.rollout.replaying.reports import AttributionReport, Ending, Try
from nw_eval.rollout.replaying.takeover import second_job
from nw_eval.rollout.result import StageClock
from nw_eval.scores.own import is_code

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path
    from typing import Any

    from nw_eval.rollout.job import TrialJob

_MOST_KEPT = 256 * 2**20
"""Bytes of states that are kept; those of policies with stacked images have some 100 kB each."""
COARSE = 8
"""Intervals into which the moments are divided first."""


def attribute(
    path: Path,
    *,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    library: Library | None = None,
) -> AttributionReport:
    """Return from when on a recorded trial was lost to a baseline.

    The trial goes its recorded way once, the baseline looks on, and its states are kept; each try
    restores one of them and runs on. So it is what `take_over` gives at that moment, bit for bit.

    Args: as for `take_over`.

    Raises:
        StoreError, PolicyError, SceneError, UsageError, TrialError: as `take_over`.
    """
    library = library or Library()
    recorded = read_logged_trial(path)
    job = second_job(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    job = replace(job, mcap=None, scores=_looking_on(job))
    with open_trial(job, library, StageClock()) as trial:
        states, stride = _kept(lead(trial, recorded, library))
        if not states:
            raise StoreError(
                f"{path} does not say what was applied in its trial", fix="run the trial again"
            )
        limits = _limits(trial)
        tries: dict[int, Try] = {}

        def completes(step: int) -> bool:
            tries[step] = _tried(trial, states[step])
            return tries[step].completes

        order = search(sorted(states), completes)
    return AttributionReport(
        trial=job.trial.id,
        was=Ending.of(recorded.verdict, policy=driver(recorded.job), position=None),
        baseline=driver(job),
        tries=tuple(tries[step] for step in order),
        stride=stride,
        limits=limits,
    )


def _looking_on(job: TrialJob) -> tuple[str, ...]:
    """Return which scores look on: the trial's own, and the one that knows the robot's limits.

    A function of the suite does so only if its caller allows code.
    """
    if not job.scores:
        return ()
    allowed = (name for name in job.scores if job.allow_code or not is_code(name))
    return tuple(dict.fromkeys((*allowed, "limit_time")))


def _limits(trial: OpenTrial) -> dict[str, float]:
    """Return when limits were first passed in a trial until now, s, by score."""
    trial.episode.scores(None)  # Shows them the last steps.
    return trial.episode.limits_passed()


def _kept(states: Iterable[Any]) -> tuple[dict[int, bytes], int]:
    """Return states by control step, every n-th of them if all are too large, and n."""
    kept: dict[int, bytes] = {}
    stride, size = 1, 0
    for state in states:
        if state.step % stride:
            continue
        kept[state.step] = data = state.SerializeToString()
        size += len(data)
        while size > _MOST_KEPT:
            stride *= 2
            kept = {step: data for step, data in kept.items() if step % stride == 0}
            size = sum(map(len, kept.values()))
    return kept, stride


def _tried(trial: OpenTrial, state: bytes) -> Try:
    message = SimState.FromString(state)
    trial.episode.restore(message)
    result = run_on(trial)
    return Try(
        step=message.step,
        end=result.outcome or result.error_type or "",
        reason=result.end_reason or result.error_text,
        steps=result.steps,
        limits=_limits(trial),
    )


def search(moments: Sequence[int], holds: Callable[[int], bool]) -> dict[int, bool]:
    """Try some of many moments, so that the last one at which something holds is among them.

    First as many as divide all of them evenly, whatever comes of it; then by bisection between the
    last of these at which it holds and the next. It need not hold at all moments before: of what
    lies between two that were tried, nothing is known.

    Args:
        moments: in their order, at least one.
        holds: whether it does at a moment.

    Returns:
        What was tried, in the order of the moments, and whether it held.
    """
    last = len(moments) - 1
    grid = np.unique(np.linspace(0, last, COARSE + 1).round().astype(int)).tolist()
    tried = {place: holds(moments[place]) for place in grid}
    held = [place for place in grid if tried[place]]
    if held and held[-1] != last:
        low = held[-1]
        high = grid[grid.index(low) + 1]
        while high - low > 1:
            middle = (low + high) // 2
            tried[middle] = holds(moments[middle])
            low, high = (middle, high) if tried[middle] else (low, middle)
    return {moments[place]: tried[place] for place in sorted(tried)}


def most_tries(count: int) -> int:
    """Return how many of `count` moments `search` tries at most."""
    return min(count, COARSE + 1 + max(0, int(np.ceil(np.log2(max(1.0, count / COARSE))))))
