"""What `nw-eval limits` found, read from its folder again."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nw_base.errors import StoreError, UsageError
from nw_base.files.inside import bounded_bytes, inside, what_is
from nw_gate.limits.limit import Limit

_MOST = 2**26
"""Bytes of a file."""


@dataclass(frozen=True, kw_only=True)
class SavedLimit:
    """A policy's limit on one ladder."""

    policy: str
    """What it was called."""
    ladder: str
    """The ladder's name, such as `hurdles/bar`."""
    limit: Limit
    run: Path
    """The folder of its trials."""
    source: str
    """The file."""


def limits_file(path: Path) -> Path | None:
    """Return the file of limits that a path names or that its folder holds; None if it is none."""
    if path.name == _NAME and what_is(path) == "file":
        return path
    return path / _NAME if what_is(path / _NAME) == "file" else None


def read_limits(path: Path) -> tuple[SavedLimit, ...]:
    """Return the limits in a folder of `nw-eval limits`, or in its `limits.json`.

    Raises:
        UsageError: there is no such file.
        StoreError: it cannot be read, or is none.
    """
    file = limits_file(path)
    if file is None:
        raise UsageError(
            f"{path} holds no limits (no {_NAME} in it)",
            fix="name a folder that `nw-eval limits` wrote",
        )
    try:
        return _read(file)
    except StoreError as error:
        raise StoreError(f"{file}: {error.message}", fix=_FIX) from None
    except KeyError as error:
        raise StoreError(f"{file} lacks {error}", fix=_FIX) from None
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise StoreError(f"{file} cannot be read: {error}", fix=_FIX) from None


_NAME = "limits.json"
_FIX = "find the limits anew with `nw-eval limits`"


def _read(file: Path) -> tuple[SavedLimit, ...]:
    content = json.loads(bounded_bytes(file, _MOST))
    if content["nw-limits"] != 1:
        raise ValueError(f"its version is {content['nw-limits']!r}, not 1")
    return tuple(_saved(each, file) for each in content["limits"])


def _saved(entry: Any, file: Path) -> SavedLimit:
    return SavedLimit(
        policy=str(entry["policy"]),
        ladder=str(entry["ladder"]),
        limit=Limit.from_dict(entry["limit"]),
        run=inside(file.parent, str(entry["run"])),
        source=str(file),
    )
