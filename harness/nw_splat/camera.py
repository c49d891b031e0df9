"""Cameras: pose and lens, which pixels of a view are rendered, and the presets of renderers.

A preset names the numerical choices in which versions of gsplat differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.errors import UsageError, nearest
from nw_base.lens import Distortion, Intrinsics

MAX_SIDE = 16384
"""Largest image side in pixels; the engine packs pixel indices into 16 bits."""

Scalar = TypeVar("Scalar", bound=np.generic)

Rows = tuple[int, int]
"""(first row, end row) of those that a pixel set takes."""

Window = tuple[int, int, int, int]
"""(first column, end column, first row, end row) in taken pixels."""

PresetName = Literal["gsplat-1.5", "gsplat-1.6"]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera in OpenCV axes: x right, y down, z forward.

    Attributes:
        width, height: image size in pixels.
        fx, fy, cx, cy: focal lengths and principal point in pixels; the centre of the first pixel
            is at (0.5, 0.5).
        T_world_camera: (4, 4) float64, maps camera points to world. The 3x3 block may be a rotation
            times a positive scale s; then depth and near are in camera units, 1 / s of world units.
        near, far: planes in camera units; Gaussians with centres outside are not drawn.
        distortion: of the lens; None = a pinhole.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    T_world_camera: NDArray[np.float64]
    near: float = 0.01
    far: float = 1e10
    distortion: Distortion | None = None

    def __post_init__(self) -> None:
        """Check the numbers once, here, so that no kernel meets a camera that makes no sense.

        Raises:
            UsageError: naming the field, its value and what it must be.
        """
        T = np.array(self.T_world_camera, dtype=np.float64)
        object.__setattr__(self, "T_world_camera", T)
        T.flags.writeable = False
        for name in ("width", "height"):
            if not 1 <= getattr(self, name) <= MAX_SIDE:
                raise UsageError(
                    f"camera {name} is {getattr(self, name)}", fix=f"give 1 to {MAX_SIDE} pixels"
                )
        for name in ("fx", "fy"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise UsageError(f"camera {name} is {value}", fix="give a positive focal length")
        for name in ("cx", "cy"):
            if not math.isfinite(getattr(self, name)):
                raise UsageError(f"camera {name} is {getattr(self, name)}", fix="give pixels")
        if not 0 < self.near < self.far:
            raise UsageError(
                f"camera planes are near={self.near}, far={self.far}", fix="give 0 < near < far"
            )
        if T.shape != (4, 4) or not np.isfinite(T).all():
            raise UsageError(
                f"T_world_camera has shape {T.shape}, finite: {bool(np.isfinite(T).all())}",
                fix="give a finite 4x4 matrix",
            )
        gram = T[:3, :3].T @ T[:3, :3]
        scale = gram[0, 0]
        if scale <= 0 or np.abs(gram - scale * np.eye(3)).max() > 1e-4 * scale:
            raise UsageError(
                f"T_world_camera is not a rotation times a scale: {T[:3, :3].tolist()}",
                fix="orthonormalise its 3x3 block",
            )

    @classmethod
    def from_fovy(
        cls, *, width: int, height: int, fovy: float, T_world_camera: NDArray[np.float64]
    ) -> Camera:
        """Return a camera with square pixels and centred axis; fovy in radians, vertical."""
        if not 0 < fovy < math.pi:
            raise UsageError(f"camera fovy is {fovy}", fix="give radians between 0 and pi")
        return cls.of(Intrinsics.from_fovy(width, height, fovy), T_world_camera)

    @classmethod
    def of(cls, lens: Intrinsics, T_world_camera: NDArray[np.float64]) -> Camera:
        """Return a camera with a lens."""
        return cls(
            width=lens.width,
            height=lens.height,
            fx=lens.fx,
            fy=lens.fy,
            cx=lens.cx,
            cy=lens.cy,
            T_world_camera=T_world_camera,
            distortion=lens.distortion,
        )

    @property
    def lens(self) -> Intrinsics:
        """The camera's lens."""
        return Intrinsics.model_construct(
            width=self.width,
            height=self.height,
            fx=self.fx,
            fy=self.fy,
            cx=self.cx,
            cy=self.cy,
            distortion=self.distortion,
        )

    @property
    def T_camera_world(self) -> NDArray[np.float64]:  # noqa: N802 - as the field is named.
        """(4, 4) float64, maps world points to camera: the view matrix."""
        return same_bits.inverse(self.T_world_camera)


