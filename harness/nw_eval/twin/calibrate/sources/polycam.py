"""Polycam's raw export: `keyframes/images` and one JSON of a camera beside each.

`t_00` to `t_23` are the rows of T_world_camera in ARKit's axes: y of the world up, metres; x of
the camera right, y up, z back. As nerfstudio's importer reads them, without its change of axes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nw_eval.errors import SceneError
from nw_eval.twin.calibrate.photographs import SUFFIXES, Found
from nw_eval.twin.calibrate.solution import Lens, Placed, Solution, rigid
from nw_eval.twin.calibrate.sources.footage import Footage, found_in, in_order, number, read_json
from nw_eval.twin.calibrate.sources.nerfstudio import OPENGL

_KINDS = (("corrected_images", "corrected_cameras"), ("images", "cameras"))
"""Polycam corrects poses when it closes loops; those come first."""


def polycam_in(folder: Path) -> Footage | None:
    """Return the cameras and photographs of an export of Polycam; None if it is none.

    Raises:
        SceneError: a camera's file is damaged.
    """
    for place in (folder / "keyframes", folder):
        for images, cameras in _KINDS:
            if (place / cameras).is_dir() and (place / images).is_dir():
                return _read(place / images, place / cameras)
    return None


def _read(images: Path, cameras: Path) -> Footage:
    files: list[Found] = []
    placed: list[Placed] = []
    pictures = sorted(p.name for p in images.iterdir() if p.suffix.lower() in SUFFIXES)
    for name in pictures:
        path = found_in(cameras, f"{Path(name).stem}.json").path
        if path is None or not path.is_file():
            fault = f"{cameras.name} has no {Path(name).stem}.json"
            files.append(Found(name=name, path=None, fault=fault))
            continue
        files.append(found_in(images, name))
        placed.append(_placed(name, read_json(path)))
    if not placed:
        raise SceneError(
            f"no photograph in {images} has its camera in {cameras}", fix="export again"
        )
    return Footage(kind="polycam", files=in_order(files), cameras=Solution(placed=tuple(placed)))


def _placed(name: str, values: dict[str, Any]) -> Placed:
    def value(key: str) -> float:
        return number(values.get(key), f"{key} of {name}")

    T = np.eye(4)
    T[:3] = [[value(f"t_{row}{column}") for column in range(4)] for row in range(3)]
    lens = Lens(
        model="PINHOLE",
        width=round(value("width")),
        height=round(value("height")),
        params=tuple(value(key) for key in ("fx", "fy", "cx", "cy")),
    )
    return Placed(name=name, lens=lens, T_world_camera=rigid(T @ OPENGL, name))
