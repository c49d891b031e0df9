"""What a run would be, and about how long it would take."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

from nw_eval.engine.machine.cores import worker_count
from nw_eval.engine.provenance import engine_of
from nw_eval.results.bank.manifest import machine_in
from nw_eval.suite.trials import wanted

if TYPE_CHECKING:
    from nw_eval.engine.plan import Plan
    from nw_eval.policies import Bundle
    from nw_eval.results.provenance import ShardInfo
    from nw_eval.suite import Suite

# Wall seconds for one simulated second of a trial that lasts its whole duration, on one core of the
# class that the benchmarks name: physics, scandots, policy and log, and a camera's frames on top.
_BLIND = 0.06
_SEEING = 0.10
# Wall seconds until a worker has its libraries and kernels.
_START = 4.0
_LEAST = 0.1  # minutes


@dataclass(frozen=True, kw_only=True)
class SceneForecast:
    """A scene that would be run."""

    name: str
    digest: str
    """Hex sha256 of its physics; part of its trials' identity."""
    trials: int


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """A run that has not been run."""

    suite: Suite
    """With what was asked of it otherwise; it has a digest of its panel and one of all it says."""
    policy: Bundle
    scenes: tuple[SceneForecast, ...]
    shard: ShardInfo | None = None
    """Which part of a run it is, in trials and minutes too; None: all of it."""
    workers: int
    baseline: str | None = None
    """The name of the bank that it would be compared with, in rounds, of which it may end early."""
    minutes: float
    """Of wall time; about what it takes at most, on a core of the benchmarks' class."""

    @property
    def trials(self) -> int:
        """How many there would be."""
        return sum(scene.trials for scene in self.scenes)


def forecast(plan: Plan, *, workers: int | None = None) -> Forecast:
    """Return what a run of a plan would be.

    Args:
        plan: what would be run.
        workers: processes; one for each core if None.
    """
    trials = Counter(trial.scene for trial in wanted(plan.trials, _rounds(plan)))
    return Forecast(
        suite=plan.suite,
        policy=plan.bundle,
        scenes=tuple(
            SceneForecast(name=scene.name, digest=scene.digest, trials=trials[scene.name])
            for scene in plan.scenes
        ),
        shard=plan.shard,
        workers=worker_count(workers, trials.total()),
        baseline=None if plan.against is None else plan.against.info.name,
        minutes=minutes_of(trials.total(), plan, workers=workers),
    )


def _rounds(plan: Plan) -> int | None:
    """Return after how many rounds a run ends whose results are a bank's; None = of no such run."""
    machine = machine_in(engine_of(plan.render))
    if not plan.is_baseline or plan.against is None or not plan.against.bank.panel_of(machine):
        return None
    return 1 if plan.request.recheck is None else plan.request.recheck


def minutes_of(trials: float, plan: Plan, *, workers: int | None = None) -> float:
    """Return about how many minutes of wall time so many trials of a plan's kind take at most.

    Args:
        trials: how many, whatever the plan has.
        plan: whose suite and policy they are of.
        workers: processes; one for each core if None.
    """
    sees = bool(plan.bundle.card.splat_images) or plan.suite.record == "all"
    each = (_SEEING if sees else _BLIND) * plan.suite.episode.duration
    count = worker_count(workers, ceil(trials))
    return max((_START + each * trials / count) / 60.0, _LEAST)
