"""A run's `cause.json`: what its drop is due to, for its reports."""

from __future__ import annotations

from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from nw_eval.errors import StoreError
from nw_eval.files.cache import atomic_path
from nw_eval.files.inside import regular
from nw_eval.gate.cause.two_by_two import Cause

_CAUSE = TypeAdapter(Cause)
_LARGEST = 1_000_000  # bytes


def write_cause_file(cause: Cause, path: Path) -> None:
    """Write it, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(_CAUSE.dump_json(cause, indent=2) + b"\n")


def read_cause_file(path: Path) -> Cause | None:
    """Read it; None where there is none.

    Raises:
        StoreError: it is damaged.
    """
    try:
        with regular(path).open("rb") as file:
            return _CAUSE.validate_json(file.read(_LARGEST))
    except FileNotFoundError:
        return None
    except (OSError, ValidationError):
        raise StoreError(
            f"{path} is damaged", fix="remove it, or run nw-eval blame --cause again"
        ) from None
