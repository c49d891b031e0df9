"""One line every few seconds that says what a training does, how fast, and for how long still."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

EVERY = 10.0
"""Seconds between two lines."""


class TrainingProgress:
    """Says how far a training is. Clocks are for people: nothing here is learnt from.

    Args:
        say: takes a line.
        steps: of the whole training.
        first: steps that were done before.
        minutes: after which the process stops; None = never.
        what: what a step is, in the plural.
        every: seconds between two lines.
        clock: seconds, never going back.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        *,
        steps: int,
        first: int = 0,
        minutes: float | None = None,
        what: str = "steps",
        every: float = EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._say = say
        self._steps = steps
        self._what = what
        self._every = every
        self._clock = clock
        self._began = clock()
        self._deadline = None if minutes is None else self._began + 60.0 * minutes
        self._said_at, self._said_step = self._began, first
        self._has_spoken = False
        self._left_at, self._aside, self._times = self._began, 0.0, 0

    @property
    def is_time_up(self) -> bool:
        """Whether the minutes of the budget are over."""
        return self._deadline is not None and self._clock() >= self._deadline

    def leave(self) -> None:
        """Begin something else than steps."""
        self._left_at = self._clock()

    def back(self, step: int, *, times: int) -> None:
        """Go on with steps after `leave`; the same, as long again, is to come so many `times`."""
        now = self._clock()
        self._aside, self._times = max(self._aside, now - self._left_at), times
        self._said_at, self._said_step, self._has_spoken = now, step, True

    def update(self, step: int, doing: str, figures: Mapping[str, float]) -> None:
        """Take how far it is; say so if it is time.

        Args:
            step: steps done.
            doing: what it does now, such as the name of a phase.
            figures: the few numbers that matter.
        """
        now = self._clock()
        waited = now - self._said_at
        if waited < self._every and step < self._steps and self._has_spoken:
            return
        rate = (step - self._said_step) / max(waited, 1e-9)
        words = [f"{_number(step)} of {_number(self._steps)} {self._what}", doing]
        words.append(f"{_number(round(rate))}/s")
        if rate > 0:
            left = max(self._steps - step, 0) / rate + self._aside * self._times
            if self._deadline is not None:
                left = min(left, max(self._deadline - now, 0.0))
            words.append(f"{_duration(left)} left")
        words += [f"{name} {value:.3g}" for name, value in figures.items()]
        self._say(" · ".join(word for word in words if word))
        self._said_at, self._said_step, self._has_spoken = now, step, True


def _number(count: int) -> str:
    return f"{count / 1e6:.2f} M" if count >= 1_000_000 else f"{count:,}"


def _duration(seconds: float) -> str:
    minutes = seconds / 60.0
    if minutes < 1.5:
        return f"{seconds:.0f} s"
    return f"{minutes:.0f} min" if minutes < 120 else f"{minutes / 60:.1f} h"
