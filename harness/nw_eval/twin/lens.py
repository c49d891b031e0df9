"""Camera models by COLMAP's names and parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nw_eval.errors import SceneError
from nw_eval.twin.packages import package


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A camera model of COLMAP.

    Attributes:
        model: COLMAP's name, e.g. `OPENCV`.
        width, height: pixels of its pictures.
        params: in COLMAP's order; the centre of the first pixel is at (0.5, 0.5).
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def camera(self) -> Any:
        """Return it as a `pycolmap.Camera`.

        Raises:
            SceneError: no such model, or not its parameters.
        """
        pycolmap = package("pycolmap")
        try:
            camera = pycolmap.Camera(
                model=self.model, width=self.width, height=self.height, params=list(self.params)
            )
            good = (
                camera.verify_params()
                and not camera.has_bogus_params(0.05, 50.0, 50.0)
                and min(camera.focal_length_x, camera.focal_length_y) > 0
            )
        except (ValueError, RuntimeError, AttributeError, KeyError) as error:
            raise self._unusable(str(error)) from None
        if not (good and np.isfinite(self.params).all()):
            raise self._unusable("its numbers make no lens")
        if not (0 < self.width < 2**15 and 0 < self.height < 2**15):
            raise self._unusable("it has no such pictures")
        return camera

    def _unusable(self, why: str) -> SceneError:
        return SceneError(
            f"a camera {self.model} of {self.width} x {self.height} pixels with "
            f"{list(self.params)} cannot be used: {why}",
            fix="export the cameras again, or give the photographs alone",
        )

    def resized(self, width: int, height: int) -> Lens:
        """Return the lens of the same pictures at another size."""
        camera = self.camera()
        camera.rescale(width, height)
        return Lens(model=self.model, width=width, height=height, params=tuple(camera.params))
