"""What was found at a path: files, and cameras if somebody knows them already."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from nw_eval.errors import SceneError
from nw_eval.files.inside import OutsideError, inside, regular
from nw_eval.twin.calibrate.photographs import Found, natural
from nw_eval.twin.calibrate.solution import Solution

_MOST_BYTES = 256 * 2**20


@dataclass(frozen=True, kw_only=True)
class Footage:
    """What a calibration starts from.

    Attributes:
        kind: what it is.
        files: photographs in the order of their names.
        is_film: whether they are frames of a video, each beside the one before.
        cameras: as they are known, by the files' names; None where they are to be found.
    """

    kind: Literal["photographs", "video", "colmap", "nerfstudio", "polycam"]
    files: tuple[Found, ...]
    is_film: bool = False
    cameras: Solution | None = None


def found_in(folder: Path, name: str, *, called: str | None = None) -> Found:
    """Return a photograph of a folder; one that lies elsewhere is found, and not to be read.

    Args:
        folder: that it must lie in.
        name: relative to it.
        called: its name as a photograph; None = the same.
    """
    try:
        path = inside(folder, name)
    except OutsideError as error:
        return Found(name=called or name, path=None, fault=f"it is not in {folder}: {error}")
    return Found(name=called or name, path=path)


def in_order(files: Iterable[Found]) -> tuple[Found, ...]:
    """Return files as footage has them."""
    return tuple(sorted(files, key=lambda one: natural(one.name)))


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file.

    Raises:
        SceneError: there is none, or no object in it.
    """
    try:
        if regular(path).stat().st_size > _MOST_BYTES:
            raise SceneError(f"{path} is larger than {_MOST_BYTES} bytes", fix="export it again")
        value = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise SceneError(f"{path} cannot be read: {error}", fix="export it again") from None
    if not isinstance(value, dict):
        raise SceneError(f"{path} holds no JSON object", fix="export it again")
    return value


def number(value: Any, what: str) -> float:
    """Return a finite number of a stranger's file.

    Raises:
        SceneError: it is none; naming what it was to be.
    """
    good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good or abs(value) > 1e15 or math.isnan(value):
        raise SceneError(f"{what} is {value!r}, no number", fix="export the cameras again")
    return float(value)
