"""Trials in viser's scene: geometry is sent once, then only where bodies are.

What a log's scene holds becomes triangles: boxes, cylinders, ellipsoids and meshes alike.

Also here: a page that is served until it is closed, with one thread that moves things.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_eval.view.trace import Trace, parting
from nw_eval.viewing.browser import HOST, SplatPoints, stop, viser_server
from nw_scenes.mesh import CONE_HEIGHT, cone_mesh, rotation_matrix

STEP = 0.02
"""Seconds of a control step."""
_WIDTH = 320  # pixels


class ServedPage:
    """Listens at this machine's own address only, and turns other web pages away.

    A context manager. All browsers that show it show the same.

    Args:
        port: to listen at; 0 = one that is free.
        opened: is called with path and query when somebody opens it.

    Attributes:
        server: viser's.

    Raises:
        PrerequisiteError, UsageError: as `viser_server`.
    """

    def __init__(self, port: int, opened: Callable[[str], None] | None = None) -> None:
        self.server: Any = viser_server(port, "nw-eval view", opened)
        self._closed = threading.Event()
        self._mover: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Where browsers find it."""
        return f"http://{HOST}:{self.server.get_port()}"

    def start(self, move: Callable[[], None], tick: float) -> None:
        """Call something every `tick` seconds until the page is closed."""

        def moves() -> None:
            while not self._closed.wait(tick):
                move()

        self._mover = threading.Thread(target=moves, name="view mover", daemon=True)
        self._mover.start()

    def close(self) -> None:
        """Stop serving; a second time does nothing."""
        if not self._closed.is_set():
            self._closed.set()
            if self._mover is not None:
                self._mover.join(timeout=5.0)
            stop(self.server)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def enlarged(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) at least as wide as the panel, its pixels as squares."""
    factor = max(1, -(-_WIDTH // picture.shape[1]))
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def plain(text: str) -> str:
    """Return text that is no Markdown."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]()#+-.!|<>" else c for c in clean(text, at_most=200))


COLOURS = ((25, 115, 240), (232, 89, 12), (43, 138, 62), (134, 65, 196))
"""Of the ways that the trials walked, the first being the one that is looked at."""
_PARTED = (214, 51, 132)
MOTION_TINT = (70, 190, 255)
"""Of the robot as the motion has it that it tracks."""
_GHOST = 0.35
_BESIDE = 0.3
"""Of the course's length, by which it lies left of the middle of the picture."""
_LIFT = 0.02  # m, so that lines are not in the ground


class TrialDrawing:
    """Draws trials of one scene, and moves their robots.

    Args:
        server: viser's.
        traces: the one that is looked at, then its ghosts.
        splat: of the scene, in the world; None = its mesh is shown.
    """

    def __init__(self, server: Any, traces: Sequence[Trace], splat: SplatPoints | None) -> None:
        self._server, self._scene, self._traces = server, server.scene, traces
        self._bodies: list[dict[str, Any]] = []
        self._mesh: list[Any] = []
        self._scene.reset()
        self._scene.set_up_direction("+z")
        self._draw_place(traces[0], splat)
        self._draw_course(traces)
        for number, trace in enumerate(traces):
            self._bodies.append(self._draw_robot(trace, number))
        self._motion = self._draw_motion(traces[0])
        self.show(0.0)

    @property
    def shows_mesh(self) -> bool:
        """Whether the mesh of the scene is shown."""
        return bool(self._mesh) and bool(self._mesh[0].visible)

    @shows_mesh.setter
    def shows_mesh(self, wanted: bool) -> None:
        for handle in self._mesh:
            handle.visible = wanted

    def show(self, time: float) -> None:
        """Put every robot where it was at a time, s, or at its own end."""
        with self._server.atomic():
            for trace, handles in zip(self._traces, self._bodies, strict=True):
                place = trace.at(time)
                for name, handle in handles.items():
                    positions, quats = trace.bodies[name]
                    handle.position, handle.wxyz = positions[place], quats[place]
            place = self._traces[0].at(time)
            for name, handle in self._motion.items():
                positions, quats = self._traces[0].ghost[name]
                handle.position, handle.wxyz = positions[place], quats[place]

    def _draw_place(self, trace: Trace, splat: SplatPoints | None) -> None:
        if splat is not None:
            draw_splat(self._scene, splat)
        place = [entity for entity in trace.entities if entity.id.startswith("place/")]
        self._mesh = draw_mesh(self._scene, place, visible=splat is None)

    def _draw_course(self, traces: Sequence[Trace]) -> None:
        draw_waypoints(self._scene, traces[0].waypoints)
        for number, trace in enumerate(traces):
            way = trace.trunk + np.array([0.0, 0.0, _LIFT])
            self._scene.add_line_segments(
                f"/way/{number}",
                np.stack([way[:-1], way[1:]], axis=1),
                colors=COLOURS[number % len(COLOURS)],
                thickness=0.015,
            )
            apart = parting(traces[0], trace) if number else None
            if apart is not None:
                self._scene.add_icosphere(
                    f"/parted/{number}",
                    radius=0.05,
                    color=_PARTED,
                    position=trace.trunk[trace.at(apart)],
                )

    def _draw_robot(self, trace: Trace, number: int) -> dict[str, Any]:
        parts = [entity for entity in trace.entities if entity.frame_id in trace.bodies]
        tint = COLOURS[number % len(COLOURS)] if number else None
        return draw_robot(self._scene, parts, f"/robot/{number}", tint)

    def _draw_motion(self, trace: Trace) -> dict[str, Any]:
        """Draw the robot as the motion has it, which it tracks, if it does."""
        parts = [entity for entity in trace.entities if entity.frame_id in trace.ghost]
        return draw_robot(self._scene, parts, "/motion", MOTION_TINT)


