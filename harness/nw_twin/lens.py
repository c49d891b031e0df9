"""Camera models by COLMAP's names and parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nw_base.errors import SceneError
from nw_twin.packages import package

_ONE_FOCAL = frozenset(
    {
        *("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
        *("SIMPLE_DIVISION", "SIMPLE_FISHEYE"),
    }
)
"""Models of one focal length; the others have two, and all have a centre next."""
_FOCALS, _BEND = (0.05, 50.0), 50.0
"""Least and largest focal length, as shares of the longer side, and largest other number: COLMAP's
`has_bogus_params` with bounds that leave out what no lens is."""
_MOST_SIDE = 2**15


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
        self.check()
        try:
            camera = pycolmap.Camera(
                model=self.model, width=self.width, height=self.height, params=list(self.params)
            )
            good = camera.verify_params()
        except (ValueError, RuntimeError, AttributeError, KeyError) as error:
            raise self._unusable(str(error)) from None
        if not good:
            raise self._unusable("its numbers make no lens")
        return camera

    def check(self, whose: str = "") -> None:
        """Check that the numbers are those of a lens; no package is needed.

        Args:
            whose: beginning of the message: the file, and the camera in it.

        Raises:
            SceneError: they are not.
        """
        if not (0 < self.width < _MOST_SIDE and 0 < self.height < _MOST_SIDE):
            raise self._unusable("it has no such pictures", whose)
        values = np.array(self.params, dtype=np.float64)
        count = 1 if self.model in _ONE_FOCAL else 2
        focal, centre, rest = np.split(values, [count, count + 2])
        if len(centre) < 2 or not np.isfinite(values).all():
            raise self._unusable("its numbers make no lens", whose)
        share = focal / max(self.width, self.height)
        if (share < _FOCALS[0]).any() or (share > _FOCALS[1]).any():
            low, high = (bound * max(self.width, self.height) for bound in _FOCALS)
            why = f"its focal length is not between {low:g} and {high:g} pixels"
            raise self._unusable(why, whose)
        if (centre < 0).any() or (centre > (self.width, self.height)).any():
            raise self._unusable("its centre is outside of its pictures", whose)
        if (np.abs(rest) > _BEND).any():
            raise self._unusable(f"a distortion is over {_BEND:g}", whose)

    def _unusable(self, why: str, whose: str = "") -> SceneError:
        return SceneError(
            f"{whose}{': ' if whose else ''}a camera {self.model} of {self.width} x {self.height} "
            f"pixels with {list(self.params)} cannot be used: {why}",
            fix="export the cameras again, or give the photographs alone",
        )

    def resized(self, width: int, height: int) -> Lens:
        """Return the lens of the same pictures at another size."""
        camera = self.camera()
        camera.rescale(width, height)
        return Lens(model=self.model, width=width, height=height, params=tuple(camera.params))
