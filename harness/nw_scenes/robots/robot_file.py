"""The settings of `robot.yaml`: what a model file does not say about a robot, or says otherwise."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from nw_base.lens import Intrinsics, ShutterTime

ROBOT_FILE = "robot.yaml"


class _Part(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )


Name = Annotated[str, Field(min_length=1, max_length=200)]
Names = Annotated[list[Name], Field(max_length=200)]
Row = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]

# No robot has more. What is beyond is a slip of units (N m for mN m, degrees, millimetres), or
# larger than what physics in steps of 5 ms can follow.
Gain = Annotated[float, Field(ge=0.0, le=1e5)]
Torque = Annotated[float, Field(gt=0.0, le=1e5)]
Inertia = Annotated[float, Field(ge=0.0, le=1e3)]
Height = Annotated[float, Field(gt=0.0, le=10.0)]
Place = Annotated[float, Field(ge=-10.0, le=10.0)]


class ModelFile(_Part):
    """The file that describes the body."""

    file: Name
    """MJCF (`.xml`) or URDF (`.urdf`), in the folder; its meshes lie beside it."""
    sha256: str | None = None
    """Hex digest that the file must have; None = whatever lies there."""
    as_written: bool = False
    """Whether the MJCF is simulated as it is written, to the bit: it holds the robot alone, with
    one position servo a joint, of its name; its defaults of geoms hold for the scene, too. Geoms
    that collide are of group 3, those that are only seen of group 2."""


class Motors(_Part):
    """What the joints of a group have in place of what the model file says."""

    joints: Name | Names
    """Patterns of joint names, such as `*_hip_joint` or `*`."""
    follows: Literal["position", "velocity"] | None = None
    """What the motor is told. A wheel follows `velocity`: its torque is kd * (target - velocity),
    within `torque`. None = as the model file says, else `position`."""
    kp: Gain | None = None
    """Gain, N m / rad, at most 1e5."""
    kd: Gain | None = None
    """Damping, N m s / rad, at most 1e5, in place of the joint's own; of motors that follow
    velocities their gain."""
    torque: Torque | None = None
    """Largest torque, N m, at most 1e5."""
    armature: Inertia | None = None
    """kg m^2, at most 1000."""
    friction: Gain | None = None
    """Friction loss, N m, at most 1e5."""


class Fell(_Part):
    """When the robot has fallen."""

    tilt: Annotated[float, Field(gt=0.0, le=math.pi)] = 1.2
    """Roll or pitch of the root, rad."""
    height: Height | None = None
    """Height of the root above the ground under it, m, below which it fell; null = no limit."""


class Collided(_Part):
    """When the robot has collided."""

    force: Annotated[float, Field(gt=0.0, le=1e3)] = 0.08
    """Force on one part of `body`, in times the robot's weight."""
    newtons: Positive | None = None
    """The same force in N, in place of `force`."""


Quaternion = tuple[float, float, float, float]


class Eye(_Part):
    """A camera, which looks along x of its body unless it is turned."""

    body: Name | None = None
    """None = the root. With a body that joints move, it moves, too."""
    position: tuple[Place, Place, Place]
    """In the body, m, at most 10."""
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Turn of a frame whose x axis it looks along, y to the left, in the body: w x y z."""
    pitch: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Angle by which it looks down from there, rad."""
    fovy: Annotated[float, Field(gt=1.0, lt=179.0)] = 90.0
    """Vertical field of view, degrees."""
    intrinsics: Intrinsics | None = None
    """What it sees, in place of `fovy`: image size, focal lengths, principal point (pixels)."""
    readout: ShutterTime = 0.0
    """Time from the reading of the first row to that of the last, s, at most 0.1."""
    exposure: ShutterTime = 0.0
    """Time for which each row is exposed before it is read, s, at most 0.1."""

    @model_validator(mode="after")
    def _one_view(self) -> Eye:
        if self.intrinsics is not None and "fovy" in self.model_fields_set:
            raise ValueError(
                "`fovy` and `intrinsics` both set the field of view; remove one of them"
            )
        return self


class Camera(Eye):
    """A camera of a body."""

    rotation: tuple[Row, Row, Row] | None = None
    """R_body_camera, row by row, in place of `quaternion` and `pitch`: OpenCV's x right, y down, z
    forward."""

    @model_validator(mode="after")
    def _one_turn(self) -> Camera:
        others = [key for key in ("quaternion", "pitch") if key in self.model_fields_set]
        if self.rotation is not None and others:
            raise ValueError(f"`rotation` and `{others[0]}` both say how it is turned; remove one")
        return self


class FreeJoint(_Part):
    """What acts on the free joint."""

    damping: NotNegative = 0.0
    """N s / m, and N m s / rad."""
    armature: NotNegative = 0.0
    """kg, and kg m^2."""
    friction: NotNegative = 0.0
    """N, and N m."""


class Published(_Part):
    """What is otherwise under the protocol `neverwhere-2026`."""

    body: Names | None = None
    """Parts whose contact is `collided`; None = those of `body`."""
    free_joint: FreeJoint = FreeJoint()
    """What joint defaults of the published file put on the free joint."""
    height_camera: Row = (0.0, 0.0, 25.0)
    """From the centre of mass to the camera of the published height map, m."""


class Imu(_Part):
    """Where angular velocity, gravity and acceleration are measured."""

    site: Name | None = None
    """A site of the model, with its place and its axes."""
    body: Name | None = None
    """Else a body; None = the root."""
    position: tuple[Place, Place, Place] = (0.0, 0.0, 0.0)
    """In the body, m, at most 10."""
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Turn of its axes in the body, w x y z."""

    @model_validator(mode="after")
    def _one_place(self) -> Imu:
        if self.site is not None and self.model_fields_set - {"site"}:
            raise ValueError(
                "a site has its own position and axes; remove `site`, or everything else"
            )
        return self


CameraName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]


class RobotFile(_Part):
    """`robot.yaml`: what a model file does not say about a robot, or says otherwise."""

    schema_version: Literal[1] = Field(alias="nw-robot")
    """Version of this kind of file."""
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,63}$")]
    """What cards and reports call the robot."""
    model: ModelFile
    root: Name | None = None
    """The body with the free joint, which is the trunk; derived."""
    touches: Literal["body", "geom"] = "body"
    """What `feet` and `body` name. The force on a body is the sum over its geoms, without contacts
    of the robot with itself; that on a geom counts every contact."""
    feet: Annotated[Names, Field(min_length=1)] | None = None
    """In the order that cards may use; derived: the bodies lowest in the pose."""
    pose: Name | dict[Name, float] | None = None
    """A keyframe of the model, or angles (rad) by patterns of joint names; what is not named is 0,
    or the nearest in its range. None = the keyframe `home`, or the only one."""
    motors: list[Motors] = Field(default_factory=list[Motors], max_length=200)
    """A later group wins."""
    body: Names | None = None
    """Bodies whose contact is `collided`; [] = none. None = the root."""
    fell: Fell = Fell()
    collided: Collided = Collided()
    eye: Eye | None = None
    """The camera `ego`. None = the model's first camera on the trunk, or one at its front."""
    cameras: Annotated[dict[CameraName, Camera], Field(max_length=16)] = Field(
        default_factory=dict[str, Camera]
    )
    """Cameras by the names that cards call them, beside those of the model that have a name."""
    imu: Imu | None = None
    """None = the root's own frame."""
    spawn_height: Height | None = None
    """Of the root's origin above the ground at the start, m, at most 10; derived."""
    published: Published = Published()
    """For robots of the published evaluation."""
