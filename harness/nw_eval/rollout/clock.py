"""Where a trial's time goes, by stage."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, thread_time
from typing import Literal, Self, get_args

Stage = Literal["setup", "physics", "render", "sense", "policy", "log"]


@dataclass(frozen=True, kw_only=True)
class StageSeconds:
    """Seconds that a trial spent in each stage, by one clock."""

    setup: float = 0.0  # scene, robot, renderer and policy, before the first step
    physics: float = 0.0
    render: float = 0.0  # camera images, the policy's and the log's
    sense: float = 0.0  # every observation that is not an image
    policy: float = 0.0
    log: float = 0.0


class StageClock:
    """Adds up wall seconds and the thread's CPU seconds of each stage.

    Stages nest: while an inner one runs, the outer one stands still, so no second counts twice.
    """

    def __init__(self) -> None:
        stages: tuple[Stage, ...] = get_args(Stage)
        self._wall: dict[Stage, float] = dict.fromkeys(stages, 0.0)
        self._cpu: dict[Stage, float] = dict.fromkeys(stages, 0.0)
        self._running: list[Stage] = []
        self._wall_began, self._cpu_began = perf_counter(), thread_time()

    def __call__(self, stage: Stage) -> Self:
        """Credit the time from now to the end of the `with` block to a stage; only for `with`."""
        self._turn(self._running[-1] if self._running else None)
        self._running.append(stage)
        return self

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        self._turn(self._running.pop())

    @property
    def wall(self) -> StageSeconds:
        """Wall seconds so far."""
        return StageSeconds(**self._wall)

    @property
    def cpu(self) -> StageSeconds:
        """CPU seconds of the calling thread so far."""
        return StageSeconds(**self._cpu)

    def _turn(self, stage: Stage | None) -> None:
        """Credit the time since the last turn to the stage that was running."""
        wall, cpu = perf_counter(), thread_time()
        if stage is not None:
            self._wall[stage] += wall - self._wall_began
            self._cpu[stage] += cpu - self._cpu_began
        self._wall_began, self._cpu_began = wall, cpu
