"""Words for people: with an exit code, or into a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Message:
    """Words for people, and the exit code that goes with them."""

    text: str
    exit_code: int = 0


def write_text(path: Path, text: str) -> None:
    """Write a file, whole or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    from nw_eval.report.markdown import write_report

    write_report(path, text)
