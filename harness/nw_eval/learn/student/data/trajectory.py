"""One trajectory: what the student was given on its way, and what the teacher would have done."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import StoreError

# What a damaged file may cause in the library that reads it.
_DAMAGE = (OSError, ValueError, LookupError, TypeError, EOFError, MemoryError, BadZipFile)

Bytes = NDArray[np.uint8]
Rows = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """T control steps with F images of each camera, of which one is held for some steps."""

    body: Rows
    """(T, numbers) what the student was told of its body."""
    labels: Rows
    """(T, 12) the teacher's raw actions in the same states."""
    frame_of: NDArray[np.int32]
    """(T,) the newest image of each step; from 0, never falling."""
    rgb: Bytes
    """(F, 3, rows, columns); none of them where the student sees no colours."""
    depth: Bytes
    """(F, 1, rows, columns) shares of the clipping distance in 255 steps; likewise."""
    success: float
    """Share of waypoints that whoever drove has reached."""

    @property
    def steps(self) -> int:
        """Control steps."""
        return len(self.body)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(np.asarray(getattr(self, field.name)).nbytes for field in fields(self))

    def write(self, path: Path) -> None:
        """Write it, whole or not at all; a fenced process may.

        Raises:
            StoreError: it cannot be written.
        """
        arrays = {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}
        part = path.with_suffix(".part")
        try:
            with part.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
            part.replace(path)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise StoreError(
                f"cannot write {path}: {error.strerror}", fix="free disk space"
            ) from error


def read_trajectory(path: Path) -> Trajectory:
    """Read a trajectory; a file that is none runs no code.

    Raises:
        StoreError: it is missing, damaged or something else.
    """
    try:
        with ZipFile(path) as archive:  # Ours are as large as what is in them: no bomb is one.
            if any(member.compress_type != ZIP_STORED for member in archive.infolist()):
                raise ValueError("its arrays are compressed")
        with np.load(path, allow_pickle=False) as file:
            arrays: dict[str, Any] = {each.name: file[each.name] for each in fields(Trajectory)}
        arrays["success"] = float(arrays["success"])
        read = Trajectory(**arrays)
        _check(read)
    except _DAMAGE as error:
        raise StoreError(
            f"{path} is no trajectory: {error}", fix="remove it; it will be driven again"
        ) from None
    return read


def _check(read: Trajectory) -> None:
    """Refuse arrays that do not belong together.

    Raises:
        ValueError: naming what is wrong.
    """
    kinds = {"body": "f4", "labels": "f4", "frame_of": "i4", "rgb": "u1", "depth": "u1"}
    for name, kind in kinds.items():
        if getattr(read, name).dtype != np.dtype(kind):
            message = f"`{name}` is {getattr(read, name).dtype}"
            raise ValueError(message)
    steps, frames = read.steps, max(len(read.rgb), len(read.depth))
    if not (len(read.labels) == len(read.frame_of) == steps > 0):
        raise ValueError("its rows are of different numbers of steps")
    if int(read.frame_of.min()) < 0 or int(read.frame_of.max()) >= frames:
        raise ValueError("a step has an image that is not there")
