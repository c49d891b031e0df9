"""Shots as they are compared: grey, no larger than they have to be, each with its neighbours.

Which pictures each picture is compared with, and between which depths, is told by the points that
they share.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import UnidentifiedImageError

from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, inside
from nw_base.files.pictures import open_picture
from nw_twin.capture import Capture, PlacedShot, read_picture
from nw_twin.packages import package

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

BEST_ANGLE = np.deg2rad(12.0)
"""Between two views of a point: less measures depth badly, more changes how things look."""
_LEAST_POINTS = 8
_MARGIN = 1.15

_ABOUT = 12
"""Points that a plane is fitted to, the nearest."""
_FLAT = 0.25
"""Spread across a plane's points, a share of that along it, up to which they lie on one."""
_GOES_ON = 8.0
"""Times the radius of its points that a plane goes on."""
_ASKED = 60
"""Points about a pixel's whose planes are tried."""
_ALIKE = float(np.cos(np.deg2rad(30.0)))
"""Cosine of the angle by which a pixel's normal may be off such a plane's."""
_OFF = 0.02
"""Distance from such a plane, a share of the depth."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkingView:
    """A shot at the size that it is worked at.

    Attributes:
        name: of the shot.
        rgb: (H, W, 3) uint8.
        mask: (H, W) bool, what is part of the scene; None for everything.
        K: (3, 3), the first pixel's centre at (0.5, 0.5).
        T_camera_world: (4, 4).
    """

    name: str
    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_] | None
    K: F64
    T_camera_world: F64

    @property
    def grey(self) -> F32:
        """Grey levels about 0, (H, W): products of large ones would lose digits."""
        return (self.rgb @ np.array([0.299, 0.587, 0.114], np.float32)) - np.float32(128.0)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, pixels."""
        return self.rgb.shape[0], self.rgb.shape[1]

    def to(self, other: WorkingView) -> tuple[F64, F64]:
        """Return K' R K^-1 (3, 3) and K' t (3,): from this view's pixels to another's."""
        T = other.T_camera_world @ np.linalg.inv(self.T_camera_world)
        return other.K @ T[:3, :3] @ np.linalg.inv(self.K), other.K @ T[:3, 3]


def read_view(shot: PlacedShot, folder: Path, side: int) -> WorkingView:
    """Read a shot of a capture's folder, at most `side` pixels long.

    Raises:
        SceneError: its picture or its mask cannot be read.
        PrerequisiteError: OpenCV is not installed.
    """
    cv2 = package("cv2")
    rgb, mask, camera = read_picture(shot, folder), _mask(shot, folder), shot.camera
    share = min(1.0, side / max(camera.width, camera.height))
    width, height = round(camera.width * share), round(camera.height * share)
    if share < 1.0:
        rgb = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)
    if mask is not None:
        mask = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST) > 0
    K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    K[0] *= width / camera.width
    K[1] *= height / camera.height
    return WorkingView(
        name=shot.name, rgb=rgb, mask=mask, K=K, T_camera_world=camera.T_camera_world
    )


def _mask(shot: PlacedShot, folder: Path) -> NDArray[np.uint8] | None:
    if shot.mask is None:
        return None
    try:
        with open_picture(inside(folder, shot.mask)) as image:
            if image.size != (shot.camera.width, shot.camera.height):
                raise SceneError(
                    f"{shot.mask} has {image.size} pixels, its camera "
                    f"{(shot.camera.width, shot.camera.height)}",
                    fix="give masks of the pictures' size",
                )
            return np.asarray(image.convert("L"))
    except (OSError, UnidentifiedImageError, ValueError, SyntaxError, OutsideError) as error:
        raise SceneError(f"{shot.mask} cannot be read: {error}", fix="give a PNG") from None


def neighbours_of(capture: Capture, count: int) -> list[list[int]]:
    """Return for each shot the numbers of up to `count` others, best first.

    A pair scores the points that both show, each by the angle between the two views of it: as its
    square up to `BEST_ANGLE`, and falling with the square of what is beyond.
    """
    centres = capture.centres
    scores = np.zeros((len(capture.shots), len(capture.shots)))
    for i, shot in enumerate(capture.shots):
        for j in range(i):
            shared = np.intersect1d(shot.seen, capture.shots[j].seen, assume_unique=True)
            if len(shared) >= _LEAST_POINTS:
                angles = _angles(capture.points[shared], centres[i], centres[j]) / BEST_ANGLE
                worth = np.minimum(angles, 1.0 / np.maximum(angles, 1e-9)) ** 2
                scores[i, j] = scores[j, i] = worth.sum()
    orders = np.argsort(-scores, axis=1, kind="stable")[:, :count]
    return [[int(j) for j in order if scores[i, j] > 0.0] for i, order in enumerate(orders)]


