"""What a viewer draws: the scene, the course, the robot's parts, and waypoints that turn green.

Place, course and waypoints stand in the frame `world`; each part of the robot stands in the frame
of its body, which `/tf` moves.

For viewers that draw no `SceneUpdate` (Rerun), place, robot, course and path are coloured points
too. Points are few: they show where things are, while `/scene` shows what they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, assert_never

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import ArrayLike, NDArray

from nw_scenes.mesh import FACE_KINDS, FaceKind, TriangleMesh, rotation_matrix
from nw_scenes.prop import Prop, prop_body
from nw_scenes.robots import Shape
from nw_sim.rollout.mcap.messages import sized, stamp, time_field

Colour = tuple[float, float, float, float]
"""Red, green, blue, opacity; 0 to 1."""

WORLD = "world"
OPEN: Colour = (0.95, 0.55, 0.10, 0.85)
REACHED: Colour = (0.15, 0.75, 0.30, 0.85)
PLACE: dict[FaceKind, Colour] = {
    "ground": (0.55, 0.57, 0.53, 1.0),
    "obstacle": (0.62, 0.40, 0.24, 1.0),
    "structure": (0.78, 0.76, 0.72, 1.0),
    "clutter": (0.45, 0.55, 0.42, 1.0),
    "overhead": (0.80, 0.80, 0.80, 0.25),  # seen through, or it hides the robot
    "beside": (0.78, 0.76, 0.72, 0.25),  # As above
}
_WAYPOINT_DIAMETER = 0.6  # m; the reach radius of a waypoint is 0.3
_WAYPOINT_HEIGHT = 0.02  # m
_ENTITY = b"\x12"  # field 2 of a `SceneUpdate`
_LINE = 0.02  # m, how thick the course is, and how far above the waypoints
Points = NDArray[np.floating]

_FIELDS = (("x", 0), ("y", 4), ("z", 8), ("red", 12), ("green", 13), ("blue", 14), ("alpha", 15))
_POINT = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])
_DATA = b"\x32"  # field 6 of a `PointCloud`, the last one

_PLACE_POINTS = 3000
_MESH_POINTS = 48
_GRID = 128.0  # Points of place and rings stand on 1/128 m, whose zero bits compress.
_PATH: Colour = (0.10, 0.45, 0.95, 1.0)
_DOTS = 0.1  # m between two points of the course
_RING, _RADIUS = 24, 0.3  # points around a waypoint, and how far from it, m: it is reached there
# Steps of the additive recurrence that covers a square evenly (Roberts 2018, R2): no randomness.
_R2 = np.array([0.7548776662466927, 0.5698402909980532])


@lru_cache(maxsize=32)  # as many places as a worker's `Library` keeps
def place_update(mesh: TriangleMesh) -> bytes:
    """Return the static geometry that rays meet, one entity for each kind of face, serialised.

    It is the same in every trial of a scene. Protobuf messages add up: the bytes of one
    `SceneUpdate` before those of another one are both in one.
    """
    update = SceneUpdate()
    for number, kind in enumerate(FACE_KINDS):
        faces = mesh.faces[mesh.kinds == number]
        if not len(faces):
            continue
        used, indices = np.unique(faces, return_inverse=True)
        triangles = TriangleListPrimitive(
            pose=_pose((0.0, 0.0, 0.0)),
            color=_colour(PLACE[kind]),
            indices=indices.ravel().tolist(),
        )
        # Single precision is plenty for a picture, and its zero bits compress.
        for x, y, z in mesh.vertices[used].astype(np.float32).tolist():
            triangles.points.add(x=x, y=y, z=z)
        entity = _entity(0, WORLD, f"place/{kind}")
        entity.triangles.append(triangles)
        update.entities.append(entity)
    return update.SerializeToString(deterministic=True)


def trail_update(start: Sequence[float], trail: np.ndarray) -> bytes:
    """Return the way from the start through all waypoints (K, 3) m as a line, serialised.

    Where there are none, the line is the start alone.
    """
    corners = np.concatenate([np.reshape(start, (1, 3)), trail])
    corners[:, 2] += _LINE
    line = LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=_pose((0.0, 0.0, 0.0)),
        thickness=_LINE,
        color=_colour(OPEN),
    )
    for x, y, z in corners.astype(np.float32).tolist():
        line.points.add(x=x, y=y, z=z)
    entity = _entity(0, WORLD, "trail")
    entity.lines.append(line)
    return SceneUpdate(entities=[entity]).SerializeToString(deterministic=True)


@lru_cache(maxsize=4)
def robot_update(bodies: tuple[str, ...], visuals: tuple[Shape, ...]) -> bytes:
    """Return one entity for each body of a robot that has something to see, serialised."""
    update = SceneUpdate()
    for body in bodies:
        shapes = [shape for shape in visuals if shape.body == body]
        if shapes:
            entity = _entity(0, body, f"robot/{body}")
            for shape in shapes:
                _add_shape(entity, shape)
            update.entities.append(entity)
    return update.SerializeToString(deterministic=True)


def props_update(props: Sequence[Prop]) -> bytes:
    """Return one entity for each prop, its triangles in the frame of its body, serialised."""
    update = SceneUpdate()
    for prop in props:
        mesh, frame = prop.solid, prop_body(prop.name)
        triangles = TriangleListPrimitive(
            pose=_pose((0.0, 0.0, 0.0)),
            color=_colour((*prop.color, 1.0)),
            indices=mesh.faces.ravel().tolist(),
        )
        for x, y, z in mesh.vertices.astype(np.float32).tolist():
            triangles.points.add(x=x, y=y, z=z)
        entity = _entity(0, frame, frame)
        entity.triangles.append(triangles)
        update.entities.append(entity)
    return update.SerializeToString(deterministic=True)


class Discs:
    """Waypoints (K, 3) m as discs: orange, or green once they are reached."""

    def __init__(self, trail: np.ndarray) -> None:
        self._discs = [
            tuple(_disc(number, position, colour) for colour in (OPEN, REACHED))
            for number, position in enumerate(trail.tolist())
        ]

    def update(self, time_ns: int, *, reached: int) -> bytes:
        """Return all waypoints, the first `reached` green, as a `SceneUpdate`, serialised.

        All of them every time: a viewer whose time was moved has seen the latest message only.
        """
        time = time_field(time_ns)
        return b"".join(
            _ENTITY + sized(time + discs[number < reached])
            for number, discs in enumerate(self._discs)
        )


def _disc(number: int, position: Sequence[float], colour: Colour) -> bytes:
    """Return a waypoint's entity without its time, which stands before all else."""
    x, y, z = position
    entity = SceneEntity(frame_id=WORLD, id=f"waypoint/{number}", frame_locked=True)
    entity.cylinders.add(
        pose=_pose((x, y, z)),
        size=Vector3(x=_WAYPOINT_DIAMETER, y=_WAYPOINT_DIAMETER, z=_WAYPOINT_HEIGHT),
        bottom_scale=1.0,
        top_scale=1.0,
        color=_colour(colour),
    )
    entity.texts.add(
        pose=_pose((x, y, z + 0.25)),
        billboard=True,
        font_size=0.12,
        scale_invariant=False,
        color=_colour(colour),
        text=str(number),
    )
    return entity.SerializeToString(deterministic=True)


