"""Driving a round to its end: who is told, when it is enough, what is tried again."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from nw_eval.plural import plural

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.learn.student.collect.round import Round
    from nw_eval.rollout.result import TrialResult

_EVERY = 10.0
"""Seconds between two lines."""
_ATTEMPTS = 2
"""A worker that the system ended is not the policy's fault; one that fails twice is left out."""


class Driving:
    """The driving of one round's trajectories.

    Args:
        trajectories: of the round; those that there are already are not driven again.
        say: takes a line for people.
        most: bytes that the round may have: what comes after them in its order is not driven.
        workers: processes; one for each core if None.
    """

    def __init__(
        self,
        trajectories: Round,
        *,
        say: Callable[[str], None],
        most: int,
        workers: int | None = None,
    ) -> None:
        self._round = trajectories
        self._say = say
        self._most = most
        self._workers = workers
        self._failed: dict[str, str] = {}
        self._successes: list[float] = []
        self._began = self._spoke_at = time.monotonic()

    def run(self, is_ending: Callable[[], bool]) -> bool:
        """Drive what is missing; return whether that is done, or was ended before.

        Raises:
            TrialError: no workers can be had.
        """
        for _ in range(_ATTEMPTS):
            self._failed = {}
            for done in () if self._is_full else self._round.drive(self._workers):
                if is_ending():
                    return False
                if done is not None:
                    self._take(done[0].trial.id, done[1])
                    if self._is_full:
                        break
            if not self._failed:
                break
        for name, reason in self._failed.items():
            self._say(f"trajectory {name} is left out: {reason}")
        if self._successes:
            self._tell()
        return not is_ending()

    @property
    def _is_full(self) -> bool:
        """Whether the first trajectories of the round, without a hole, have all bytes."""
        total = 0
        for job in self._round.jobs:
            if job.mcap is None or not (job.mcap.exists() or job.trial.id in self._failed):
                break
            total += job.mcap.stat().st_size if job.mcap.exists() else 0
        return total >= self._most

    def _take(self, name: str, result: TrialResult) -> None:
        if result.status == "error":
            self._failed[name] = result.error_text
        else:
            self._successes.append(result.success)
        if time.monotonic() - self._spoke_at >= _EVERY:
            self._tell()

    def _tell(self) -> None:
        """Say how far it is."""
        self._spoke_at = time.monotonic()
        count, all_ = len(self._successes), len(self._round.jobs)
        minutes = max(self._spoke_at - self._began, 1e-3) / 60.0
        left = len(self._round.missing)
        trajectories = plural(all_, "trajectory", "trajectories")
        words = [
            f"round {self._round.number}: {all_ - left} of {trajectories} driven",
            f"{count / minutes:.0f} a minute",
        ]
        if count:
            words += [
                f"{left * minutes / count:.0f} min left",
                f"success {sum(self._successes) / count:.3f}",
            ]
        self._say(" · ".join(words))
