"""What `nw-eval scenes check` looks at in any scene."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import starmap

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_scenes.finding import SceneFinding
from nw_scenes.mesh import TriangleMesh, rotation_matrix
from nw_scenes.prop import PropBox
from nw_scenes.rays import RayScene
from nw_scenes.scene import Box, HeightField, Scene

Values = NDArray[np.float64]

# A floor this far from z = 0 under the spawn is worth a word, metres.
_FLOOR = 0.02
# A waypoint is a point on top of an obstacle; it may lie this far below the surface, or above it.
_UNDER = 0.05
_OVER = 1.0
# The body of a robot that stands at the spawn: half extents along x and y, and what is under it.
_BODY = (0.25, 0.15)
_CLEARANCE = 0.2
_BODY_TOP = 0.45
# Around the spawn the ground's usual height is told from that of an obstacle there, metres.
_ROUND = 0.8
# Terrain has a surface of its own where it is this much above the plane that catches, metres.
_ABOVE_VOID = 0.4
# Shares of a splat round the course that are too little to be the same place: of the whole, and in
# a scene much larger than that, of the share that the mesh's surface has there.
_LEAST_INSIDE = 0.02
_LEAST_OF_MESH = 0.1
_AROUND = 2.0
_SAMPLES = 20_000


# Of a robot's camera over the ground, m; a face looks up or down from this z of its normal on.
_EYE = 0.3
_FACES = 0.3
_MOSTLY = 0.5
# Of a room: levels that its height is told in, what it holds at least as a share of the floor, and
# where its contents hang rather than stand.
_LEVELS = 100
_CONTENTS = 0.05
_ROOM = 0.1
_EDGES = 0.1  # of a room's height, next to floor and ceiling
_HANGING = 0.55
_TURN_OVER = (
    "if it is upside down, turn it over: `nw-eval scenes level SCENE --flip --propose`, or import "
    "it with another --up"
)


def check_scene(scene: Scene, *, read_splat: bool = True) -> tuple[SceneFinding, ...]:
    """Return what is wrong or remarkable about a scene.

    Args:
        scene: built in, from a folder, or published.
        read_splat: look into the splat as well; a splat file of a gigabyte takes seconds.
    """
    rays = RayScene(scene.mesh())
    findings = [*_overhead(scene, rays), *_spawn(scene, rays), *_waypoints(scene, rays)]
    if read_splat and scene.splat is not None:
        findings += _splat(scene)
    return tuple(findings)


def _heights(scene: Scene, rays: RayScene, xy: Values, z_from: float | Values = 50.0) -> Values:
    """Return the ground under points, as the sensors see it or else as physics has it."""
    heights = rays.height(xy, z_from=z_from)
    fields = [solid.height(xy) for solid in scene.solids if isinstance(solid, HeightField)]
    if not fields:
        return heights
    # Small holes of the mesh are closed in physics; where it has no surface it lies deep down.
    field = np.max(fields, axis=0)
    return np.where(np.isneginf(heights) & (field > scene.ground.z + _ABOVE_VOID), field, heights)


def _faces_above(scene: Scene, rays: RayScene, points: Values) -> tuple[Values, Values]:
    """Return how far above points (N, 3) the next face is, m, and the z of its unit normal."""
    distance, face = rays.cast(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    a, b, c = scene.mesh().triangles[np.maximum(face, 0)].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    return distance, normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)


def _under_roofs(scene: Scene, rays: RayScene, points: Values) -> Values:
    """Return from which z (N,) one looks down on points (N, 3): from under a roof, where one is.

    A roof shows its underside to who stands below it, with room for a robot; what shows its back
    is the top of a thing that stands there.
    """
    distance, turn = _faces_above(scene, rays, points + np.array([0.0, 0.0, _CLEARANCE]))
    is_roof = np.isfinite(distance) & (distance > _BODY_TOP - _CLEARANCE) & (turn < -_FACES)
    return np.where(is_roof, points[:, 2] + _CLEARANCE + distance - 0.01, 50.0)


def _overhead(scene: Scene, rays: RayScene) -> list[SceneFinding]:
    """Return that the course is under the floor, or on the ceiling of a room that stands on it."""
    points = np.vstack([[scene.spawn.position], scene.trail])
    eyes = points + np.array([0.0, 0.0, _EYE])
    distance, turn = _faces_above(scene, rays, eyes)
    under = np.isfinite(distance) & (turn > _FACES)
    x, y, z = points[0].tolist()
    if under[0] and under.mean() > _MOSTLY:
        return [
            SceneFinding(
                code="under_floor",
                severity="error",
                message=f"a surface that faces up is {distance[0] + _EYE:.2f} m above the start, "
                f"and over {int(under.sum())} of {len(points)} points of the course: the robot's "
                "eye is under a floor",
                fix=_TURN_OVER,
                value=float(distance[0]),
                place=(x, y, z),
            )
        ]
    covered = np.isfinite(distance) & (turn < -_FACES)
    room = room_of(scene.mesh().triangles, np.array([0.0, 0.0, 1.0]))
    if covered.mean() > _MOSTLY and room is not None and room.contents > _HANGING:
        return [
            SceneFinding(
                code="upside_down",
                severity="warning",
                message=f"{room.words()}: the room may stand on its ceiling",
                fix=_TURN_OVER,
                value=room.contents,
                place=(x, y, z),
            )
        ]
    return []


@dataclass(frozen=True, kw_only=True)
class Room:
    """What lies under one ceiling.

    Attributes:
        floor: its height, in the unit of the mesh, as the next.
        height: of the ceiling over the floor.
        contents: how high what lies between has its level faces, area by area, as a share of
            `height`: tables and shelves are low. nan = there is too little.
    """

    floor: float
    height: float
    contents: float

    def words(self) -> str:
        """Return where the contents are."""
        return (
            f"what is in the room has its level faces at {self.contents:.0%} of its height in the "
            "mean"
        )


def room_of(triangles: Values, up: Values) -> Room | None:
    """Return the room that triangles (F, 3, 3) enclose if `up` (3,) is up; None if they do not.

    The largest level that faces down is the ceiling, and the largest below it that faces up the
    floor, if neither is smaller than a tenth of the other: furniture hides floors, and ceilings
    have a slab above them.
    """
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(normal, axis=1)
    turn = normal @ up / np.maximum(area, 1e-300)
    height = triangles.mean(axis=1) @ up
    low, span = float(height.min()), max(float(np.ptp(height)), 1e-9)
    bins = np.minimum(((height - low) / span * _LEVELS).astype(np.int64), _LEVELS - 1)
    sums = [np.bincount(bins[one], area[one], _LEVELS) for one in (turn > 0.94, turn < -0.94)]
    ceiling = int(sums[1].argmax())
    floor = int(sums[0][: max(ceiling - 1, 1)].argmax())
    sizes = sorted((float(sums[0][floor]), float(sums[1][ceiling])))
    if ceiling <= floor or not sizes[0] > _ROOM * sizes[1]:
        return None
    rise = span / _LEVELS * (ceiling - floor)
    level = low + span / _LEVELS * (floor + 0.5)
    # Floor and ceiling of a scan are no planes, and round off where they meet the walls.
    inside = np.abs((height - level) / rise - 0.5) < 0.5 - _EDGES
    between = inside & (np.abs(turn) > 0.5)
    contents = np.nan
    if area[between].sum() > _CONTENTS * sums[0][floor]:
        mean = np.average(height[between], weights=area[between])
        contents = float((mean - level) / rise)
    return Room(floor=level, height=rise, contents=contents)


def _spawn(scene: Scene, rays: RayScene) -> list[SceneFinding]:
    x, y, z = scene.spawn.position
    point = np.array([[x, y]])
    roof = float(_under_roofs(scene, rays, np.array([[x, y, z]]))[0])
    floor = float(_heights(scene, rays, point, roof)[0])
    place = (x, y, z)
    if _looks_down(scene, rays, x, y, z):
        return [
            SceneFinding(
                code="inside_out",
                severity="error",
                message=f"the faces under the spawn ({x:.2f}, {y:.2f}) point down: the mesh is "
                "mirrored or inside out",
                fix="flip its faces, or undo the negative scale that made it",
                place=place,
            )
        ]
    if not np.isfinite(floor):
        return [
            SceneFinding(
                code="no_floor_under_spawn",
                severity="error",
                message=f"there is no surface under the spawn ({x:.2f}, {y:.2f})",
                fix="move the mesh so that the robot starts on it",
                place=place,
            )
        ]
    findings: list[SceneFinding] = []
    if abs(floor) > _FLOOR:
        findings.append(
            SceneFinding(
                code="floor_offset",
                severity="warning",
                message=f"the floor under the spawn is at z = {floor:.3f} m, not at 0",
                fix="the published robot starts 0.4 m above z = 0; align the scene's height",
                value=floor,
                place=place,
            )
        )
    # A centimetre apart: a panel is as much in the way as a block.
    sides = [np.linspace(-half, half, 1 + round(2 * half / 0.01)) for half in _BODY]
    body = np.stack(np.meshgrid(*sides), -1).reshape(-1, 2)
    c, s = np.cos(scene.spawn.yaw), np.sin(scene.spawn.yaw)
    points = point + body @ np.array([[c, s], [-s, c]])
    roofs = _under_roofs(scene, rays, np.column_stack([points, np.full(len(points), z)]))
    under = _heights(scene, rays, points, roofs)
    highest = float(np.max(under))
    steps = np.linspace(-_ROUND, _ROUND, 17)
    nearby = point + np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    ground = _heights(scene, rays, nearby, roof)
    usual = float(np.median(ground[np.isfinite(ground)]))
    # A narrow block may stand on lower ground: where it is level under the robot, it carries it.
    level = max(usual, min(z, float(np.min(under))))
    inside = _in_a_box(scene, points, max(z, usual))
    if highest > level + _CLEARANCE or inside:
        obstacle = inside or f"something {highest - level:.2f} m high"
        findings.append(
            SceneFinding(
                code="spawn_blocked",
                severity="error",
                message=f"{obstacle} is where the robot starts, at ({x:.2f}, {y:.2f})",
                fix="move one of them" if "prop" in inside else "move the spawn or the scene",
                value=highest,
                place=place,
            )
        )
    return findings


def _looks_down(scene: Scene, rays: RayScene, x: float, y: float, z: float) -> bool:
    """Return whether the first face below the robot's body is seen from behind."""
    # A ray does not meet the face on which it begins, such as the top of a crate of 0.4 m.
    origin = np.array([[x, y, z + 0.401]])
    _, face = rays.cast(origin, np.array([[0.0, 0.0, -1.0]]))
    if face[0] < 0:
        return False
    a, b, c = scene.mesh().triangles[face[0]]
    return bool(np.cross(b - a, c - a)[2] < 0)


