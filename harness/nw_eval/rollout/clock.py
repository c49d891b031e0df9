"""Where a trial's time goes, by stage."""

from __future__ import annotations

from time import perf_counter, thread_time
from typing import Literal, get_args

from nw_eval.rollout.result import StageSeconds

Stage = Literal["setup", "physics", "render", "sense", "policy", "log"]


class StageClock:
    """Adds up wall seconds and the thread's CPU seconds of each stage.

    Stages nest: while an inner one runs, the outer one stands still, so no second counts twice.
    """

    def __init__(self) -> None:
        stages: tuple[Stage, ...] = get_args(Stage)
        self._wall: dict[Stage, float] = dict.fromkeys(stages, 0.0)
        self._cpu: dict[Stage, float] = dict.fromkeys(stages, 0.0)
        self._running: list[Stage] = []
        self._began = (perf_counter(), thread_time())
        # Entered several times in each control step, so they are made once.
        self._blocks = {stage: _Block(self, stage) for stage in stages}

    def __call__(self, stage: Stage) -> _Block:
        """Credit the time inside the `with` block to a stage."""
        return self._blocks[stage]

    def begin(self, stage: Stage) -> None:
        """Credit the time from now on to a stage."""
        self._turn()
        self._running.append(stage)

    def end(self) -> None:
        """Credit the time from now on to the stage before."""
        self._turn()
        self._running.pop()

    @property
    def wall(self) -> StageSeconds:
        """Wall seconds so far."""
        return StageSeconds(**self._wall)

    @property
    def cpu(self) -> StageSeconds:
        """CPU seconds of the calling thread so far."""
        return StageSeconds(**self._cpu)

    def _turn(self) -> None:
        """Credit the time since the last turn to the stage that was running."""
        now = (perf_counter(), thread_time())
        if self._running:
            stage = self._running[-1]
            self._wall[stage] += now[0] - self._began[0]
            self._cpu[stage] += now[1] - self._began[1]
        self._began = now


class _Block:
    """A `with` block of a stage; it keeps nothing, so blocks of one stage may nest."""

    def __init__(self, clock: StageClock, stage: Stage) -> None:
        self._clock = clock
        self._stage: Stage = stage

    def __enter__(self) -> None:
        self._clock.begin(self._stage)

    def __exit__(self, *_: object) -> None:
        self._clock.end()
