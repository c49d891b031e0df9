"""What a run is made of, as the entries whose digest run.json keeps: what it is of, and its rows.

A row's entry has all of its columns, also those that its own digest leaves out: the times that a
report adds up, the tier by which a scene is judged, the SHA-256 of its log. A log needs no entry of
its own.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from hashlib import file_digest
from operator import attrgetter
from pathlib import Path
from typing import Any

from nw_eval.results.evidence.merkle import leaf_hash
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import COLUMNS, Row, RowTexts

_ENCODE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
_VALUES = attrgetter(*COLUMNS)
_DEFAULTS = tuple((column.added, column.default) for column in COLUMNS.values())
_REALS = tuple(place for place, name in enumerate(COLUMNS) if name in COLUMNS.reals)


def run_leaf(info: RunInfo) -> str:
    """Return the hex hash of what a run is of: suite with its gate, policy, scenes, bank, engine.

    When and where it ran is left out, and so is all that `report` writes again.
    """
    policy, bank, stop = info.policy, info.baseline, info.stop
    facts = {
        "suite": info.suite,
        "suite_digest": info.suite_digest,
        "policy": [policy.name, policy.card_digest, policy.checkpoint_digest],
        "scenes": {
            name: [scene.digest, scene.task, scene.trials] for name, scene in info.scenes.items()
        },
        "panel": [
            *(info.panel, info.drawn_from),
            None if stop is None else [stop.first, *stop.followed],
            *filter(None, [info.drawn_for]),
        ],
        "bank": None if bank is None else [bank.name, bank.sha256, bank.checked, list(bank.moved)],
        "engine": info.engine,
    }
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"))
    return leaf_hash(text.encode()).hex()


def row_leaf(row: Row) -> str:
    """Return the hex hash of a row: of the values of all columns, in their order.

    Columns that came later are last. While they have their defaults they are left out, so that a
    row keeps its hash under every version that adds some.
    """
    values = list(_VALUES(row))
    for place in _REALS:  # A whole number comes back from Parquet as a real one.
        if type(values[place]) is int:
            values[place] = float(values[place])
    return leaf_hash(_ENCODE(values[: _without_defaults(values)]).encode()).hex()


def row_leaves(texts: RowTexts) -> dict[str, str]:
    """Return the `row_leaf` of each of some rows, by trial."""
    names, values = texts.values["trial_id"], texts.values
    if any(int in set(map(type, values[name])) for name in COLUMNS.reals):
        return dict(zip(names, map(row_leaf, texts.rows), strict=True))
    counts = map(_without_defaults, zip(*values.values(), strict=True))
    entries = zip(*texts.texts.values(), strict=True)
    return {
        name: leaf_hash(f"[{','.join(entry[:count])}]".encode()).hex()
        for name, entry, count in zip(names, entries, counts, strict=True)
    }


def _without_defaults(values: Sequence[Any]) -> int:
    """Return how many values there are but for the last that came later, and are as they would."""
    count = len(values)
    while _DEFAULTS[count - 1] == (True, values[count - 1]):
        count -= 1
    return count


def log_sha256(path: Path) -> str:
    """Return the hex digest of a log's bytes; empty where there is none that can be read."""
    try:
        with path.open("rb") as stream:
            return file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""
