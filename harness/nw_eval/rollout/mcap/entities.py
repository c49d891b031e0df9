"""What a viewer draws: the place, the robot's parts, and waypoints that turn green.

Static geometry and waypoints stand in the frame `world`; each part of the robot stands in the
frame of its body, which `/tf` moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from nw_eval.robots import RobotSpec, Shape
from nw_eval.scenes.mesh import FACE_KINDS, FaceKind, TriangleMesh

WORLD = "world"
_OPEN = Color(r=0.95, g=0.55, b=0.10, a=0.85)
_REACHED = Color(r=0.15, g=0.75, b=0.30, a=0.85)
_PLACE: dict[FaceKind, Color] = {
    "ground": Color(r=0.55, g=0.57, b=0.53, a=1.0),
    "obstacle": Color(r=0.62, g=0.40, b=0.24, a=1.0),
    "structure": Color(r=0.78, g=0.76, b=0.72, a=1.0),
    "clutter": Color(r=0.45, g=0.55, b=0.42, a=1.0),
    "overhead": Color(r=0.80, g=0.80, b=0.80, a=0.25),  # seen through, or it hides the robot
    "beside": Color(r=0.78, g=0.76, b=0.72, a=0.25),  # likewise
}
_WAYPOINT_DIAMETER = 0.6  # m; the reach radius of a waypoint is 0.3
_WAYPOINT_HEIGHT = 0.02  # m


def place_entities(mesh: TriangleMesh) -> tuple[SceneEntity, ...]:
    """Return the static geometry that rays meet, one entity for each kind of face."""
    entities: list[SceneEntity] = []
    for number, kind in enumerate(FACE_KINDS):
        faces = mesh.faces[mesh.kinds == number]
        if not len(faces):
            continue
        used, indices = np.unique(faces, return_inverse=True)
        triangles = TriangleListPrimitive(
            pose=_pose((0.0, 0.0, 0.0)), color=_PLACE[kind], indices=indices.ravel().tolist()
        )
        # Single precision is plenty for a picture, and its zero bits compress.
        for x, y, z in mesh.vertices[used].astype(np.float32).tolist():
            triangles.points.add(x=x, y=y, z=z)
        entities.append(
            SceneEntity(
                frame_id=WORLD, id=f"place/{kind}", frame_locked=True, triangles=[triangles]
            )
        )
    return tuple(entities)


def robot_entities(robot: RobotSpec) -> tuple[SceneEntity, ...]:
    """Return one entity for each body of the robot that has something to see."""
    entities: list[SceneEntity] = []
    for body in robot.bodies:
        shapes = [shape for shape in robot.visuals if shape.body == body]
        if shapes:
            entity = SceneEntity(frame_id=body, id=f"robot/{body}", frame_locked=True)
            for shape in shapes:
                _add_shape(entity, shape)
            entities.append(entity)
    return tuple(entities)


def waypoint_entity(number: int, position: Sequence[float], *, reached: bool) -> SceneEntity:
    """Return waypoint `number` (from 0) as a disc: orange while it is open, green once reached."""
    x, y, z = (float(value) for value in position)
    colour = _REACHED if reached else _OPEN
    disc = CylinderPrimitive(
        pose=_pose((x, y, z)),
        size=Vector3(x=_WAYPOINT_DIAMETER, y=_WAYPOINT_DIAMETER, z=_WAYPOINT_HEIGHT),
        bottom_scale=1.0,
        top_scale=1.0,
        color=colour,
    )
    label = TextPrimitive(
        pose=_pose((x, y, z + 0.25)),
        billboard=True,
        font_size=0.12,
        scale_invariant=False,
        color=colour,
        text=str(number),
    )
    return SceneEntity(
        frame_id=WORLD,
        id=f"waypoint/{number}",
        frame_locked=True,
        cylinders=[disc],
        texts=[label],
    )


def _add_shape(entity: SceneEntity, shape: Shape) -> None:
    pose = _pose(shape.position, shape.quat)
    red, green, blue, alpha = shape.rgba or (0.5, 0.5, 0.5, 1.0)
    colour = Color(r=red, g=green, b=blue, a=alpha)
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


def _pose(position: Sequence[float], wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> Pose:
    x, y, z = position
    qw, qx, qy, qz = wxyz
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=qw, x=qx, y=qy, z=qz))