def look_at(
    eye: tuple[float, float, float] | NDArray[np.float64],
    target: tuple[float, float, float] | NDArray[np.float64],
    up: tuple[float, float, float] | NDArray[np.float64] = (0.0, 0.0, 1.0),
) -> NDArray[np.float64]:
    """Return T_world_camera (4, 4) of a camera at `eye` that looks at `target`, `up` upwards.

    Raises:
        UsageError: when eye and target coincide or the view is along `up`.
    """
    origin = np.asarray(eye, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - origin
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(right) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
        raise UsageError(
            f"no view from {origin} to {np.asarray(target)}", fix="choose another target or up"
        )
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = right, np.cross(forward, right), forward, origin
    return T


@dataclass(frozen=True, kw_only=True)
class Pixels:
    """A block of pixels out of every stride x stride cell of an image.

    The published 80x45 image of a 1280x720 view reads the 2x2 block at (7, 7) of every 16x16 cell
    (an OpenCV bilinear resize by 16 without antialias): `Pixels(stride=16, block=2, offset=7)`
    renders those 14,400 pixels and no others. Columns and rows beyond the last whole cell are
    dropped.

    Attributes:
        stride: cell side in pixels.
        block: pixels taken along each side of a cell.
        offset: the first pixel taken within a cell, along both axes.
    """

    stride: int = 1
    block: int = 1
    offset: int = 0

    def __post_init__(self) -> None:
        """Check that the block lies within its cell.

        Raises:
            UsageError: when it does not.
        """
        if self.stride < 1 or self.block < 1 or self.offset < 0:
            raise UsageError(
                f"{self} is not a pixel set", fix="give stride, block >= 1, offset >= 0"
            )
        if self.offset + self.block > self.stride:
            raise UsageError(f"{self} reaches beyond its cell", fix="keep offset + block <= stride")

    def count(self, side: int) -> int:
        """Number of pixels taken along an image side of `side` pixels."""
        return side // self.stride * self.block

    def indices(self, side: int) -> NDArray[np.int64]:
        """(count,) pixel indices taken along an image side of `side` pixels."""
        cells = np.arange(side // self.stride)[:, None] * self.stride
        return (cells + self.offset + np.arange(self.block)).reshape(-1)

    def times(self, factor: int) -> Pixels:
        """Return the set that takes the same pixels, each as factor x factor smaller ones."""
        return Pixels(
            stride=self.stride * factor, block=self.block * factor, offset=self.offset * factor
        )

    def index(self, number: int) -> int:
        """Pixel index of the number-th pixel taken along a side."""
        cell, within = divmod(number, self.block)
        return cell * self.stride + self.offset + within

    def crop(self, image: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return the pixels of a full image (H, W, ...): (H', W', ...)."""
        rows, columns = self.indices(image.shape[0]), self.indices(image.shape[1])
        return image[rows][:, columns]

    def mean(self, image: NDArray[Any]) -> NDArray[Any]:
        """Average each block of an image rendered with this set: (H'/block, W'/block, ...)."""
        b = self.block
        h, w = image.shape[0] // b, image.shape[1] // b
        return image.reshape(h, b, w, b, *image.shape[2:]).mean(axis=(1, 3))


def view_vector(
    camera: Camera,
    pixels: Pixels,
    window: Window,
    *,
    near: float | None = None,
    samples: int = 1,
) -> NDArray[np.float32]:
    """Return the (SIZE,) float32 vector of a camera and a window of its pixel set.

    Bounds of the Jacobian are gsplat's: the image and 15 % of its width on either side.

    Args:
        camera: the camera.
        pixels: of the image, or of its samples.
        window: of the pixel set.
        near: the near plane in place of the camera's.
        samples: along each side of a pixel; the vector counts in them.
    """
    # Few calls of NumPy: it is done for every frame, and between frames all code is cold.
    T_camera_world = camera.T_camera_world[:3]
    rows = T_camera_world.tolist()
    margin_x = 0.15 * camera.width / camera.fx
    margin_y = 0.15 * camera.height / camera.fy
    x_low = -(camera.cx / camera.fx + margin_x)
    x_high = (camera.width - camera.cx) / camera.fx + margin_x
    y_low = -(camera.cy / camera.fy + margin_y)
    y_high = (camera.height - camera.cy) / camera.fy + margin_y
    scale = same_bits.length(T_camera_world[:, 0])
    steepest_x, steepest_y = max(abs(x_low), abs(x_high)), max(abs(y_low), abs(y_high))
    column0, column1, row0, row1 = window
    return np.array(
        [
            *(number for row in rows for number in row[:3]),
            *(row[3] for row in rows),
            *(samples * side for side in (camera.fx, camera.fy, camera.cx, camera.cy)),
            *(x_low, x_high, y_low, y_high),
            *(camera.near if near is None else near, camera.far),
            *(pixels.stride, 1.0 / pixels.stride, pixels.offset, pixels.block),
            *window,
            *(pixels.index(column0), pixels.index(column1 - 1) + 1),
            *(pixels.index(row0), pixels.index(row1 - 1) + 1),
            *camera.T_world_camera[:3, 3].tolist(),
            samples * scale * camera.fx * math.sqrt(1.0 + steepest_x**2),
            samples * scale * camera.fy * math.sqrt(1.0 + steepest_y**2),
            0.0,
        ],
        dtype=np.float32,
    )


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Constants of one version of gsplat that differ between versions.

    Attributes:
        max_alpha: a splat's alpha is clamped to it.
        min_compensation: floor of the antialiased factor on opacity.
        eps2d: variance added to every footprint, in pixels squared.
    """

    max_alpha: float
    min_compensation: float
    eps2d: float = 0.3


PRESETS: dict[PresetName, Preset] = {
    # gsplat 1.5.3, rasterize_to_pixels and add_blur.
    "gsplat-1.5": Preset(max_alpha=0.999, min_compensation=0.0),
    # gsplat 1.6.0, gsplat/cuda/_constants.py.
    "gsplat-1.6": Preset(max_alpha=0.99, min_compensation=0.005),
}


def get_preset(name: str) -> Preset:
    """Return a preset by name.

    Raises:
        UsageError: for an unknown name, with the nearest known one.
    """
    if name not in PRESETS:
        raise UsageError(f"unknown splat preset {name!r}", fix=nearest(name, PRESETS))
    return PRESETS[name]
