"""What a replay came to, as plain values: they travel from a confined process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Something that is not as it was recorded."""

    name: str
    recorded: str
    """What the log says; empty if it says nothing."""
    now: str


@dataclass(frozen=True, kw_only=True)
class ReplayReport:
    """A recorded trial that was run again."""

    trial: str
    start_step: int
    """The control step from which on it was run; 0 = all of it."""
    steps: int
    """How many control steps it has now."""
    end: str
    """Its outcome now, or the kind of error that ended it."""
    differences: tuple[Difference, ...]
    """Of its end: outcome, waypoints, digests of states and actions."""
    versions: tuple[Difference, ...]
    """Of the code and the libraries; under others equal bits cannot be expected."""
    picture: Path | None = None
    """The trial's contact sheet, if it was asked for."""
    video: Path | None = None
    """Likewise, its video."""

    @property
    def is_identical(self) -> bool:
        """Whether the end is the recorded one, bit for bit."""
        return not self.differences
