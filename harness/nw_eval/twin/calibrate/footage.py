"""What was found at a path: photographs, masks beside them, and cameras if somebody knows them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from nw_eval.errors import SceneError
from nw_eval.files.inside import OutsideError, inside, regular
from nw_eval.twin.calibrate.photographs import SUFFIXES, Found, natural
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
        metric: whether these cameras are in metres.
        up: (3,) unit vector in the frame of these cameras; None where their source does not say.
    """

    kind: Literal["photographs", "video", "colmap", "nerfstudio", "polycam", "record3d", "arkit"]
    files: tuple[Found, ...]
    is_film: bool = False
    cameras: Solution | None = None
    metric: bool = False
    up: tuple[float, float, float] | None = None


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
    """Return a finite number of an untrusted file.

    Raises:
        SceneError: it is none; naming what it was to be.
    """
    good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good or abs(value) > 1e15 or math.isnan(value):
        raise SceneError(f"{what} is {value!r}, no number", fix="export the cameras again")
    return float(value)


def photographs_in(folder: Path) -> Footage | None:
    """Return the photographs of a folder, or of `images` in it; None if there are none."""
    for place, beside in ((folder, ()), (folder / "images", (folder,))):
        names = names_in(place, SUFFIXES)
        if names:
            files = [found_in(place, name) for name in names]
            files = with_masks(files, [place / "masks", *(b / "masks" for b in beside)])
            return Footage(kind="photographs", files=in_order(files))
    return None


def names_in(folder: Path, suffixes: frozenset[str]) -> list[str]:
    """Return names of the files in a folder with such suffixes; hidden ones are no photographs."""
    if not folder.is_dir():
        return []
    return [
        path.name
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and not path.is_dir()
    ]


def with_masks(files: list[Found], folders: list[Path]) -> list[Found]:
    """Return photographs with their masks: `IMG_1.jpg.png` or `IMG_1.png` for `IMG_1.jpg`.

    Raises:
        SceneError: a mask is a link that leads out of its folder.
    """
    folder = next((place for place in folders if place.is_dir()), None)
    if folder is None:
        return files
    masks = {name.lower(): name for name in sorted(names_in(folder, SUFFIXES))}
    stems = {Path(name).stem.lower(): name for name in sorted(names_in(folder, SUFFIXES))}
    found: list[Found] = []
    for one in files:
        name = one.name.lower()
        mask = masks.get(f"{name}.png") or stems.get(Path(name).stem)
        try:
            found.append(one if mask is None else replace(one, mask=inside(folder, mask)))
        except OutsideError as error:
            raise SceneError(
                f"the mask {mask} is not in {folder}: {error}", fix="copy it there"
            ) from None
    return found
