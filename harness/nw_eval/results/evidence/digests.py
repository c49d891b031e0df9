"""digests.json: the entries under the root that run.json keeps, so that a culprit has a name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path
from nw_eval.results.bounded import bounded_bytes
from nw_eval.results.evidence.merkle import root_of
from nw_eval.results.seal import seal, unseal

_MOST = 64 * 2**20
"""Bytes of a file that is read: some 500,000 rows."""
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
    ordered = {name: digests.rows[name] for name in sorted(digests.rows)}
    # As `indent=2` would have it, by the encoder that is written in C.
    rows = json.dumps(ordered, separators=(",\n    ", ": "))[1:-1]
    rows = f"{{\n    {rows}\n  }}" if rows else "{}"
    text = f'{{\n  "digests": 1,\n  "run": {json.dumps(digests.run)},\n  "rows": {rows}\n}}'
    with atomic_path(path) as temporary:
        temporary.write_text(seal(text)[0], encoding="utf-8")


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
        raise ValueError("a hash in it is none")
    return digests


def _is_hash(text: object) -> bool:
    return isinstance(text, str) and len(text) == _HEX and not set(text) - set("0123456789abcdef")
