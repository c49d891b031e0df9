"""A capture: photographs without distortion, where each was taken from, and points they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.splat.camera import Camera


@dataclass(frozen=True, kw_only=True)
class PlacedShot:
    """One photograph of a capture.

    Attributes:
        name: of the photograph that was taken, e.g. `IMG_0012.jpg`.
        file: of the picture without distortion, relative to the capture's folder.
        camera: in the capture's frame.
        seen: (K,) int32, sorted: numbers of the points that it shows.
        mask: file of its mask, (H, W) where 0 is no part of the place; None without.
    """

    name: str
    file: str
    camera: Camera
    seen: NDArray[np.int32]
    mask: str | None = None


@dataclass(frozen=True, kw_only=True)
class Capture:
    """Shots and sparse points in one frame: any rotation, any scale, until it is aligned.

    Attributes:
        shots: in the order of their names.
        points: (N, 3) float64.
        colours: (N, 3) uint8.
        errors: (N,) float32, mean reprojection error of each point, pixels.
    """

    shots: tuple[PlacedShot, ...]
    points: NDArray[np.float64]
    colours: NDArray[np.uint8]
    errors: NDArray[np.float32]

    def __post_init__(self) -> None:
        """Check that all of it fits together.

        Raises:
            SceneError: naming what does not.
        """
        n = len(self.points)
        shapes = (self.points.shape, self.colours.shape, self.errors.shape)
        if shapes != ((n, 3), (n, 3), (n,)) or not np.isfinite(self.points).all():
            raise SceneError(
                f"a capture's points, colours and errors have the shapes {shapes}, or points are "
                "not finite",
                fix="calibrate again",
            )
        names = [shot.name for shot in self.shots]
        if len(set(names)) < len(names):
            raise SceneError("two shots of a capture have one name", fix="calibrate again")
        for shot in self.shots:
            if len(shot.seen) and not 0 <= shot.seen.min() <= shot.seen.max() < n:
                raise SceneError(
                    f"{shot.name} shows point {shot.seen.max()} of {n}", fix="calibrate again"
                )

    @property
    def centres(self) -> NDArray[np.float64]:
        """Where each shot was taken from, (shots, 3)."""
        return np.array([shot.camera.T_world_camera[:3, 3] for shot in self.shots]).reshape(-1, 3)
