"""Where a trial's time goes, by stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Literal, Self, get_args

Stage = Literal["setup", "physics", "render", "sense", "policy", "log"]


@dataclass(frozen=True, kw_only=True)
class StageSeconds:
    """Seconds that a trial spent in each stage."""

    setup: float = 0.0  # scene, robot, renderer and policy, before the first step
    physics: float = 0.0
    render: float = 0.0  # camera images, the policy's and the log's
    sense: float = 0.0  # every observation that is not an image
    policy: float = 0.0  # its network, and what makes joint targets of its actions
    log: float = 0.0


class StageClock:
    """Adds up the seconds of each stage.

    Stages nest: while an inner one runs, the outer one stands still, so no second counts twice. A
    control step has five of them, and what the clock itself takes is nobody's: it does little.

    Args:
        now: seconds that pass, of the wall if nothing is said; `time.thread_time` is the processor.
    """

    def __init__(self, now: Callable[[], float] = perf_counter) -> None:
        stages: tuple[Stage, ...] = get_args(Stage)
        self._now = now
        self._spent: dict[Stage, float] = dict.fromkeys(stages, 0.0)
        self._running: list[Stage] = []
        self._began = 0.0

    def __call__(self, stage: Stage) -> Self:
        """Credit the time from now to the end of the `with` block to a stage; only for `with`."""
        now, running = self._now(), self._running
        if running:
            self._spent[running[-1]] += now - self._began
        running.append(stage)
        self._began = now
        return self

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        now = self._now()
        self._spent[self._running.pop()] += now - self._began
        self._began = now

    @property
    def stages(self) -> StageSeconds:
        """Seconds so far."""
        return StageSeconds(**self._spent)
