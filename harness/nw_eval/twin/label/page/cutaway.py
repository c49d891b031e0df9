"""A look into a place from above: what lies higher than a level is hidden, and clicks go through.

Only the view is cut. Nothing of the place is lost by it; a crop does that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.twin.label.course.ground import Ground
from nw_eval.twin.label.crop import CropBox, cropped
from nw_eval.twin.label.placement import Placement, Point, as_point, mapped
from nw_eval.viewing.browser import SplatPoints

_FAR = 1e9  # m
_OVERHEAD = 1.2  # m above a start; what hangs higher there is a ceiling
_SEEN = 0.7  # share of light; with less, what is behind is a haze
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


def first_level(
    ground: Ground, splat: SplatPoints | None, eye: Point, start: Point
) -> float | None:
    """Return a level to cut the view at, world, m; None where a start is seen without.

    Args:
        ground: of the place; a ceiling of it over the start is cut away.
        splat: likewise treetops and roofs of it between eye and start; world; None = there is none.
        eye: from where the start is looked at.
        start: on the ground.
    """
    x, y, z = start
    level = z + _OVERHEAD
    above = ground.hit((x, y, level), (0.0, 0.0, 1.0))
    if above is not None and above[2] <= z + _SKY:
        return level
    if splat is not None and let_through(splat, eye, (x, y, level)) < _SEEN:
        return level
    return None


def let_through(splat: SplatPoints, eye: Point, target: Point) -> float:
    """Return the share of light that Gaussians let through from a point to another.

    Each takes its opacity times what its density is where the line comes nearest to it, as a
    rasteriser would, which orders and projects them too.
    """
    origin, line = np.array(eye), np.array(target) - np.array(eye)
    offsets = splat.centers - origin
    share = np.clip(offsets @ line / (line @ line), 0.0, 1.0)
    spread = np.sqrt(np.trace(splat.covariances, axis1=1, axis2=2))
    near = np.linalg.norm(offsets - share[:, None] * line, axis=1) < 3 * spread + 0.01
    near &= (share > 0) & (share < 1)
    inverse = np.linalg.inv(splat.covariances[near] + 1e-8 * np.eye(3))
    along = np.einsum("i,nij,j->n", line, inverse, line)
    at = np.einsum("i,nij,nj->n", line, inverse, offsets[near]) / along
    apart = offsets[near] - at[:, None] * line
    density = np.exp(-0.5 * np.einsum("ni,nij,nj->n", apart, inverse, apart))
    return float(np.prod(1.0 - np.minimum(splat.opacities[near, 0] * density, 0.99)))
