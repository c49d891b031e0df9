"""Which trials of a plan a shard has, and how shards of one plan are known.

Trials stand in the order of their run (`engine.order`). Part I of N has every N-th of them. So the
parts have equally many trials, or one more or less; what is hard is spread over them by chance, and
which part a trial is in depends on nothing but the plan: no machine, no clock, no other part.
"""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING

from nw_eval.engine.order import in_order
from nw_eval.errors import UsageError
from nw_eval.plural import plural
from nw_eval.request import Shard
from nw_eval.results.provenance import ShardInfo

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from nw_eval.suite.trials import Trial


def shard_of(
    trials: Iterable[Trial], shard: Shard | None
) -> tuple[tuple[Trial, ...], ShardInfo | None]:
    """Return the trials of a part of a plan, and what run.json says of it; all and None for None.

    Args:
        trials: of the whole plan.
        shard: which part.

    Raises:
        UsageError: the part has no trial.
    """
    if shard is None:
        return tuple(trials), None
    ordered = in_order(trials)
    if not (share := shard.share(ordered)):
        raise UsageError(
            f"--shard {shard}: there is nothing in it, the run has {plural(len(ordered), 'trial')}",
            fix=f"make at most {plural(len(ordered), 'part')}",
        )
    return share, ShardInfo(index=shard.index, count=shard.count, plan=plan_digest(ordered))


def shards_of(
    trials: Iterable[Trial], count: int
) -> tuple[tuple[tuple[Trial, ...], ShardInfo], ...]:
    """Return all parts of a plan, as `shard_of` returns one.

    Args:
        trials: of the whole plan.
        count: of parts.

    Raises:
        UsageError: there is none, or a part has no trial.
    """
    ordered = in_order(trials)
    if not 1 <= count <= len(ordered):
        raise UsageError(
            f"--shards {count}: the run has {plural(len(ordered), 'trial')}",
            fix=f"give a number from 1 to {len(ordered)}",
        )
    shards = [Shard(index=index, count=count) for index in range(1, count + 1)]
    digest = plan_digest(ordered)
    return tuple(
        (shard.share(ordered), ShardInfo(index=shard.index, count=count, plan=digest))
        for shard in shards
    )


def plan_digest(ordered: Sequence[Trial]) -> str:
    """Return the hex sha256 of a whole plan: its trials, their names and their order.

    Args:
        ordered: `in_order`.
    """
    places = (trial.index if trial.place is None else trial.place for trial in ordered)
    lines = "".join(
        f"{place} {trial.identity} {trial.id}\n"
        for place, trial in zip(places, ordered, strict=True)
    )
    return sha256(lines.encode()).hexdigest()
