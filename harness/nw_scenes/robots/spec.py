"""What the rest of the house knows about a robot.

Frames: the trunk is the root body; its frame has x forward, y left, z up. Camera frames follow
OpenCV: x right, y down, z forward. Quaternions are w x y z. Joints, actuators and actions share one
order, the order of `RobotSpec.joints`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nw_base.lens import WIDEST, Intrinsics

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Follow = Literal["position", "velocity", "torque"]
"""What a motor is told: a joint position (rad), a joint velocity (rad / s), or a torque (N m)."""

# Turns that lay what stands along z, such as a cylinder, along x and along y.
Z_TO_X: Quaternion = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
Z_TO_Y: Quaternion = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)

# Geom groups of MuJoCo; rays for overlays see VISUAL_GROUP only.
STATIC_GROUP = 0  # of the scene
VISUAL_GROUP = 2
COLLISION_GROUP = 3


@dataclass(frozen=True)
class Triangles:
    """A mesh, as bytes: robots are compared and hashed."""

    points: bytes  # float32, three a vertex, m
    corners: bytes  # int32, three a face: vertices, counter-clockwise from outside

    @classmethod
    def of(cls, vertices: npt.NDArray[Any], faces: npt.NDArray[Any]) -> Triangles:
        """Return those of vertices (V, 3) m and faces (F, 3)."""
        return cls(vertices.astype("<f4").tobytes(), faces.astype("<i4").tobytes())

    @property
    def vertices(self) -> npt.NDArray[np.float32]:
        """(V, 3) m."""
        return np.frombuffer(self.points, "<f4").reshape(-1, 3)

    @property
    def faces(self) -> npt.NDArray[np.int32]:
        """(F, 3)."""
        return np.frombuffer(self.corners, "<i4").reshape(-1, 3)


@dataclass(frozen=True, kw_only=True)
class Shape:
    """One primitive or mesh fixed to a body of the robot.

    `size` is, by kind: box half sizes (3); cylinder radius and half length, axis z (2); ellipsoid
    radii (3); sphere radius (1). All in metres. A mesh has none, and its `triangles` stand in the
    frame of the body.
    """

    body: str
    kind: Literal["box", "cylinder", "ellipsoid", "sphere", "mesh"]
    size: tuple[float, ...]
    position: Vector3 = (0.0, 0.0, 0.0)
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)
    name: str = ""
    rgba: tuple[float, float, float, float] | None = None  # None: collision only, never seen
    triangles: Triangles | None = None  # of a mesh


@dataclass(frozen=True, kw_only=True)
class CameraMount:
    """Where a camera sits on the trunk, or on another `body` that joints move against it.

    `R_trunk_camera` (3 x 3, row by row) maps OpenCV camera axes to those of its body. `fovy` is the
    vertical field of view in radians.
    """

    position: Vector3
    R_trunk_camera: tuple[Vector3, Vector3, Vector3]
    fovy: float
    body: str = ""  # that carries it; "" = the trunk
    intrinsics: Intrinsics | None = None  # None = square pixels, with the axis in the middle
    readout: float = 0.0  # s from the upper border to the lower one; 0 = all rows at once
    exposure: float = 0.0  # s for which each row is open; 0 = an instant

    def lens(self, width: int, height: int) -> Intrinsics:
        """Return what an image of so many pixels shows: always the whole view."""
        if self.intrinsics is None:
            return Intrinsics.from_fovy(width, height, self.fovy)
        return self.intrinsics.resized(width, height)

    def with_intrinsics(self, intrinsics: Intrinsics) -> CameraMount:
        """Return it with another lens."""
        return replace(self, intrinsics=intrinsics, fovy=intrinsics.fovy)

    @property
    def T_trunk_camera(self) -> npt.NDArray[np.float64]:  # noqa: N802  # The field's name.
        """The (4, 4) transform that maps camera points to the frame of its body."""
        transform = np.eye(4)
        transform[:3, :3] = self.R_trunk_camera
        transform[:3, 3] = self.position
        return transform


@dataclass(frozen=True, kw_only=True)
class ImuMount:
    """Where angular velocity, gravity and acceleration are measured.

    `R_body_imu` (3 x 3, row by row) maps its axes to those of its body.
    """

    body: str = ""  # that carries it; "" = the trunk
    position: Vector3 = (0.0, 0.0, 0.0)  # in its body, m
    R_body_imu: tuple[Vector3, Vector3, Vector3] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )


@dataclass(frozen=True, kw_only=True)
class RobotSpec:
    """A robot as policies, sensors and the simulation see it. SI units, radians.

    Per-joint figures are in the order of `joints`, J of them. `feet` (F of them) and the monitored
    parts are names of geoms or of bodies, as `touches` says. The force on a body is the sum over
    its geoms, without contacts of the robot with itself; that on a geom counts every contact.
    """

    name: str
    joints: tuple[str, ...]  # J names
    default_pose: tuple[float, ...]  # (J,) rad; what action 0 means
    joint_ranges: tuple[tuple[float, float], ...]  # (J, 2) rad
    kp: tuple[float, ...]  # (J,) N m / rad
    joint_damping: tuple[float, ...]  # (J,) N m s / rad; the kd of the servos
    torque_limits: tuple[float, ...]  # (J,) N m, symmetric
    armature: tuple[float, ...]  # (J,) kg m^2
    friction_loss: tuple[float, ...]  # (J,) N m
    # (J,) what each motor follows; () = positions, all of them. A motor that follows velocities
    # gives kd * (target - velocity), within its limit, and its joint has no other damping.
    follows: tuple[Follow, ...] = ()
    root_joint: str  # the free joint of the root body
    touches: Literal["geom", "body"]  # what `feet` and the monitored parts are names of
    feet: tuple[str, ...]  # F names; their order is that of foot contacts
    monitored: tuple[str, ...]  # whose contact ends an episode
    published_monitored: tuple[str, ...]  # the same under a protocol that watches those
    fell_tilt: float  # rad of roll or pitch; beyond it the robot fell
    fell_height: float | None = None  # m of the trunk above the ground; below it the robot fell
    collided_force: float  # N on a monitored part; beyond it the robot collided
    cameras: dict[str, CameraMount]
    imu: ImuMount | None = None  # None = the trunk's own frame
    height_camera_offset: Vector3  # published scandots camera minus the centre of mass, m
    # What the joint defaults of the published file put on the free joint, under a protocol that
    # keeps it: damping (N s / m, N m s / rad), armature (kg, kg m^2), friction loss (N, N m).
    root_defaults: Vector3 = (0.0, 0.0, 0.0)
    bodies: tuple[str, ...]  # every body, the root first, parents before children
    visuals: tuple[Shape, ...]  # what a viewer draws, in body frames
    # What pictures draw: geoms of VISUAL_GROUP in `mjcf`, or `visuals`, which physics knows not of.
    pictured: Literal["geoms", "visuals"] = "geoms"
    spawn_height: float  # m, trunk origin above the ground at the start
    # The model as MJCF text, without ground or options of the scene; one actuator a joint, of its
    # name and in the order of `joints`.
    mjcf: str

    @property
    def root(self) -> str:
        """Name of the body that the free joint moves: the trunk."""
        return self.bodies[0]

    @property
    def standing_targets(self) -> tuple[float, ...]:
        """(J,) what its own motors are told to stand: the default pose, rad; wheels 0 rad / s."""
        follows = self.follows or ("position",) * len(self.joints)
        return tuple(
            angle if follow == "position" else 0.0
            for angle, follow in zip(self.default_pose, follows, strict=True)
        )


def remounted(mount: CameraMount, *, pitch: float, height: float, factor: float) -> CameraMount:
    """Return a camera that looks farther down, sits higher and sees more or less.

    The same values as the robot's own change no bit.

    Args:
        mount: the robot's own.
        pitch: angle by which it looks farther down, rad.
        height: length by which it sits higher on the trunk, m.
        factor: of its vertical field of view.

    Raises:
        ValueError: no camera sees so wide an angle.
    """
    if (pitch, height, factor) == (0.0, 0.0, 1.0):
        return mount
    x, y, z = mount.position
    cosine, sine = math.cos(pitch), math.sin(pitch)
    # About the camera's x axis, to the right: its optical axis goes down.
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
    rows = (np.array(mount.R_trunk_camera) @ turn).tolist()
    lens = mount.intrinsics
    if lens is None and factor != 1.0 and mount.fovy * factor > 2.0 * WIDEST:
        raise ValueError(
            f"{math.degrees(mount.fovy * factor):.0f} degrees from top to bottom are more than the "
            f"{math.degrees(2.0 * WIDEST):.0f} that a camera can see"
        )
    return replace(
        mount,
        position=(x, y, z + height),
        R_trunk_camera=tuple((a, b, c) for a, b, c in rows),
        fovy=mount.fovy * factor,
        intrinsics=lens if lens is None or factor == 1.0 else lens.widened(factor),
    )
