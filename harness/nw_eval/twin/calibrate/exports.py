"""Photographs with cameras in OpenGL axes, in JSON: nerfstudio's and Polycam's exports.

nerfstudio and Instant-NGP write transforms.json:
https://docs.nerf.studio/quickstart/data_conventions.html

Polycam's raw export is `keyframes/images` and one JSON of a camera beside each. `t_00` to `t_23`
are the rows of T_world_camera in ARKit's axes: y of the world up, metres; x of the camera right,
y up, z back. As nerfstudio's importer reads them, without its change of axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.clean import clean
from nw_eval.errors import SceneError
from nw_eval.files.inside import OutsideError, inside
from nw_eval.twin.calibrate.footage import Footage, found_in, in_order, number, read_json
from nw_eval.twin.calibrate.photographs import SUFFIXES, Found
from nw_eval.twin.calibrate.solution import Lens, Placed, Solution, inverse, rigid

SizeOf = Callable[[Path], tuple[int, int] | None]
FILE = "transforms.json"
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenCV's camera axes (y down, z forward) to OpenGL's (y up, z back)."""
_FISHEYES = {"OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
"""All with k1 (and k2) before the angle's odd powers."""
_KINDS = _FISHEYES | {
    "OPENCV", "FULL_OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL",
}  # fmt: skip
_FIX = "export transforms.json again"

_CAMERAS_OF = (("corrected_images", "corrected_cameras"), ("images", "cameras"))
"""Polycam corrects poses when it closes loops; those come first."""


def nerfstudio_in(folder: Path, size_of: SizeOf) -> Footage | None:
    """Return the cameras and photographs of a folder with transforms.json; None if it is none.

    The capture's frame is the one before `applied_transform`, which nerfstudio's own
    dataparser_transforms.json refers to as well.

    Args:
        folder: that holds it and the photographs.
        size_of: gives width and height of a picture file, where the JSON does not.

    Raises:
        SceneError: the file is damaged or names nothing.
    """
    if not (folder / FILE).is_file():
        return None
    whole = read_json(folder / FILE)
    frames = whole.get("frames")
    if not isinstance(frames, list) or not frames:
        raise SceneError(f"{folder / FILE} names no frames", fix=_FIX)
    applied, scale = _applied(whole, folder / FILE)
    files: list[Found] = []
    placed: list[Placed] = []
    for place, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise SceneError(f"frame {place} of {folder / FILE} has no file_path", fix=_FIX)
        one = _file(folder, frame)
        files.append(one)
        whose = f"{clean(one.name, at_most=100)} in {folder / FILE}"
        lens = _lens({**whole, **frame}, one, whose, size_of)
        if lens is not None:
            pose = _pose(frame.get("transform_matrix"), f"transform_matrix of {whose}")
            pose[:3, 3] /= scale
            pose = rigid(inverse(applied) @ pose @ OPENGL, whose)
            placed.append(Placed(name=one.name, lens=lens, T_world_camera=pose))
    alone = {one.name: one for one in files}
    poses = {one.name: one for one in placed}
    for one in placed:  # Twice the same is what splits into training and test write.
        if not np.array_equal(one.T_world_camera, poses[one.name].T_world_camera):
            raise SceneError(
                f"{folder / FILE} names the photograph {clean(one.name, at_most=100)} twice, with "
                "two poses",
                fix=_FIX,
            )
    cameras = Solution(placed=tuple(poses.values()))
    return Footage(kind="nerfstudio", files=in_order(alone.values()), cameras=cameras)


def _file(folder: Path, frame: dict[str, Any]) -> Found:
    name = frame["file_path"]
    name = name.replace("\\", "/")
    if not Path(name).suffix:  # As Blender's exporter writes them.
        name += next((s for s in (".png", *sorted(SUFFIXES)) if _is_file(folder, name + s)), ".png")
    found = found_in(folder, name, called=name.removeprefix("./"))
    mask = frame.get("mask_path")
    if not isinstance(mask, str):
        return found
    try:
        return replace(found, mask=inside(folder, mask))
    except OutsideError as error:
        raise SceneError(f"the mask {mask} is not in {folder}: {error}", fix=_FIX) from None


def _is_file(folder: Path, name: str) -> bool:
    path = found_in(folder, name).path
    return path is not None and path.is_file()


def _pose(value: Any, what: str) -> NDArray[np.float64]:
    """(4, 4) of a matrix that may lack its last row, which says nothing."""
    rows = len(value) if isinstance(value, list) else 0
    T = np.eye(4)
    T[:rows] = _array(value, (3 if rows == 3 else 4, 4), what)
    return T


def _array(value: Any, shape: tuple[int, int], what: str) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise SceneError(f"{what} is no finite matrix of shape {shape}", fix=_FIX)
    return array


def _applied(whole: dict[str, Any], file: Path) -> tuple[NDArray[np.float64], float]:
    """Return `applied_transform` (4, 4) and `applied_scale`, which came after it."""
    applied = np.eye(4)
    if "applied_transform" in whole:
        applied[:3] = _pose(whole["applied_transform"], f"applied_transform of {file}")[:3]
    scale = number(whole.get("applied_scale", 1.0), f"applied_scale of {file}")
    if scale <= 0:
        raise SceneError(f"applied_scale of {file} is {scale}", fix=_FIX)
    return rigid(applied, f"applied_transform of {file}"), scale


def _lens(values: dict[str, Any], one: Found, whose: str, size_of: SizeOf) -> Lens | None:
    """Return a frame's lens; None if its size must be looked up and its picture cannot be read."""

    def value(key: str, otherwise: float | None = None) -> float:
        if values.get(key) is None and otherwise is not None:
            return otherwise
        return number(values.get(key), f"{key} of {whose}")

    if "w" in values and "h" in values:
        width, height = round(value("w")), round(value("h"))
    else:
        size = size_of(one.path) if one.path is not None else None
        if size is None:
            return None
        width, height = size
    if "fl_x" in values:
        fx = value("fl_x")
        fy = value("fl_y", fx)
    elif "camera_angle_x" in values:
        fx = 0.5 * width / math.tan(0.5 * value("camera_angle_x"))
        fy = fx  # Blender's pixels are square, and it writes one angle.
        if values.get("camera_angle_y") is not None:
            fy = 0.5 * height / math.tan(0.5 * value("camera_angle_y"))
    else:
        raise SceneError(f"{whose} has neither fl_x nor camera_angle_x", fix=_FIX)
    pinhole = (fx, fy, value("cx", 0.5 * width), value("cy", 0.5 * height))
    bends = {key: value(key, 0.0) for key in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")}
    kind = values.get("camera_model") or "OPENCV"
    kind = "OPENCV_FISHEYE" if values.get("is_fisheye") is True else kind
    if kind not in _KINDS:
        raise SceneError(
            f"{whose} has the camera_model {clean(repr(kind), at_most=60)}",
            fix="undistort it with `colmap image_undistorter`, or give the photographs alone",
        )
    model, bent = _model(kind in _FISHEYES, **bends)
    return Lens(model=model, width=width, height=height, params=(*pinhole, *bent))


def _model(
    fisheye: bool,
    *,
    k1: float,
    k2: float,
    k3: float,
    k4: float,
    k5: float,
    k6: float,
    p1: float,
    p2: float,
) -> tuple[str, tuple[float, ...]]:
    """Return COLMAP's model that bends so, and its parameters after those of a pinhole."""
    if fisheye:
        return "OPENCV_FISHEYE", (k1, k2, k3, k4)
    if k3 or k4 or k5 or k6:  # nerfstudio undistorts by OpenCV's rational model, k4 below the line.
        return "FULL_OPENCV", (k1, k2, p1, p2, k3, k4, k5, k6)
    if k1 or k2 or p1 or p2:
        return "OPENCV", (k1, k2, p1, p2)
    return "PINHOLE", ()


def polycam_in(folder: Path) -> Footage | None:
    """Return the cameras and photographs of an export of Polycam; None if it is none.

    Raises:
        SceneError: a camera's file is damaged.
    """
    for place in (folder / "keyframes", folder):
        for images, cameras in _CAMERAS_OF:
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
