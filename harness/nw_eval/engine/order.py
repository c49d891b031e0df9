"""In which order the trials of a run are started.

Which trials of a plan a shard has, and how shards of one plan are known.

Trials stand in the order of their run (`in_order`). Part I of N has every N-th of them. So the
parts have equally many trials, or one more or less; what is hard is spread over them by chance, and
which part a trial is in depends on nothing but the plan: no machine, no clock, no other part.
"""

from __future__ import annotations

import re
import secrets
from hashlib import sha256
from itertools import takewhile
from math import ceil
from typing import TYPE_CHECKING

from nw_base.errors import UsageError
from nw_base.plural import plural
from nw_gate.results.provenance import ShardInfo
from nw_gate.results.request import Shard

if TYPE_CHECKING:
    from collections.abc import Collection, Container, Iterable, Sequence

    from nw_base.trials import Trial

_NEAR = 16
"""Trials of a drawn order among which a worker may choose."""


def in_order(trials: Iterable[Trial]) -> tuple[Trial, ...]:
    """Return trials in the order in which they are started.

    Those that were drawn for a run against a baseline keep their positions. Others go round by
    round: every scene's first trials, then the second ones, and so on. Within a round the order is
    that of a hash of the identity, so that neighbours differ in difficulty, and it is the same for
    every worker count, shard and resume. A run that is cut short has met every scene about equally
    often.
    """

    def key(trial: Trial) -> tuple[int, bytes]:
        if trial.place is None:
            return trial.index, sha256(f"{trial.suite_digest}/{trial.identity}".encode()).digest()
        return trial.place, b""

    return tuple(sorted(trials, key=key))


def next_place(
    waiting: Iterable[Trial],
    *,
    own: Container[str],
    taken: Container[str],
    held: Collection[str] = (),
) -> int:
    """Return the position, among waiting trials in order, of the one that a worker takes next.

    It is of the first's round, or among the next `_NEAR` of a drawn order, so that scenes are met
    as equally as without choice: one in a scene that the worker has loaded, or else one in a scene
    that no worker has, or else the first.

    Args:
        waiting: one trial or more.
        own: scenes that the worker has loaded.
        taken: scenes that any worker has.
        held: scenes whose trials cannot begin yet.

    Returns:
        The position; -1 if those among which it may choose are all held.
    """
    trials = iter(waiting)
    first = next(trials)

    def is_near(trial: Trial) -> bool:
        if first.place is None or trial.place is None:
            return trial.index == first.index
        return trial.place < first.place + _NEAR

    scenes = [first.scene, *(trial.scene for trial in takewhile(is_near, trials))]
    return min(
        (place for place, scene in enumerate(scenes) if scene not in held),
        key=lambda place: 0 if scenes[place] in own else 1 + (scenes[place] in taken),
        default=-1,
    )


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
    digest = sha256()
    for place, trial in zip(places, ordered, strict=True):
        digest.update(f"{place} {trial.identity} {trial.id}\n".encode())
    return digest.hexdigest()


_BITS = 48  # of a seed, which somebody may have to type
_SHARE = re.compile(r"([0-9]{1,3}(?:\.[0-9]{1,9})?) ?%|([0-9]{1,9})")


def unforeseen_seed() -> int:
    """Return a seed that was not known before."""
    return secrets.randbits(_BITS)


def draw(trials: Collection[str], sample: str, seed: int) -> tuple[str, ...]:
    """Return the trials that a seed draws, sorted: the same ones whatever their order was.

    Args:
        trials: ids.
        sample: as `check_sample`.
        seed: of the draw.
    """
    count = min(max(1, _count(sample, len(trials))), len(trials))
    ranked = sorted(trials, key=lambda name: sha256(f"{seed}/{name}".encode()).digest())
    return tuple(sorted(ranked[:count]))


def check_sample(sample: str, option: str = "--trials") -> None:
    """Refuse what is neither a share, such as `5%`, nor a number of trials.

    Args:
        sample: the words.
        option: what they were given for.

    Raises:
        UsageError: it is not.
    """
    found = _SHARE.fullmatch(sample)
    if found is None or not 0.0 < float(found[1] or found[2]) <= (100.0 if found[1] else 1e9):
        raise UsageError(
            f"{option} {sample!r} is neither a share nor a number of trials",
            fix="give one, such as 5% or 3",
        )


def _count(sample: str, of: int) -> int:
    if sample.endswith("%"):
        return ceil(float(sample.rstrip(" %")) / 100.0 * of)
    return int(sample)