def draw_splat(scene: Any, splat: SplatPoints) -> Any:
    """Draw Gaussians, and return their handle."""
    return scene.add_gaussian_splats(
        "/splat", splat.centers, splat.covariances, splat.rgbs, splat.opacities
    )


def draw_mesh(scene: Any, entities: Iterable[Any], *, visible: bool) -> list[Any]:
    """Draw what rays meet of a scene, and return the handles."""
    return [
        scene.add_mesh_simple(
            f"/{entity.id}/{number}",
            vertices,
            faces,
            color=colour,
            flat_shading=True,
            side="double",
            visible=visible,
        )
        for entity in entities
        for number, (vertices, faces, colour) in enumerate(triangles_of(entity))
    ]


def draw_waypoints(scene: Any, waypoints: NDArray[np.float64]) -> None:
    """Draw waypoints (K, 3) as numbered cones, as policies see them."""
    cone = cone_mesh()
    colours, own = np.unique(cone.colors, axis=0, return_inverse=True)
    for number, (x, y, z) in enumerate(waypoints):
        for part, colour in enumerate(colours):
            scene.add_mesh_simple(
                f"/waypoint/{number}/{part}",
                cone.mesh.vertices.astype(np.float32),
                cone.mesh.faces[own == part].astype(np.uint32),
                color=tuple(np.rint(255.0 * colour).astype(int).tolist()),
                flat_shading=True,
                position=(x, y, z),
            )
        scene.add_label(
            f"/waypoint_name/{number}", str(number + 1), position=(x, y, z + CONE_HEIGHT + 0.05)
        )


def draw_robot(
    scene: Any, entities: Iterable[Any], root: str, tint: tuple[int, int, int] | None = None
) -> dict[str, Any]:
    """Draw the bodies of a robot, at the origin.

    Args:
        scene: viser's.
        entities: one for each body or more, in its frame.
        root: the robot's name in the scene.
        tint: of a ghost, which one looks through; None = its own colours.

    Returns:
        Handles of the bodies by name, to be moved.
    """
    handles: dict[str, Any] = {}
    for entity in entities:
        body = entity.frame_id
        if body not in handles:
            handles[body] = scene.add_frame(f"{root}/{body}", show_axes=False)
        for part, (vertices, faces, colour) in enumerate(triangles_of(entity)):
            # Not every mesh's faces turn outwards, and those that do not would shade each other.
            is_mesh = part < len(entity.triangles)
            scene.add_mesh_simple(
                f"{root}/{body}/{entity.id.replace('/', '_')}_{part}",
                vertices,
                faces,
                color=colour if tint is None else tint,
                opacity=None if tint is None else _GHOST,
                flat_shading=True,
                side="double" if is_mesh else "front",
                receive_shadow=not is_mesh,
            )
    return handles


_STILL = 0.1
"""Metres; over less there is no direction to look along."""


def aim_along(camera: Any, stops: NDArray[np.float64]) -> None:
    """Let the first camera of a browser look along stops (K, 3), from behind and beside them."""
    ahead = stops[-1] - stops[0]
    if float(np.linalg.norm(ahead[:2])) < _STILL:
        ahead = np.array([1.0, 0.0, 0.0])
    length = max(float(np.linalg.norm(ahead[:2])), 2.0)
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-6)
    aside = np.array([-ahead[1], ahead[0], 0.0])
    # The panel covers the right of the page: the course is to be seen beside it.
    middle = stops.mean(axis=0) - _BESIDE * length * aside
    camera.up_direction = (0.0, 0.0, 1.0)
    camera.position = middle - 0.55 * length * ahead - 0.5 * length * aside + (0, 0, 0.45 * length)
    camera.look_at = middle


Colour = tuple[int, int, int]


def triangles_of(entity: Any) -> list[tuple[NDArray[np.float32], NDArray[np.uint32], Colour]]:
    """Return the shapes of a `foxglove.SceneEntity`, in its frame.

    Returns:
        For each: vertices (V, 3) m, faces (F, 3), and its colour.

    Raises:
        ValueError: a mesh has corners that are not there.
    """
    import trimesh

    triangles: list[tuple[NDArray[np.float32], NDArray[np.uint32], Colour]] = []
    for mesh in entity.triangles:
        points = np.array([(p.x, p.y, p.z) for p in mesh.points], np.float64).reshape(-1, 3)
        faces = np.array(mesh.indices, np.int64)
        if faces.size % 3 or (faces.size and faces.max() >= len(points)):
            raise ValueError("a mesh has corners that are not there")
        if faces.size:
            triangles.append(_coloured(points, faces.reshape(-1, 3), mesh.color))
    solids = (
        (entity.cubes, trimesh.creation.box(extents=(1.0, 1.0, 1.0))),
        (entity.cylinders, trimesh.creation.cylinder(radius=0.5, height=1.0, sections=24)),
        (entity.spheres, trimesh.creation.icosphere(subdivisions=2, radius=0.5)),
    )
    for shapes, solid in solids:
        for each in shapes:
            size = np.array([each.size.x, each.size.y, each.size.z])
            p, q = each.pose.position, each.pose.orientation
            turned = (solid.vertices * size) @ rotation_matrix((q.w, q.x, q.y, q.z)).T
            moved = turned + np.array([p.x, p.y, p.z])
            triangles.append(_coloured(moved, solid.faces, each.color))
    return triangles


def _coloured(
    points: Any, faces: Any, color: Any
) -> tuple[NDArray[np.float32], NDArray[np.uint32], Colour]:
    red, green, blue = (
        min(255, max(0, round(255.0 * channel))) for channel in (color.r, color.g, color.b)
    )
    corners = np.asarray(points, np.float32)
    return corners, np.asarray(faces, np.uint32), (red, green, blue)