def _angles(
    points: NDArray[np.float64], one: NDArray[np.float64], other: NDArray[np.float64]
) -> NDArray[np.float64]:
    a, b = one - points, other - points
    cosine = (a * b).sum(axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) + 1e-300)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def depth_range(capture: Capture, index: int) -> tuple[float, float] | None:
    """Return the nearest and the farthest depth of a shot, or None if it shows too few points.

    They are the first and the last percentile of its points' depths, and 15 percent more. The
    nearest is no farther than points of other shots that lie in its picture: what is close is often
    plain, and was matched elsewhere.
    """
    shot = capture.shots[index]
    camera, T = shot.camera, shot.camera.T_camera_world
    local = capture.points @ T[:3, :3].T + T[:3, 3]
    depth = local[shot.seen, 2]
    depth = depth[depth > 0.0]
    if len(depth) < _LEAST_POINTS:
        return None
    near, far = np.percentile(depth, [1.0, 99.0])
    ahead = local[local[:, 2] > 0.0]
    u = camera.fx * ahead[:, 0] / ahead[:, 2] + camera.cx
    v = camera.fy * ahead[:, 1] / ahead[:, 2] + camera.cy
    shown = ahead[(u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height), 2]
    if len(shown) >= _LEAST_POINTS:
        near = min(near, np.percentile(shown, 1.0))
    return float(near) / _MARGIN, float(far) * _MARGIN


@dataclass(frozen=True, kw_only=True, eq=False)
class SparsePlanes:
    """Planes through the calibration's points, each fitted to a point and those around it.

    Attributes:
        tree: of the points that have a plane.
        normals: (N, 3) unit vectors, either way.
        offsets: (N,) along them.
        reach: (N,) distance from its point up to which a plane is one.
        rough: (N,) how far the points that it is fitted to are off it.
    """

    tree: Any
    normals: F64
    offsets: F64
    reach: F64
    rough: F64

    @classmethod
    def of(cls, capture: Capture) -> SparsePlanes:
        """Fit a plane about each point that lies on one with its neighbours."""
        spatial, points = package("scipy.spatial"), capture.points
        count = min(_ABOUT, len(points))
        away, near = spatial.cKDTree(points).query(points, k=count)
        around = points[near] - points[near].mean(axis=1, keepdims=True)
        _, spread, axes = np.linalg.svd(around, full_matrices=False)
        rough = spread[:, -1] / np.sqrt(count)
        flat = (rough < _FLAT * spread[:, 1] / np.sqrt(count)) & (away[:, -1] > 0.0)
        normals = axes[flat, -1]
        return cls(
            tree=spatial.cKDTree(points[flat]) if flat.any() else None,
            normals=normals,
            offsets=(normals * points[near].mean(axis=1)[flat]).sum(axis=1),
            reach=_GOES_ON * away[flat, -1],
            rough=rough[flat],
        )

    def near(self, view: WorkingView, planes: F32, asked: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which of the asked pixels' planes are those of points near them, (asked,).

        Args:
            view: of which the pixels are.
            planes: (H, W, 4) depth and normal in the camera's frame.
            asked: (H, W).
        """
        rows, columns = np.nonzero(asked)
        if self.tree is None or len(rows) == 0:
            return np.zeros(len(rows), np.bool_)
        K, T = view.K, np.linalg.inv(view.T_camera_world)
        depth = planes[asked, 0].astype(np.float64)
        rays = np.stack([(columns + 0.5 - K[0, 2]) / K[0, 0], (rows + 0.5 - K[1, 2]) / K[1, 1]])
        local = np.column_stack([rays.T, np.ones(len(rows))]) * depth[:, None]
        points, normals = local @ T[:3, :3].T + T[:3, 3], planes[asked, 1:] @ T[:3, :3].T
        away, which = self.tree.query(points, k=min(_ASKED, len(self.offsets)))
        away, which = away.reshape(len(rows), -1), which.reshape(len(rows), -1)
        off = np.abs((self.normals[which] * points[:, None]).sum(axis=-1) - self.offsets[which])
        alike = np.abs((self.normals[which] * normals[:, None]).sum(axis=-1)) > _ALIKE
        on = off < 2.0 * self.rough[which] + _OFF * depth[:, None]
        return (alike & on & (away < self.reach[which])).any(axis=1)
