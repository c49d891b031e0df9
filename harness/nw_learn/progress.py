"""A training under way: what it says, when its state is written, and how far it came.

A line every few seconds says what it does, how fast, and for how long still. States are written and
signals are heeded after whole steps only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from nw_eval.engine.machine import Interrupts
from nw_learn.curve import Curve
from nw_learn.folder import State, TrainFolder

EVERY = 10.0
"""Seconds between two lines."""

SAVE_EVERY = 120.0
"""Seconds between two states on disk: the most that a SIGKILL costs."""


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


class Keeper:
    """Writes states as time goes by, checkpoints as steps do, and both when a signal comes.

    The first Ctrl-C or SIGTERM lets the step under way end, writes the state, and stops; the second
    ends at once.

    Args:
        folder: of the training.
        curve: that is written with each state.
        keep_every: steps from one kept checkpoint to the next.
        first: steps that were done before.
        save_every: seconds between two states.
        clock: seconds, never going back.
    """

    def __init__(
        self,
        folder: TrainFolder,
        curve: Curve,
        *,
        keep_every: int,
        first: int = 0,
        save_every: float = SAVE_EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._curve = folder, curve
        self._keep_every = keep_every
        self._kept = first // keep_every
        self._save_every, self._clock = save_every, clock
        self._saved_at = clock()
        self._interrupts = Interrupts()
        folder.forget_after(self._kept)

    def __enter__(self) -> Self:
        self._interrupts.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._interrupts.__exit__(kind, error, trace)

    @property
    def is_interrupted(self) -> bool:
        """Whether a signal asked for an end."""
        return self._interrupts.requested is not None

    def after(self, step: int, state: Callable[[], State], *, is_last: bool = False) -> bool:
        """Write what is due after a step.

        Args:
            step: steps done.
            state: everything to go on with; called only if it is written.
            is_last: whether nothing comes after it.

        Returns:
            Whether the state was written.

        Raises:
            StoreError: a file cannot be written.
        """
        if step // self._keep_every > self._kept:
            self._kept = step // self._keep_every
            self._folder.keep(self._kept, state())
        now = self._clock()
        is_due = is_last or self.is_interrupted or now - self._saved_at >= self._save_every
        if is_due:
            # The curve first: rows beyond a state are dropped, rows that are missing are lost.
            self._curve.flush()
            self._folder.save_state(state())
            self._saved_at = now
        return is_due


@dataclass(frozen=True, kw_only=True)
class Trained:
    """How far a training came.

    Attributes:
        program: that trained.
        folder: of the training.
        policy: the folder of its policy.
        step: steps that it has learnt from.
        is_done: whether that is all of its budget.
        is_interrupted: whether a signal ended it.
    """

    program: Literal["teacher", "student"]
    folder: Path
    policy: Path
    step: int
    is_done: bool
    is_interrupted: bool
