"""Gaussians written to a new file, and how many of them it holds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_splat.gaussians import Gaussians


@dataclass(frozen=True, kw_only=True)
class WrittenSplat:
    """A file of Gaussians that was written."""

    file: Path
    gaussians: int
    bytes: int
    left_out: int = 0
    """Gaussians that cannot be drawn."""
    notes: tuple[str, ...] = ()
    """What of the source was not read."""


def write_new(out: Path, gaussians: Gaussians) -> WrittenSplat:
    """Write Gaussians to a new file and return them as the file has them.

    Args:
        out: the file; its suffix says the format.
        gaussians: all of them.

    Raises:
        SceneError: they do not fit the format.
        UsageError: a format that cannot be written.
    """
    from nw_splat.files import left_out, write_splat

    size = write_splat(out, gaussians)
    left = left_out(out, gaussians)
    return WrittenSplat(
        file=out,
        gaussians=len(gaussians) - left,
        bytes=size,
        left_out=left,
        notes=gaussians.notes,
    )
