"""Where a run's time went: the wall times in its rows, and what workers were there for besides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row, by_column

_STAGES = ("setup", "sense", "render", "policy", "physics", "log")
"""Those that rows have the times of, each in its column."""


@dataclass(frozen=True, kw_only=True)
class StageTime:
    """Time of one stage over all trials."""

    name: str
    seconds: float
    ms_per_step: float  # Per control step.
    share: float  # Of all workers' wall time.


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """Stages in their order, those of a control step after `setup`, and the time they simulated.

    `waiting` is what workers spent outside of trials: they were started, or the others' trials of a
    round went on, or the journal was written.
    """

    stages: tuple[StageTime, ...]
    sim_s: float
    real_time_factor: float  # Simulated over wall time, of one worker.


def throughput(rows: Sequence[Row], info: RunInfo) -> Throughput:
    """Return the time of each stage. Rows from the cache took none and are left out."""
    run = [row for row in rows if not row.cached]
    times = {name: f"{name}_s" for name in _STAGES}
    sums: dict[str, float] = {
        column: sum(values)
        for column, values in by_column(run, ("steps", "wall_s", "sim_s", *times.values())).items()
    }
    steps, trials, sim = sums["steps"], sums["wall_s"], sums["sim_s"]
    named = {name: sums[column] for name, column in times.items()}
    # Clocks that overlap by a rounding must not make a negative stage.
    named["other"] = max(0.0, trials - sum(named.values()))
    named["waiting"] = max(0.0, info.wall_s * min(info.workers, len(run)) - trials)
    wall = trials + named["waiting"]
    return Throughput(
        stages=tuple(
            StageTime(
                name=name,
                seconds=seconds,
                ms_per_step=1000.0 * seconds / steps if steps else 0.0,
                share=seconds / wall if wall else 0.0,
            )
            for name, seconds in named.items()
        ),
        sim_s=sim,
        real_time_factor=sim / trials if trials else 0.0,
    )
