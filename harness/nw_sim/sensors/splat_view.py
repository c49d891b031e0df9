"""What a scene's splat shows: pictures that sensors of a moment share, and distances along rays.

Depth is `CpuRenderer.surface`'s. There is a surface where Gaussians cover at least half of a pixel:
where the light that is left is one half, the median depth of "2D Gaussian Splatting" (Huang et al.,
arXiv 2403.17888) is taken, and behind less there is none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_base import same_bits
from nw_base.errors import UsageError
from nw_base.lens import Intrinsics
from nw_sim.sensors.sensor import SceneView, StepContext
from nw_sim.sensors.shutter import Band
from nw_splat.camera import Camera, Pixels, Rows
from nw_splat.image import Image, stacked

if TYPE_CHECKING:
    from nw_splat.render import Renderer

Array = NDArray[np.float64]

COVERED = 0.5
"""Share of a pixel from which on the Gaussians in it are a surface."""

_FINEST = 200.0
"""Pixels a radian, at most, in pictures that rays of a scanner are read from: 0.29 degrees each."""
_SECTOR = math.radians(90.0)
_SAME = 1.1
"""Ratio of depths up to which pixels side by side are one surface."""


class SplatView:
    """Pictures of the splat through a lens, one for all sensors that look alike.

    Args:
        name: of what looks: pictures of one name, lens, pixels and number of draws are shared.
        lens: of the whole image.
        pixels: of it that are drawn.
    """

    def __init__(self, name: str, lens: Intrinsics, pixels: Pixels) -> None:
        self._lens, self._pixels = lens, pixels
        self._height = pixels.count(lens.height)
        self._key = f"splat of {name}, {lens.width}x{lens.height}, {pixels}"
        self._renderer: Renderer | None = None

    def attach(self, place: SceneView) -> None:
        """Open the renderer of the scene's splat.

        Raises:
            SceneError: the scene has none.
        """
        self._renderer = place.renderer()
        self._T_splat_world = same_bits.inverse(place.world.scene.T_world_splat)

    def camera(self, T_splat_camera: Array) -> Camera:
        """Return the camera at a pose."""
        return Camera.of(self._lens, T_splat_camera)

    def seen(self, moment: StepContext, draws: Sequence[Sequence[Band]]) -> list[Image]:
        """Return the splat alone, an image of each draw; must not be changed the arrays."""
        key = f"{self._key}, {len(draws)}"
        images: list[Image] | None = moment.shared.get(key)
        if images is None:
            images = [
                stacked([self.drawn(band.T_world_camera, self.part(band)) for band in bands])
                for bands in draws
            ]
            for image in images:
                for part in (image.rgb, image.depth, image.alpha):
                    part.flags.writeable = False
            moment.shared[key] = images
        return images

    def drawn(self, T_world_camera: Array, rows: Rows | None = None) -> Image:
        """Return the picture from a pose, or some rows of it."""
        assert self._renderer is not None, "attach comes before measure"
        # The splat's scale stays in the matrix: the renderer then measures depth in metres.
        camera = self.camera(self._T_splat_world @ T_world_camera)
        if rows is None:
            return self._renderer.render(camera, self._pixels)
        return self._renderer.render(camera, self._pixels, rows)

    def depth(self, T_world_camera: Array, rows: Rows | None = None) -> Array:
        """Return depth along the axis (H, W) m, inf where Gaussians are no surface; as `drawn`."""
        from nw_splat.render import CpuRenderer

        if not isinstance(self._renderer, CpuRenderer):
            raise UsageError(
                "only the CPU renderer has depth of a splat along rays", fix="use --render cpu"
            )
        camera = self.camera(self._T_splat_world @ T_world_camera)
        depth, alpha = self._renderer.surface(camera, self._pixels, rows)
        return np.where(alpha >= COVERED, depth.astype(np.float64), np.inf)

    def part(self, band: Band) -> Rows | None:
        """Return the rows of a band; None = all that there are."""
        return None if band.rows == (0, self._height) else band.rows


class SplatScan:
    """Distances along rays from one point, read from pictures of sectors around it.

    Depth between pixels is interpolated as 1 / depth, which is exact on planes; where the four
    around a ray are not one surface, the nearest counts.

    Args:
        name: as `SplatView`'s.
        directions: (N, 3) unit vectors of the rays, x ahead, y left, z up; none steeper than 60
            degrees.
        step: between rays side by side, rad.
    """

    def __init__(self, name: str, directions: Array, step: float) -> None:
        self._count = len(directions)
        self._sectors: list[_Sector] = []
        azimuth = same_bits.arctan2(directions[:, 1], directions[:, 0])
        number = np.clip(np.floor((azimuth + math.pi) / _SECTOR).astype(int), 0, 3)
        for each in np.unique(number).tolist():
            rays = np.flatnonzero(number == each)
            middle = (each + 0.5) * _SECTOR - math.pi
            focal = min(1.0 / step, _FINEST)
            self._sectors.append(_Sector(f"{name} {each}", directions, rays, middle, focal))

    def attach(self, place: SceneView) -> None:
        """Open the renderer of the scene's splat.

        Raises:
            SceneError: the scene has none.
        """
        for sector in self._sectors:
            sector.view.attach(place)

    def distance(self, origin: Array, R_world_sensor: Array) -> Array:
        """Return distances (N,) m, inf where a ray meets no surface.

        Args:
            origin: (3,) of all rays, world, m.
            R_world_sensor: (3, 3).
        """
        distances = np.full(self._count, np.inf)
        for sector in self._sectors:
            distances[sector.rays] = sector.distance(origin, R_world_sensor)
        return distances


class _Sector:
    """The rays of a scan that one picture holds."""

    def __init__(
        self, name: str, directions: Array, rays: NDArray[np.intp], middle: float, focal: float
    ) -> None:
        self.rays = rays
        cosine, sine = math.cos(middle), math.sin(middle)
        # Columns: right, down and ahead of the picture in the sensor's frame.
        self._R = np.array([[sine, 0.0, cosine], [-cosine, 0.0, sine], [0.0, -1.0, 0.0]])
        seen = directions[rays] @ self._R
        self._along_axis = seen[:, 2]
        points = focal * seen[:, :2] / seen[:, 2:]
        low, high = points.min(axis=0), points.max(axis=0)
        width, height = (int(side) + 4 for side in np.ceil(high - low))
        cx, cy = (1.5 - low).tolist()
        lens = Intrinsics.model_construct(
            width=width, height=height, fx=focal, fy=focal, cx=cx, cy=cy
        )
        self.view = SplatView(name, lens, Pixels())
        places = points + np.array([cx - 0.5, cy - 0.5])  # Whole numbers are the centres of pixels.
        self._pixels = np.floor(places).astype(np.intp)
        self._shares = places - self._pixels

    def distance(self, origin: Array, R_world_sensor: Array) -> Array:
        T_world_camera = np.eye(4)
        T_world_camera[:3, :3] = R_world_sensor @ self._R
        T_world_camera[:3, 3] = origin
        inverse = 1.0 / self.view.depth(T_world_camera)  # 0 = no surface.
        (column, row), (u, v) = self._pixels.T, self._shares.T
        four = np.stack([inverse[row + j, column + i] for j in (0, 1) for i in (0, 1)])
        weights = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u])
        one_surface = four.max(axis=0) <= _SAME * four.min(axis=0)
        nearest = np.take_along_axis(four, weights.argmax(axis=0)[np.newaxis], axis=0)[0]
        read = np.where(one_surface, (four * weights).sum(axis=0), nearest)
        with np.errstate(divide="ignore"):
            return 1.0 / (read * self._along_axis)