def _in_a_box(scene: Scene, points: Values, z: float) -> str:
    """Return what a body at the spawn would be inside of, of boxes and props; empty if nothing."""
    heights = np.linspace(z + _CLEARANCE, z + _BODY_TOP, 6)
    body = np.concatenate([np.column_stack([points, np.full(len(points), h)]) for h in heights])
    if any(_meets(solid, body) for solid in scene.solids if isinstance(solid, Box)):
        return "a solid"
    for prop in scene.props:
        local = (body - prop.position) @ rotation_matrix(prop.quat)
        if any(_meets(box, local) for box in prop.boxes):
            return f"the prop {prop.name!r}"
    return ""


def _meets(box: Box | PropBox, points: Values) -> bool:
    local = (points - box.center) @ rotation_matrix(box.quat)
    return bool((np.abs(local) < box.half_size).all(axis=1).any())


def _waypoints(scene: Scene, rays: RayScene) -> list[SceneFinding]:
    roofs = _under_roofs(scene, rays, scene.trail)
    heights = _heights(scene, rays, scene.trail[:, :2], roofs)
    rows = enumerate(zip(scene.trail.tolist(), heights.tolist(), strict=True))
    findings = starmap(lambda index, row: _waypoint(index, row[0], row[1]), rows)
    return [finding for finding in findings if finding is not None]