def _entity(time_ns: int, frame: str, name: str) -> SceneEntity:
    return SceneEntity(timestamp=stamp(time_ns), frame_id=frame, id=name, frame_locked=True)


def _add_shape(entity: SceneEntity, shape: Shape) -> None:
    pose = _pose(shape.position, shape.quat)
    colour = _colour(shape.rgba or (0.5, 0.5, 0.5, 1.0))
    full = [2.0 * value for value in shape.size]
    match shape.kind:
        case "box":
            size = Vector3(x=full[0], y=full[1], z=full[2])
            entity.cubes.append(CubePrimitive(pose=pose, size=size, color=colour))
        case "cylinder":
            size = Vector3(x=full[0], y=full[0], z=full[1])
            entity.cylinders.append(
                CylinderPrimitive(
                    pose=pose, size=size, bottom_scale=1.0, top_scale=1.0, color=colour
                )
            )
        case "ellipsoid":
            size = Vector3(x=full[0], y=full[1], z=full[2])
            entity.spheres.append(SpherePrimitive(pose=pose, size=size, color=colour))
        case "sphere":
            size = Vector3(x=full[0], y=full[0], z=full[0])
            entity.spheres.append(SpherePrimitive(pose=pose, size=size, color=colour))
        case "mesh":
            assert shape.triangles is not None, "a mesh has triangles"
            triangles = TriangleListPrimitive(
                pose=pose, color=colour, indices=shape.triangles.faces.ravel().tolist()
            )
            for x, y, z in shape.triangles.vertices.tolist():
                triangles.points.add(x=x, y=y, z=z)
            entity.triangles.append(triangles)
        case _:
            assert_never(shape.kind)


