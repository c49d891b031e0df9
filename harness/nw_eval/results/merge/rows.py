"""The rows of all parts: of each trial the one row that stands; no gap, and no two results."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from nw_eval.errors import StoreError
from nw_eval.plural import plural
from nw_eval.results.merge.source import MergeSource
from nw_eval.results.planned import PlannedTrial
from nw_eval.results.row import Row, to_dict

_NAMED = 3  # parts that a sentence names before it says "and more"


@dataclass(frozen=True, kw_only=True)
class SourcedRow:
    """A trial's row, and the folders that have it: one of them has its log."""

    row: Row
    sources: tuple[MergeSource, ...]


def joined(
    sources: Sequence[MergeSource], trials: Sequence[PlannedTrial], count: int
) -> tuple[SourcedRow, ...]:
    """Return the rows of a whole plan, in its order.

    Of a trial that several folders have a result stands, and an error gives way to it, or to that
    of a later attempt. What wall clocks and machines say of equal results may differ: which of them
    is kept does not depend on the order of the folders.

    Args:
        sources: all folders.
        trials: of the whole plan, in the order of the run; every `count`-th is of one part.
        count: of parts.

    Raises:
        StoreError: a trial has no row, naming the part that it is in; or two different results,
            naming both folders.
    """
    held: dict[str, SourcedRow] = {}
    for source in sources:
        for row in source.rows:
            one = SourcedRow(row=row, sources=(source,))
            earlier = held.get(row.trial_id)
            held[row.trial_id] = one if earlier is None else _which(earlier, one)
    names = [trial.id for trial in trials]
    if gaps := [place for place, name in enumerate(names) if name not in held]:
        raise _gap(sources, trials, gaps, count)
    return tuple(map(held.__getitem__, names))


def _which(one: SourcedRow, two: SourcedRow) -> SourcedRow:
    """Return which of two rows of a trial stands.

    Raises:
        StoreError: they are different results.
    """
    if one.row == two.row:
        return SourcedRow(row=one.row, sources=(*one.sources, *two.sources))
    first, second = (one, two) if _rank(one.row) <= _rank(two.row) else (two, one)
    if second.row.status == "error":
        return first
    ours, theirs = one.row.digest, two.row.digest
    if ours != theirs:
        raise StoreError(
            f"trial {one.row.trial_id} has two different results: {ours[:8]} in {one.sources[0]}, "
            f"{theirs[:8]} in {two.sources[0]}",
            fix="one of them was changed, or the simulation is not deterministic there: "
            "`nw-eval replay` of both logs tells which",
        )
    return SourcedRow(row=first.row, sources=(*first.sources, *second.sources))


def _rank(row: Row) -> tuple[bool, int, str]:
    """Return what decides between rows of a trial, whoever names them first; the least stands."""
    return row.status == "error", -row.attempt, json.dumps(to_dict(row), sort_keys=True)


def _gap(
    sources: Sequence[MergeSource], trials: Sequence[PlannedTrial], gaps: Sequence[int], count: int
) -> StoreError:
    """Return the error that says which parts lack which trials."""
    lacking: dict[int, list[str]] = defaultdict(list)
    for place in gaps:
        lacking[place % count + 1].append(trials[place].id)
    there: dict[int, list[MergeSource]] = defaultdict(list)
    for source in sources:
        if source.info.shard is not None:
            there[source.info.shard.index].append(source)
    sentences: list[str] = []
    for index, names in sorted(lacking.items()):
        of = f"{plural(len(names), 'trial')}, first {names[0]}"
        if found := there[index]:
            sentences.append(f"{found[0]} lacks {of}; `--resume {found[0].folder.path}` runs them")
        else:
            sentences.append(f"there is no part {index} of {count} ({of})")
    more = f"; and {len(sentences) - _NAMED} more parts" if len(sentences) > _NAMED else ""
    return StoreError(
        f"{plural(len(gaps), 'trial')} of {len(trials)} missing: "
        f"{'; '.join(sentences[:_NAMED])}{more}",
        fix="merge once every part has run to its end",
    )
