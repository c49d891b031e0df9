"""Into which parts a run can be cut, each of which another machine runs. Nothing is run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nw_eval.engine.forecast import Forecast
    from nw_eval.request import Request


@dataclass(frozen=True, kw_only=True)
class ShardPlan:
    """The parts of a run, in their order: what each of them would be."""

    suite: str
    """As it was asked for."""
    parts: tuple[Forecast, ...]

    @property
    def trials(self) -> int:
        """Of all parts."""
        return sum(part.trials for part in self.parts)


def plan_shards(
    request: Request | str | Path, shards: int, *, workers: int | None = None, **changes: Any
) -> ShardPlan:
    """Return the parts of a run: their trials, and about how long each takes.

    Args:
        request: as for `plan`.
        shards: how many parts.
        workers: processes of each part to reckon with; one for each core if None.
        changes: fields of `Request` by name.

    Raises:
        UsageError: there would be no part, or parts without a trial; or as `plan`.
        SuiteError, PolicyError: as `plan`.
    """
    from nw_eval.api.running.plans import check_workers, plan
    from nw_eval.engine.forecast import forecast
    from nw_eval.engine.shards import shards_of
    from nw_eval.request import Request

    check_workers(workers)
    whole = plan(Request.of(request, **changes, shard=None))
    parts = [
        replace(whole, trials=trials, shard=shard)
        for trials, shard in shards_of(whole.trials, shards)
    ]
    return ShardPlan(
        suite=str(whole.request.suite or whole.suite.name),
        parts=tuple(forecast(part, workers=workers) for part in parts),
    )