def _pose(position: Sequence[float], wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> Pose:
    x, y, z = position
    qw, qx, qy, qz = wxyz
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=qw, x=qx, y=qy, z=qz))


def _colour(rgba: Colour) -> Color:
    red, green, blue, alpha = rgba
    return Color(r=red, g=green, b=blue, a=alpha)


@lru_cache(maxsize=32)  # as many places as a worker's `Library` keeps
def place_cloud(mesh: TriangleMesh) -> bytes:
    """Return some thousand points on the static geometry, in the colours of its kinds.

    As all clouds of this file: a `PointCloud`, serialised.
    """
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    # As many for each kind: a wide ground would leave nothing for the obstacle on it.
    kinds, number = np.unique(mesh.kinds, return_inverse=True)
    shares = np.cumsum(areas / np.bincount(number, areas)[number])
    at = (np.arange(_PLACE_POINTS) + 0.5) * (len(kinds) / _PLACE_POINTS)
    faces = np.minimum(np.searchsorted(shares, at), len(shares) - 1)
    u, v = ((np.arange(1, _PLACE_POINTS + 1)[:, np.newaxis] * _R2) % 1.0).T
    outside = u + v > 1.0
    u, v = np.where(outside, 1.0 - u, u), np.where(outside, 1.0 - v, v)
    points = a[faces] + u[:, None] * (b - a)[faces] + v[:, None] * (c - a)[faces]
    palette = np.array([PLACE[kind] for kind in FACE_KINDS])
    return _cloud(0, WORLD, _rows(np.rint(points * _GRID) / _GRID, palette[mesh.kinds[faces]]))


@lru_cache(maxsize=4)
def robot_clouds(bodies: tuple[str, ...], visuals: tuple[Shape, ...]) -> dict[str, bytes]:
    """Return points of each body's shapes in its own frame: corners, and some points of meshes."""
    clouds: dict[str, bytes] = {}
    for body in bodies:
        shapes = [shape for shape in visuals if shape.body == body]
        if shapes:
            points = [_corners(shape) for shape in shapes]
            colours = [
                [shape.rgba or (0.5, 0.5, 0.5, 1.0)] * len(own)
                for shape, own in zip(shapes, points, strict=True)
            ]
            clouds[body] = _cloud(0, body, _rows(np.concatenate(points), np.concatenate(colours)))
    return clouds


