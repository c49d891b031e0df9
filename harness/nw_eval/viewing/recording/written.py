"""A recording that was written, as plain values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class WrittenRecording:
    """A recording of Rerun that was written."""

    file: Path
    bytes: int
    gaussians: int
    """Of the place's splat; 0 = it is not in the recording."""
    no_splat: str
    """Why it is not; empty if it is."""
