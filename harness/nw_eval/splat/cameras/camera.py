"""A pinhole camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError

MAX_SIDE = 16384
"""Largest image side in pixels; the engine packs pixel indices into 16 bits."""


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
        focal = 0.5 * height / math.tan(0.5 * fovy)
        return cls(
            width=width,
            height=height,
            fx=focal,
            fy=focal,
            cx=0.5 * width,
            cy=0.5 * height,
            T_world_camera=T_world_camera,
        )

    @property
    def T_camera_world(self) -> NDArray[np.float64]:  # noqa: N802 - as the field is named.
        """(4, 4) float64, maps world points to camera: the view matrix."""
        return np.linalg.inv(self.T_world_camera).astype(np.float64)


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
