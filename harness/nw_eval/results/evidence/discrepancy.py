"""What was found of a run's evidence: what is not as it was, and what could not be looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

What = Literal["changed", "missing", "extra", "unreadable"]


@dataclass(frozen=True, kw_only=True)
class Discrepancy:
    """Something that is not as it was when the run ended."""

    what: What
    file: str
    """Which file of the run's folder, relative to it."""
    trial: str = ""
    """Whose row or log; empty where it is a file as a whole."""
    about: str = ""
    """How it differs, in words; empty where there is nothing more to say."""


@dataclass(frozen=True, kw_only=True)
class CheckedFiles:
    """What looking at a run's files showed; nothing was run."""

    findings: tuple[Discrepancy, ...]
    remarks: tuple[str, ...]
    """Sentences: what could not be looked at, and why."""
    rows: int
    """Trials with a row."""
    logs: int
    """Logs whose digest a row has."""
    log_bytes: int
    """Of those that are there."""
    root: str
    """The Merkle root that run.json has, hex; empty where it has none."""
