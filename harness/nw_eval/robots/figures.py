"""The tables that a robot is built from: one row a body, one shape a contact surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.robots.spec import CameraMount, Quaternion, Shape, Vector3


@dataclass(frozen=True, kw_only=True)
class Inertial:
    """Mass in kg, centre of mass in the body frame in m, principal inertia in kg m^2."""

    mass: float
    com: Vector3
    principal: Vector3
    quat: Quaternion  # of the principal frame in the body frame


@dataclass(frozen=True, kw_only=True)
class Link:
    """One moving body of a leg and the joint that carries it."""

    position: Vector3  # of the joint, in the parent body
    axis: Vector3
    range: tuple[float, float]  # rad
    inertial: Inertial


@dataclass(frozen=True, kw_only=True)
class Leg:
    """Hip, thigh and calf of one leg; bodies and joints are named after it."""

    name: str
    hip: Link
    thigh: Link
    calf: Link


@dataclass(frozen=True, kw_only=True)
class Attachment:
    """A body welded to the trunk, whose mass comes from its collision shapes."""

    name: str
    position: Vector3


@dataclass(frozen=True, kw_only=True)
class FollowingCamera:
    """A camera that keeps its offset from the centre of mass and does not turn with the trunk.

    Axes are MuJoCo's: x right, y up, looking along minus z.
    """

    name: str
    position: Vector3
    x_axis: Vector3
    y_axis: Vector3
    fovy: float  # rad


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Everything that a robot and its MJCF are made from."""

    name: str
    trunk: Inertial
    attachments: tuple[Attachment, ...]
    legs: tuple[Leg, ...]  # in the order of `spec.LEGS`
    collisions: tuple[Shape, ...]
    visuals: tuple[Shape, ...]
    cameras: dict[str, CameraMount]
    followers: tuple[FollowingCamera, ...]
    spawn_height: float
    kp: float
    joint_damping: float
    armature: float
    friction_loss: float
    torque_limit: float
    geom_friction: Vector3
    contact_margin: float  # m, of a pair of geoms
    default_pose: tuple[float, ...]  # rad, in the order of the joints
    monitored_geoms: tuple[str, ...]
    published_monitored_geoms: tuple[str, ...]
    height_camera_offset: Vector3  # m, of the published height map's camera