def _waypoint(index: int, point: list[float], ground: float) -> SceneFinding | None:
    x, y, z = point
    name = f"waypoint {index} at ({x:.2f}, {y:.2f}, {z:.2f})"
    if not np.isfinite(ground):
        return SceneFinding(
            code="waypoint_off_mesh",
            severity="error",
            message=f"{name} has no surface under it",
            fix="move it onto the mesh",
            place=(x, y, z),
        )
    if z < ground - _UNDER:
        return SceneFinding(
            code="waypoint_below_surface",
            severity="error",
            message=f"{name} lies {ground - z:.3f} m below the surface",
            fix="put it on top of the obstacle",
            value=ground - z,
            place=(x, y, z),
        )
    if z > ground + _OVER:
        return SceneFinding(
            code="waypoint_above_surface",
            severity="warning",
            message=f"{name} hangs {z - ground:.2f} m above the surface",
            fix="put it on top of the obstacle",
            value=z - ground,
            place=(x, y, z),
        )
    return None


def _splat(scene: Scene) -> list[SceneFinding]:
    try:
        means, notes = _means(scene)
    except SceneError as error:
        empty = any(word in str(error) for word in ("empty", "none of", "no Gaussian"))
        code = "splat_empty" if empty else "splat_invalid"
        return [SceneFinding(code=code, severity="error", message=str(error))]
    if len(means) == 0:
        message = "the splat has no Gaussians"
        return [SceneFinding(code="splat_empty", severity="error", message=message)]
    mesh = scene.mesh()
    # The course's surroundings: a ground plane may reach far beyond what was photographed.
    path = np.vstack([[scene.spawn.position], scene.trail])
    low = np.maximum(path.min(axis=0) - _AROUND, mesh.vertices.min(axis=0) - 0.5)
    high = np.minimum(path.max(axis=0) + _AROUND, mesh.vertices.max(axis=0) + 0.5)
    T = scene.T_world_splat
    world = means @ T[:3, :3].T + T[:3, 3]
    share, of_mesh = (
        float(((points > low) & (points < high)).all(axis=1).mean())
        for points in (world, _on_surface(mesh))
    )
    findings = [
        SceneFinding(code="splat_partly_read", severity="note", message=f"splat: {note}")
        for note in notes
    ]
    if share >= min(_LEAST_INSIDE, _LEAST_OF_MESH * of_mesh):
        return findings
    middle = np.median(world, axis=0).round(2).tolist()
    return [
        *findings,
        SceneFinding(
            code="splat_elsewhere",
            severity="error",
            message=f"only {100 * share:.1f} % of {len(means)} Gaussians lie around the course; "
            f"their middle is at {middle}",
            fix="check T_world_splat: scale, rotation and data_transforms.json",
            value=share,
        ),
    ]


def _on_surface(mesh: TriangleMesh) -> Values:
    """Return points that are spread evenly over a mesh, (N, 3)."""
    a, b, c = mesh.triangles.swapaxes(0, 1)
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    number = np.arange(_SAMPLES) + 0.5
    face = np.searchsorted(area, number / _SAMPLES * area[-1]).clip(0, len(area) - 1)
    # Two steps that have no common multiple with each other nor with 1 (Roberts 2018, R2).
    u, v = (number * 0.7548776662 % 1.0)[:, None], (number * 0.5698402910 % 1.0)[:, None]
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    return a[face] + u * (b - a)[face] + v * (c - a)[face]


def _means(scene: Scene) -> tuple[Values, tuple[str, ...]]:
    """Return the centres of a scene's Gaussians, (N, 3) in the splat's frame, and their notes."""
    from nw_splat.store import GEOMETRY, GROUP, open_store

    store = open_store(scene.splat_store())
    layout = store.layout
    centers = layout.geometry.reshape(-1, GEOMETRY, GROUP)[:, :3].transpose(0, 2, 1)
    return centers.reshape(-1, 3)[: layout.count].astype(np.float64), store.notes
