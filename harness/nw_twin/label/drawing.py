"""The scene, the course and the markers in viser's scene.

A look into a scene from above is cut: what lies higher than a level is hidden, and clicks go
through. Only the view is cut. Nothing of the scene is lost by it; a crop does that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.viewing.browser import SplatPoints
from nw_scenes.mesh import TriangleMesh
from nw_twin.label.ground import Ground
from nw_twin.label.labelling import Labelling
from nw_twin.label.state import CropBox, Placement, Point, as_point, cropped, mapped

_ORANGE, _BLUE, _GREEN, _PINK = (232, 89, 12), (28, 100, 242), (43, 138, 62), (214, 51, 132)
_ROBOT = (0.6, 0.3, 0.3)  # m, of a Go1 that stands
_ASIDE = 0.25  # of the camera's distance
_LIFT = 0.03  # m, so that lines are not in the ground

_FAR = 1e9  # m
_OVERHEAD = 1.2  # m above a start; what hangs higher there is a ceiling
_SEEN = 0.7  # share of light; with less, what is behind is a haze
_SKY = 8.0  # m above a start; higher things hide nothing


class Drawing:
    """Draws a labelling, and only what has changed of the scene.

    Args:
        server: viser's.
        labelling: the labelling to draw.
        splat: in the world as it was opened; None = the scene has no appearance.
    """

    def __init__(self, server: Any, labelling: Labelling, splat: SplatPoints | None) -> None:
        self._scene = server.scene
        self._labelling = labelling
        self._splat = splat
        self._place: object = None
        self._names: set[str] = set()
        self._scene.set_up_direction("+z")
        # A little below a floor at z = 0, which it would flicker with.
        self._scene.add_grid("/grid", width=40.0, height=40.0, position=(0.0, 0.0, -0.02))
        server.initial_camera.up = (0.0, 0.0, 1.0)
        self.aim(server.initial_camera)
        self.shows_splat = splat is not None
        self.shows_mesh = splat is None
        self.cutaway = Cutaway()

    def refresh(self, chosen: int | None, crop: CropBox | None = None) -> None:
        """Draw the state as it is.

        Args:
            chosen: index of a waypoint, which stands out.
            crop: that somebody is about to make; world.
        """
        self._draw_place()
        before, self._names = self._names, set()
        self._draw_course(chosen)
        self._draw_markers()
        if crop is not None:
            self._lines("/crop", _edges(crop), _PINK)
        for name in before - self._names:
            self._scene.remove_by_name(name)

    def aim(self, camera: Any) -> None:
        """Let a camera look at the course from behind its start and above."""
        start = self._labelling.start
        stops = np.array([start.position, *self._labelling.state.waypoints])
        length = max(float(np.ptp(stops[:, :2], axis=0).max()), 2.0)
        yaw, away = start.yaw + 0.9, 0.8 * length + 1.0
        # The panel covers the right of the page: the course is to be seen beside it.
        right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
        middle = stops.mean(axis=0) + _ASIDE * away * right
        camera.position = middle + away * np.array([-math.cos(yaw), -math.sin(yaw), 0.9])
        camera.look_at = middle

    def _draw_place(self) -> None:
        state = self._labelling.state
        what = (state.placement, state.crop, self.cutaway)
        if what != self._place:
            self._place = what
            mesh = self.cutaway.of_mesh(self._labelling.mesh)
            self._scene.add_mesh_simple(
                "/mesh",
                mesh.vertices.astype(np.float32),
                mesh.faces.astype(np.uint32),
                color=(190, 194, 200),
                flat_shading=True,
                side="double",
            )
            if self._splat is not None:
                self._draw_splat(self._splat)
        self._scene.get_handle_by_name("/mesh").visible = self.shows_mesh
        if self._splat is not None:
            self._scene.get_handle_by_name("/splat").visible = self.shows_splat
            # It would shine through.
            self._scene.get_handle_by_name("/grid").visible = not self.shows_splat

    def _draw_splat(self, splat: SplatPoints) -> None:
        state = self._labelling.state
        placement = state.placement
        shown = self.cutaway.of_splat(splat, placement, state.crop)
        # The browser moves them: what was computed for the opened world stays as it is.
        self._scene.add_gaussian_splats(
            "/splat",
            shown.centers,
            shown.covariances,
            shown.rgbs,
            shown.opacities,
            scale=placement.scale,
            wxyz=placement.quat,
            position=placement.translation,
        )

    def _draw_course(self, chosen: int | None) -> None:
        # Each thing has a name of its own, and none hangs on another: browsers lose the poses of
        # things whose parent was taken away and comes back.
        start, waypoints = self._labelling.start, self._labelling.state.waypoints
        for i, point in enumerate(waypoints):
            colour = _BLUE if i == chosen else _ORANGE
            self._ball(f"/trail/{i}", point, colour, 0.09 if i == chosen else 0.07)
            self._text(f"/trail_name/{i}", str(i + 1), point, 0.2)
        x, y, z = start.position
        half = (math.cos(start.yaw / 2), 0.0, 0.0, math.sin(start.yaw / 2))
        middle = (x, y, z + _ROBOT[2] / 2)
        self._scene.add_box(
            self._named("/start"),
            color=_GREEN,
            dimensions=_ROBOT,
            opacity=0.6,
            wxyz=half,
            position=middle,
        )
        nose = np.array([[[_ROBOT[0] / 2, 0.0, 0.0], [_ROBOT[0] / 2 + 0.35, 0.0, 0.0]]])
        self._scene.add_arrows(
            self._named("/start_looks"), nose, colors=_GREEN, wxyz=half, position=middle
        )
        self._text("/start_name", "start", middle, 0.3)
        stops = np.array([start.position, *waypoints]) + np.array([0.0, 0.0, _LIFT])
        if waypoints:
            legs = np.stack([stops[:-1], stops[1:]], axis=1)
            self._lines("/trail_legs", legs, _ORANGE)

    def _draw_markers(self) -> None:
        for i, point in enumerate(self._labelling.state.floor):
            self._ball(f"/floor/{i}", point, _GREEN, 0.05)
        markers = self._labelling.state.markers
        for i, point in enumerate(markers):
            self._ball(f"/marker/{i}", point, _PINK, 0.05)
        distance = self._labelling.distance
        if distance is not None:
            self._lines("/marker_line", np.array([markers]), _PINK)
            middle = as_point(np.mean(markers, axis=0))
            self._text("/marker_distance", self._labelling.distance_words, middle, 0.1)

    def _ball(self, name: str, point: Point, colour: tuple[int, int, int], radius: float) -> None:
        self._scene.add_icosphere(self._named(name), radius=radius, color=colour, position=point)

    def _text(self, name: str, text: str, point: Point, above: float) -> None:
        x, y, z = point
        self._scene.add_label(
            self._named(name), text, position=(x, y, z + above), anchor="bottom-center"
        )

    def _lines(self, name: str, points: Any, colour: tuple[int, int, int]) -> None:
        self._scene.add_line_segments(self._named(name), points, colors=colour, thickness=0.02)

    def _named(self, name: str) -> str:
        self._names.add(name)
        return name


def _edges(box: CropBox) -> NDArray[np.float64]:
    corners = np.array(list(product(*zip(box.low, box.high, strict=True))))
    pairs = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return corners[np.array(pairs)]


@dataclass(frozen=True, kw_only=True)
class Cutaway:
    """The part of a scene that is shown.

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
            splat: of the scene as it was opened.
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
        """Return where a ray (world, m) enters the shown part; None if it does not."""
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
        ground: of the scene; a ceiling of it over the start is cut away.
        splat: as above, treetops and roofs of it between eye and start; world; None = there is
            none.
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
