"""A look into a place from above: what lies higher than a level is hidden, and clicks go through.

Only the view is cut. Nothing of the place is lost by it; a crop does that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.label.course.ground import Ground
from nw_eval.twin.label.crop import CropBox, cropped
from nw_eval.twin.label.page.splat_points import SplatPoints
from nw_eval.twin.label.placement import Placement, Point, as_point, mapped

_FAR = 1e9  # m
_OVERHEAD = 1.2  # m above a start; what hangs higher there is a ceiling
_SKY = 8.0  # m above a start; higher things hide nothing


@dataclass(frozen=True, kw_only=True)
class Cutaway:
    """What is shown of a place.

    Attributes:
        level: height above which nothing is; world, m; None = all is shown.
    """

    level: float | None = None

    def of_mesh(self, mesh: TriangleMesh) -> TriangleMesh:
        """Return the part of a mesh that is shown."""
        if self.level is None or mesh.vertices[:, 2].max() <= self.level:
            return mesh
        return cropped(mesh, CropBox(low=(-_FAR, -_FAR, -_FAR), high=(_FAR, _FAR, self.level)))

    def of_splat(
        self, splat: SplatPoints, placement: Placement, crop: CropBox | None
    ) -> SplatPoints:
        """Return the Gaussians that are shown, in the frame that they came in.

        Args:
            splat: of the place as it was opened.
            placement: where that lies now.
            crop: what is kept of it, in the world; None = all.
        """
        if crop is None and self.level is None:
            return splat
        at = mapped(splat.centers.astype(np.float64), placement.matrix)
        shown = np.ones(len(at), dtype=np.bool_)
        if crop is not None:
            shown &= ((at >= crop.low) & (at <= crop.high)).all(axis=1)
        if self.level is not None:
            shown &= at[:, 2] <= self.level
        return splat.take(shown)

    def ray(self, origin: Point, direction: Point) -> Point | None:
        """Return where a ray (world, m) comes into what is shown; None where it does not."""
        if self.level is None or origin[2] <= self.level:
            return origin
        if direction[2] >= 0:
            return None
        share = (self.level - origin[2]) / direction[2]
        return as_point(np.array(origin) + share * np.array(direction))


def ceiling_level(ground: Ground, start: Point) -> float | None:
    """Return a level below the ceiling over a start, world, m; None where the sky is."""
    x, y, z = start
    above = ground.hit((x, y, z + _OVERHEAD), (0.0, 0.0, 1.0))
    return None if above is None or above[2] > z + _SKY else z + _OVERHEAD
