"""Pictures without distortion, and the capture that they are part of."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from nw_base.errors import SceneError, StoreError
from nw_base.files.pictures import open_picture
from nw_splat.camera import Camera
from nw_twin.calibrate.photographs import Photograph
from nw_twin.calibrate.report import Pace, Say
from nw_twin.calibrate.solution import Placed, Solution
from nw_twin.capture import Capture, PlacedShot
from nw_twin.lens import Lens
from nw_twin.packages import package

_MUCH = 0.97
"""Share of a photograph's pixels below which it is said that some are cut off."""
_OURS = re.compile(r"[0-9]{6}\.(?:png|jpg)")


@dataclass(frozen=True, kw_only=True)
class Flattening:
    """How pictures through one lens become pictures of a pinhole.

    Attributes:
        fx, fy, cx, cy: of the pinhole, pixels.
        size: of its pictures, (width, height).
        maps: (H, W) each, float32: column and row of the photograph that each pixel shows, the
            first pixel's centre at 0 as OpenCV counts; None if there is nothing to bend.
        known: (H, W) bool, pixels that the photograph shows; None = all.
        used: share of the photograph's pixels that they show, where much is cut off.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    size: tuple[int, int]
    maps: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None
    known: NDArray[np.bool_] | None = None
    used: float = 1.0

    @classmethod
    def of(cls, lens: Lens) -> Flattening:
        """Return the flattening of a lens to COLMAP's pinhole, all of which the photograph shows.

        A lens that sees 95 degrees or more across or down becomes a pinhole with as many pixels a
        degree in its middle, that sees 50 degrees to each side at most. COLMAP's would show 20 to
        160 degrees of it, by the model.

        Raises:
            SceneError: no pinhole shows what this lens does.
        """
        pycolmap = package("pycolmap")
        camera = lens.camera()
        straight = lens.model in {"PINHOLE", "SIMPLE_PINHOLE"}
        wide = None if straight else _wide(camera)
        try:
            flat = (
                camera
                if straight
                else wide or pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
            )
        except (ValueError, RuntimeError) as error:
            raise SceneError(
                f"pictures of {lens.model} {list(lens.params)} cannot be flattened: {error}",
                fix="calibrate with another lens",
            ) from None
        width, height = int(flat.width), int(flat.height)
        bent = None if straight else _bent(camera, flat)
        return cls(
            fx=float(flat.focal_length_x),
            fy=float(flat.focal_length_y),
            cx=float(flat.principal_point_x),
            cy=float(flat.principal_point_y),
            size=(width, height),
            maps=None if bent is None else bent[:2],
            known=None if bent is None or bent[2].all() else bent[2],
            used=1.0 if wide is None or bent is None else _used(camera, bent),
        )

    def develop(self, picture: NDArray[np.uint8], *, nearest: bool = False) -> NDArray[np.uint8]:
        """Return a photograph (H, W, 3), or a mask (H, W) by `nearest`, without distortion."""
        if self.maps is None:
            return picture
        cv2 = package("cv2")
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        return cv2.remap(picture, *self.maps, how, borderMode=cv2.BORDER_REPLICATE)


_EDGE = 50.0
"""Degrees from the axis that a flat picture shows, at most."""
_WIDE = 95.0
"""Degrees across or down at which a lens is a wide one."""


def _wide(camera: Any) -> Any:
    """Return the pinhole of a wide lens; None for another lens."""
    pycolmap = package("pycolmap")
    steps = np.arange(0.5, _EDGE + 0.5, 0.5)
    reach: list[float] = []
    scales: list[float] = []
    for direction in ([1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]):
        rays = np.c_[np.tan(np.radians(steps))[:, None] * direction, np.ones(len(steps))]
        seen = np.asarray(camera.img_from_cam(np.r_[[[0.0, 0.0, 1.0]], rays]))
        out = (seen - seen[0]) @ direction
        inside = np.all((seen >= 0) & (seen <= [camera.width, camera.height]), axis=1)
        good = inside[1:] & (np.diff(out) > 0)  # A model may turn back at its own edge.
        reach.append(0.5 * float(np.logical_and.accumulate(good).sum()))
        scales.append(float(out[1] / np.tan(np.radians(steps[0]))))
    right, left, down, up = np.tan(np.radians(reach))
    if max(reach[0] + reach[1], reach[2] + reach[3]) < _WIDE or min(reach) <= 0:
        return None
    fx, fy = (scales[0] + scales[1]) / 2, (scales[2] + scales[3]) / 2
    width, height = int(fx * (left + right)), int(fy * (up + down))
    return pycolmap.Camera(
        model="PINHOLE", width=width, height=height, params=[fx, fy, fx * left, fy * up]
    )


def _used(
    camera: Any, bent: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]
) -> float:
    """Return the share of a photograph that lies within the edge of its flat picture."""
    u, v = np.clip(bent[0], 0, camera.width), np.clip(bent[1], 0, camera.height)
    edge = np.stack([np.r_[m[0], m[1:, -1], m[-1, -2::-1], m[-2:0:-1, 0]] for m in (u, v)], axis=1)
    area = package("cv2").contourArea(edge.astype(np.float32))
    return float(area) / (camera.width * camera.height)


def _bent(
    camera: Any, flat: Any
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Return where a photograph shows each pixel of a flat picture, and whether it does."""
    x, y = np.meshgrid(np.arange(flat.width) + 0.5, np.arange(flat.height) + 0.5)
    rays = np.stack(
        [
            (x - flat.principal_point_x) / flat.focal_length_x,
            (y - flat.principal_point_y) / flat.focal_length_y,
            np.ones_like(x),
        ],
        axis=-1,
    )
    seen = np.asarray(camera.img_from_cam(rays.reshape(-1, 3))).reshape(*x.shape, 2)
    u, v = np.nan_to_num(seen, nan=-1e6).transpose(2, 0, 1)
    known = (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
    return (u - 0.5).astype(np.float32), (v - 0.5).astype(np.float32), known


def develop(
    photographs: Sequence[Photograph], solution: Solution, out: Path, *, side: int, say: Say
) -> Capture:
    """Write the pictures of a capture, and masks where there are some; return the capture.

    Args:
        photographs: all that can be read.
        solution: of some of them.
        out: gets `pictures/`, and `masks/` if need be; pictures of an earlier calibration go.
        side: pixels of the longer side, at most.
        say: is given lines of progress.

    Raises:
        StoreError: pictures cannot be written.
        SceneError: a lens cannot be flattened.
    """
    placed = solution.by_name
    left = [one for one in photographs if one.name in placed]
    flattenings: dict[Lens, Flattening] = {}
    shots: list[PlacedShot] = []
    pace = Pace(say, "pictures developed", len(left))
    try:
        for folder in (out / "pictures", out / "masks"):
            _clear(folder)
        (out / "pictures").mkdir(parents=True, exist_ok=True)
        for number, one in enumerate(left):
            lens = placed[one.name].lens
            if lens not in flattenings:
                flattenings[lens] = flat = Flattening.of(lens)
                if flat.used < _MUCH:
                    across, down = (
                        2 * math.degrees(math.atan(flat.size[i] / (2 * (flat.fx, flat.fy)[i])))
                        for i in (0, 1)
                    )
                    say(
                        f"{lens.model} is wide: of its pictures {across:.0f} x {down:.0f} degrees "
                        f"are kept, {flat.used:.0%} of their pixels"
                    )
            shots.append(
                _shot(one, placed[one.name], solution.points, flattenings[lens], number, out, side)
            )
            pace.at(number + 1)
    except OSError as error:
        raise StoreError(
            f"cannot write pictures to {out}: {error}", fix="free disk space"
        ) from None
    return Capture(
        shots=tuple(shots),
        points=solution.points,
        colours=solution.colours,
        errors=solution.errors,
    )


def _clear(folder: Path) -> None:
    """Remove an earlier calibration's pictures, and nothing that it did not write."""
    if folder.is_dir() and not folder.is_symlink():
        for path in folder.iterdir():
            if _OURS.fullmatch(path.name):
                path.unlink()


def _shot(
    one: Photograph,
    placed: Placed,
    points: NDArray[np.float64],
    flattening: Flattening,
    number: int,
    out: Path,
    side: int,
) -> PlacedShot:
    cv2 = package("cv2")
    with open_picture(one.path) as image:
        picture = flattening.develop(np.asarray(image.convert("RGB")))
    width, height = flattening.size
    share = min(1.0, side / max(width, height))
    size = max(1, round(width * share)), max(1, round(height * share))
    if size != flattening.size:
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    file = f"pictures/{number:06d}{one.path.suffix}"
    Image.fromarray(picture).save(out / file, quality=95, subsampling=0)  # PNG has neither.
    mask = _developed_mask(one, flattening)
    if mask is not None:
        (out / "masks").mkdir(exist_ok=True)
        # A pixel counts if all that it shows does.
        mask = cv2.resize(mask, size, interpolation=cv2.INTER_AREA) == 255
        Image.fromarray(mask.astype(np.uint8) * 255).save(out / f"masks/{number:06d}.png")
    camera = Camera(
        width=size[0],
        height=size[1],
        fx=flattening.fx * size[0] / width,
        fy=flattening.fy * size[1] / height,
        cx=flattening.cx * size[0] / width,
        cy=flattening.cy * size[1] / height,
        T_world_camera=placed.T_world_camera,
    )
    return PlacedShot(
        name=one.name,
        file=file,
        mask=None if mask is None else f"masks/{number:06d}.png",
        seen=placed.seen[_is_shown(points[placed.seen], camera)],
        camera=camera,
        lens=placed.lens,
    )


def _is_shown(points: NDArray[np.float64], camera: Camera) -> NDArray[np.bool_]:
    """Return which points lie in a picture: a flat one lacks the photograph's corners."""
    T = camera.T_world_camera
    x, y, z = ((points - T[:3, 3]) @ T[:3, :3]).T
    u, v = camera.fx * x + camera.cx * z, camera.fy * y + camera.cy * z  # Times z, which may be 0.
    return (z > 0) & (u >= 0) & (u <= camera.width * z) & (v >= 0) & (v <= camera.height * z)


def _developed_mask(one: Photograph, flattening: Flattening) -> NDArray[np.uint8] | None:
    """Return the mask of a flat picture, 0 where the photograph's is or where it shows nothing."""
    if one.mask is None and flattening.known is None:
        return None
    mask = np.full(flattening.size[::-1], 255, np.uint8)
    if one.mask is not None:
        with open_picture(one.mask) as image:
            mask = flattening.develop(np.asarray(image.convert("L")), nearest=True).copy()
    if flattening.known is not None:
        mask[~flattening.known] = 0
    return mask