class CourseClouds:
    """The course as dots and its waypoints as rings: green as far as they are reached.

    Args:
        start: where the robot was put down, (3,) m.
        trail: waypoints, (K, 3) m.
    """

    def __init__(self, start: ArrayLike, trail: Points) -> None:
        corners = np.concatenate([np.reshape(start, (1, 3)), trail])
        dots: list[Points] = [np.zeros((0, 3))]
        for near, far in pairwise(corners):
            count = max(1, round(float(np.linalg.norm(far - near)) / _DOTS))
            share = np.arange(1, count + 1)[:, np.newaxis] / count
            dots.append(near + share * (far - near))
        turns = np.linspace(0.0, 2.0 * np.pi, _RING, endpoint=False)
        ring = _RADIUS * np.stack([np.cos(turns), np.sin(turns), np.zeros(_RING)], axis=1)
        rings = (np.reshape(trail, (-1, 1, 3)) + ring).reshape(-1, 3)
        self._dots = _rows(np.concatenate(dots), OPEN)
        self._rings = _rows(np.rint(rings * _GRID) / _GRID, OPEN)
        self._ends = np.cumsum([len(leg) for leg in dots]).tolist()  # of the legs

    def trail(self, time_ns: int, *, reached: int) -> bytes:
        """Return the dots, green as far as the last waypoint that is reached."""
        return _cloud(time_ns, WORLD, _coloured(self._dots, self._ends[reached]))

    def waypoints(self, time_ns: int, *, reached: int) -> bytes:
        """Return a ring around each waypoint, the first `reached` green."""
        return _cloud(time_ns, WORLD, _coloured(self._rings, _RING * reached))


def path_cloud(time_ns: int, path: Points) -> bytes:
    """Return where the trunk's origin has been, (N, 3) m."""
    return _cloud(time_ns, WORLD, _rows(path, _PATH))


def cloud_points(message: Any) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return what a cloud of this file holds: points (N, 3) m and colours (N, 4)."""
    rows = np.frombuffer(message.data, _POINT)
    return rows["xyz"], rows["rgba"]


def _rows(points: Points, colours: ArrayLike) -> NDArray[Any]:
    """Return points (N, 3) of one colour, or of one each, as `_POINT`s."""
    rows = np.empty(len(points), _POINT)
    rows["xyz"] = points
    rows["rgba"] = _bytes(colours)
    return rows


def _coloured(rows: NDArray[Any], done: int) -> NDArray[Any]:
    """Return points of which the first ones are done."""
    rows["rgba"][:done], rows["rgba"][done:] = _REACHED, _OPEN
    return rows


def _bytes(colours: ArrayLike) -> Points:
    return np.rint(np.asarray(colours) * 255.0)


_REACHED, _OPEN = _bytes(REACHED), _bytes(OPEN)


def _cloud(time_ns: int, frame: str, rows: NDArray[Any]) -> bytes:
    return time_field(time_ns) + _head(frame) + _DATA + sized(rows.tobytes())


@lru_cache(maxsize=32)
def _head(frame: str) -> bytes:
    """Return a cloud without time and points."""
    fields = [
        PackedElementField(
            name=name,
            offset=offset,
            type=PackedElementField.UINT8 if offset >= 12 else PackedElementField.FLOAT32,
        )
        for name, offset in _FIELDS
    ]
    cloud = PointCloud(
        frame_id=frame,
        pose=Pose(position=Vector3(), orientation=Quaternion(w=1.0)),
        point_stride=_POINT.itemsize,
        fields=fields,
    )
    return cloud.SerializeToString(deterministic=True)


def _corners(shape: Shape) -> Points:
    """Return the corners of a shape's box in its body's frame, or some points of a mesh, (N, 3)."""
    if shape.triangles is not None:
        vertices = shape.triangles.vertices
        chosen = np.linspace(0, len(vertices) - 1, min(len(vertices), _MESH_POINTS))
        return vertices[chosen.astype(np.intp)]
    half = {
        "cylinder": (shape.size[0], shape.size[0], shape.size[-1]),
        "sphere": (shape.size[0],) * 3,
    }.get(shape.kind, shape.size)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return signs * np.asarray(half) @ rotation_matrix(shape.quat).T + np.asarray(shape.position)
