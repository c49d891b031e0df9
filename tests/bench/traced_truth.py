"""What a built-in place looks like: its own paint and light on rays through many points of a pixel.

The splat of a place is baked from its paint and light on cells of surfaces. Here the same paint and
light are asked where rays of a camera meet the surfaces, so that no Gaussian takes part. Leaves and
blades of grass exist as Gaussians alone: pixels that see a crown or a lawn are left out.
"""

from dataclasses import dataclass

import numpy as np

from nw_places.bake import generate as baked
from nw_places.bake.lighting import Lighting, sky_radiance
from nw_places.bake.surfels import Cells, cut, decal_at, dot, frames, paint, position
from nw_places.places.crowns import crown_mesh
from nw_scenes.mesh import merge, quad_mesh
from nw_scenes.rays import RayScene

RAYS = 28
"""Into the hemisphere, for the light that surfaces pass on; the bake's own number."""


@dataclass(frozen=True, kw_only=True)
class Traced:
    """One view: rgb (H, W, 3) 0 to 1; and (H, W) which pixels count, and which are sky alone."""

    rgb: np.ndarray
    counts: np.ndarray
    sky: np.ndarray


class TracedPlace:
    """Draws views of a place that no splat takes part in.

    Args:
        place: of a built-in scene.
        budget: of the bake, which exposes by its cells.
    """

    def __init__(self, place, *, budget=185_000):
        self._place = place
        self._geometry = frames(place.patches)
        quads = [quad_mesh(p.origin, p.u, p.v, p.kind or "ground") for p in place.patches]
        crowns = [crown_mesh(crown) for crown in place.crowns]
        self._rays = RayScene(merge([*quads, *crowns]))
        self._lighting = Lighting(place)
        coarseness = baked._coarseness(place, budget)
        cells = cut(place.patches, self._geometry, place.eyes, coarseness)
        # Exposure looks at what is near alone, and a tenth of it says as much.
        near = baked.eye_distance(position(cells, self._geometry), place.eyes) < 6.0
        near = np.flatnonzero(near)[::10]
        few = Cells(**{name: getattr(cells, name)[near] for name in Cells.__dataclass_fields__})
        points, fallen, radiance = self._shine(few)
        self._scale = baked.exposure(place, points, fallen, radiance)
        self._under = radiance.mean(axis=0)

    def _shine(self, cells):
        """Return points, the light that falls on cells, and what they send back."""
        albedo, glow = paint(self._place.patches, self._geometry, cells, self._place.light)
        points = position(cells, self._geometry)
        normals = self._geometry.normal[cells.patch]
        fallen = self._lighting.passed_on(points, normals, RAYS)
        fallen += self._lighting.direct(points, normals)
        return points, fallen, albedo * fallen + glow

    def view(self, camera, *, side=4):
        """Return a view of a camera in the world, with side x side rays a pixel."""
        y, x = (np.mgrid[: camera.height * side, : camera.width * side] + 0.5) / side
        ways = np.stack(
            [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1
        ).reshape(-1, 3)
        ways = ways @ camera.T_world_camera[:3, :3].T
        lengths = np.linalg.norm(ways, axis=1)
        ways /= lengths[:, None]
        eye = camera.T_world_camera[:3, 3]
        starts = np.broadcast_to(eye, ways.shape)
        distance, face = self._rays.cast(starts, ways)
        shown = np.zeros((len(ways), 3))
        missed = face < 0
        if self._place.indoor:
            shown[missed] = self._under
        else:
            shown[missed] = sky_radiance(ways[missed], self._place.light, clouds=True)
            shown[missed & (ways[:, 2] < -0.05)] = self._under
        patch = face.astype(np.int64) >> 1
        hit = np.flatnonzero(~missed & (patch < len(self._place.patches)))
        points = eye + distance[hit, None] * ways[hit]
        g, on = self._geometry, patch[hit]
        s = np.clip(dot(points - g.origin[on], g.axis_u[on]), 0.0, g.width[on] - 1e-9)
        t = np.clip(dot(points - g.origin[on], g.axis_v[on]), 0.0, g.height[on] - 1e-9)
        decal = np.full(len(hit), -1, dtype=np.int64)
        for index in np.unique(on):
            if self._place.patches[index].decals:
                mine = on == index
                decal[mine] = decal_at(self._place.patches[index], s[mine], t[mine])
        # A ray sees a spot as wide as its share of the pixel; what is seen aslant is longer.
        width = distance[hit] / (camera.fx * side)
        slant = np.abs(dot(ways[hit], g.normal[on]))
        wide = np.maximum(width / np.sqrt(np.maximum(slant, 0.05)), 1e-4)
        cells = Cells(
            patch=on, decal=decal, s=s, t=t, width=wide, height=wide,
            rim=np.zeros((len(hit), 4), dtype=bool),
        )  # fmt: skip
        at, _, radiance = self._shine(cells)
        shown[hit] = baked._fogged(self._place, at, radiance)
        rgb = baked.display(shown, self._scale)
        leaf = patch >= len(self._place.patches)
        leaf[hit] |= (
            self._on_lawns(points) | ~np.array([p.painted for p in self._place.patches])[on]
        )
        # From behind, a patch is not painted.
        leaf[hit] |= dot(ways[hit], g.normal[on]) > 0

        def of_pixels(values):
            blocks = values.reshape(camera.height, side, camera.width, side, -1)
            return blocks.mean(axis=(1, 3))

        return Traced(
            rgb=of_pixels(rgb),
            counts=of_pixels(leaf.astype(float))[..., 0] == 0.0,
            sky=of_pixels((missed & (ways[:, 2] > 0.0)).astype(float))[..., 0] == 1.0,
        )

    def _on_lawns(self, points):
        found = np.zeros(len(points), dtype=bool)
        for lawn in self._place.lawns:
            x0, y0, x1, y1 = lawn.rect
            x, y, z = points.T
            found |= (x > x0) & (x < x1) & (y > y0) & (y < y1) & (z < 0.05)
        return found
