"""When a training's state is written, and whether it is to stop: after whole steps only."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from nw_eval.engine.machine.interrupts import Interrupts
from nw_eval.learn.program.curve import Curve
from nw_eval.learn.program.folder import State, TrainFolder

SAVE_EVERY = 120.0
"""Seconds between two states on disk: the most that a SIGKILL costs."""


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
