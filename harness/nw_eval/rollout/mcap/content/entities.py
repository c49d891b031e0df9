"""What a viewer draws: the place, the trail, the robot's parts, and waypoints that turn green.

Place, trail and waypoints stand in the frame `world`; each part of the robot stands in the frame of
its body, which `/tf` moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import assert_never

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from nw_eval.robots import Shape
from nw_eval.rollout.mcap.stamps import stamp
from nw_eval.rollout.mcap.wire import sized, time_field
from nw_eval.scenes.mesh import FACE_KINDS, FaceKind, TriangleMesh

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
    "beside": (0.78, 0.76, 0.72, 0.25),  # likewise
}
_WAYPOINT_DIAMETER = 0.6  # m; the reach radius of a waypoint is 0.3
_WAYPOINT_HEIGHT = 0.02  # m
_ENTITY = b"\x12"  # field 2 of a `SceneUpdate`
_LINE = 0.02  # m, how thick the trail is, and how far above the waypoints


@lru_cache(maxsize=32)  # as many places as a worker's `Library` keeps
def place_update(mesh: TriangleMesh) -> bytes:
    """Return the static geometry that rays meet, one entity for each kind of face, serialised.

    It is the same in every trial of a place. Protobuf messages add up: the bytes of one
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
    """Return the way from the start through all waypoints (K, 3) m as a line, serialised."""
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
        case _:
            assert_never(shape.kind)


def _pose(position: Sequence[float], wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> Pose:
    x, y, z = position
    qw, qx, qy, qz = wxyz
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=qw, x=qx, y=qy, z=qz))


def _colour(rgba: Colour) -> Color:
    red, green, blue, alpha = rgba
    return Color(r=red, g=green, b=blue, a=alpha)
