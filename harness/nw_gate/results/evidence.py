"""A run's rows and logs under one digest, so that what was changed later is found and named.

run.json keeps the root: the Merkle Tree Hash of RFC 6962, section 2.1, one digest for a list,
whatever its length.

    MTH({})   = SHA-256()
    MTH({d})  = SHA-256(0x00 || d)
    MTH(D[n]) = SHA-256(0x01 || MTH(D[0:k]) || MTH(D[k:n])), k the largest power of two below n

The first byte keeps leaves and nodes apart: no list of other entries has the same digest, one whose
entries are the nodes of this one included. The entries, which digests.json keeps so that a culprit
has a name, are what the run is of, and its rows. A row's entry has all of its columns, also those
that its own digest leaves out: the times that a report adds up, the tier by which a scene is
judged, the SHA-256 of its log. A log needs no entry of its own.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import file_digest, sha256
from operator import attrgetter
from pathlib import Path
from typing import Any

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import bounded_bytes, regular
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import COLUMNS, Row
from nw_gate.results.seal import seal, unseal

_ENCODE = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
_VALUES = attrgetter(*COLUMNS)
_DEFAULTS = tuple((column.added, column.default) for column in COLUMNS.values())
_REALS = tuple(place for place, name in enumerate(COLUMNS) if name in COLUMNS.reals)


def run_leaf(info: RunInfo) -> str:
    """Return the hex hash of what a run is of: suite and gate, policy, scenes, baseline, engine.

    When and where it ran is left out, and so is all that `report` writes again.
    """
    policy, baseline, stop = info.policy, info.baseline, info.stop
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
        "bank": None
        if baseline is None
        else [baseline.name, baseline.sha256, baseline.checked, list(baseline.moved)],
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


def _without_defaults(values: Sequence[Any]) -> int:
    """Return how many values there are but for the last that came later, and are as they would."""
    count = len(values)
    while _DEFAULTS[count - 1] == (True, values[count - 1]):
        count -= 1
    return count


def log_sha256(path: Path) -> str:
    """Return the hex digest of a log's bytes; empty where there is none that can be read."""
    try:
        with regular(path).open("rb") as stream:
            return file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


_MOST = 192 * 2**20
"""Bytes of a file that is read: a million rows have some 120 million."""
_HEX = 64  # digits


@dataclass(frozen=True, kw_only=True)
class Digests:
    """The hash of what a run is of, and of each of its rows by trial, all in hex."""

    run: str
    rows: Mapping[str, str]

    @cached_property
    def root(self) -> str:
        """The Merkle root: of the run, and then of its rows in the order of their trials."""
        ordered = (self.rows[name] for name in sorted(self.rows))
        return root_of(bytes.fromhex(leaf) for leaf in (self.run, *ordered)).hex()


def write_digests(path: Path, digests: Digests) -> None:
    """Write digests.json with its checksum, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    rows = {name: digests.rows[name] for name in sorted(digests.rows)}
    text = json.dumps({"digests": 1, "run": digests.run, "rows": rows}, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(seal(text)[0], encoding="ascii")


def read_digests(path: Path) -> Digests:
    """Read digests.json.

    Raises:
        StoreError: it is missing or damaged.
    """
    fix = "restore it from a copy of the run"
    try:
        data = bounded_bytes(path, _MOST)
        return _digests(json.loads(unseal(data)[0]))
    except FileNotFoundError:
        raise StoreError(f"{path} is missing", fix=fix) from None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check its rights") from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise StoreError(f"{path} is damaged: {clean(error, at_most=200)}", fix=fix) from None


def _digests(record: Any) -> Digests:
    digests = Digests(run=record["run"], rows=dict(record["rows"]))
    if not all(map(_is_hash, (digests.run, *digests.rows.values()))):
        raise ValueError("it contains an invalid hash")
    return digests


def _is_hash(text: object) -> bool:
    return isinstance(text, str) and len(text) == _HEX and not set(text) - set("0123456789abcdef")


def leaf_hash(entry: bytes) -> bytes:
    """Return the hash of one entry of a list, 32 bytes."""
    return sha256(b"\x00" + entry).digest()


def root_of(leaves: Iterable[bytes]) -> bytes:
    """Return the hash of a list, 32 bytes.

    Args:
        leaves: the `leaf_hash` of every entry, in order.
    """
    trees: list[tuple[int, bytes]] = []  # Whole ones, each smaller than the one before it.
    for leaf in leaves:
        size, node = 1, leaf
        while trees and trees[-1][0] == size:
            size, node = 2 * size, sha256(b"\x01" + trees.pop()[1] + node).digest()
        trees.append((size, node))
    if not trees:
        return sha256().digest()
    _, root = trees.pop()
    while trees:
        root = sha256(b"\x01" + trees.pop()[1] + root).digest()
    return root
