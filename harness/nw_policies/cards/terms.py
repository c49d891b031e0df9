"""Terms: the named groups of numbers that a proprioceptive observation is made of.

A term's numbers are `clip(value) * scale + offset`, in SI units and radians before that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, assert_never, cast

from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from nw_base.errors import PolicyError, nearest
from nw_policies.cards.joints import named_joints, short_name
from nw_policies.cards.model import CardModel, Limits

Foot = Annotated[str, Field(min_length=1, max_length=100)]

EARLIER_OUTPUTS = 4
"""How many outputs before the last one a card can ask for."""

_NUMBERS = 10_000
"""Of one constant."""


class ScaledTerm(CardModel):
    """What all terms have: numbers that are scaled."""

    scale: float | list[float] = 1.0
    """Factor, one for all numbers of the term or one each."""
    offset: float = 0.0
    """Added after scaling."""
    clip: Limits | None = None
    """Limits before scaling. Limits after scaling are the observation's `clip`."""


class AngularVelocity(ScaledTerm):
    """Angular velocity, rad/s (3), of the robot's IMU if it has one, else of the trunk."""

    term: Literal["ang_vel"]
    frame: Literal["trunk", "world"] = "trunk"
    """Whose axes the numbers are along."""


class LinearVelocity(ScaledTerm):
    """Velocity of a point of the trunk, m/s (3). `yaw` is the world frame turned by the yaw."""

    term: Literal["lin_vel"]
    frame: Literal["trunk", "world", "yaw"] = "trunk"
    """Whose axes the numbers are along."""
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The point, in the trunk frame, m: where the velocity sensor of the training sat."""


class Gravity(ScaledTerm):
    """Direction of gravity, a unit vector (3), in the frame of the IMU, or else of the trunk.

    It is (0, 0, -1) when level.
    """

    term: Literal["gravity"]


class RollPitch(ScaledTerm):
    """Roll and pitch of the trunk, rad (2)."""

    term: Literal["roll_pitch"]


class Imu(ScaledTerm):
    """Roll, pitch, 0, rad (3), as extreme-parkour lays them out."""

    term: Literal["imu"]


class Yaw(ScaledTerm):
    """Heading of the trunk: its yaw, rad in [-pi, pi), positive to the left."""

    term: Literal["yaw"]
    relative_to: Literal["world", "start"] = "world"
    """`world`: from the world's x axis. `start`: from the heading at the start of the trial."""
    values: Literal["angle", "sine_cosine"] = "angle"
    """`angle`: (1). `sine_cosine`: (2), without the jump."""


class Orientation(ScaledTerm):
    """Orientation of the trunk in the world: a unit quaternion (4) q_world_trunk."""

    term: Literal["orientation"]
    order: Literal["wxyz", "xyzw"] = "wxyz"
    """Which number stands where: Isaac Lab from 3 and ROS have `xyzw`, MuJoCo has `wxyz`."""


class Acceleration(ScaledTerm):
    """What an accelerometer reads, m/s^2 (3) along the axes of the IMU, or else the trunk.

    That is the point's acceleration minus gravity: (0, 0, 9.806) at rest, zeros in free fall.
    """

    term: Literal["acceleration"]
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where it sits, from the IMU, or else the trunk's origin, along these axes, m."""


class DeltaYaw(ScaledTerm):
    """Angle from the heading to the next waypoint, rad in [-pi, pi), positive to the left."""

    term: Literal["delta_yaw"]
    copies: int = Field(default=1, ge=1, le=8)
    """How many times the angle stands there."""


class Command(ScaledTerm):
    """Velocity command vx, vy (m/s, yaw frame) and yaw rate (rad/s) of the card's `command` (3)."""

    term: Literal["command"]
    parts: Annotated[list[Literal["vx", "vy", "yaw"]], Field(min_length=1, max_length=3)] | None = (
        None
    )
    """Which of the three, in their order; None = all."""

    @model_serializer(mode="wrap")
    def _without_parts(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out `parts` that are not given: cards keep the digest that they had."""
        fields: dict[str, Any] = write(self)
        return {key: value for key, value in fields.items() if value is not None or key != "parts"}


class Moving(ScaledTerm):
    """1 while the velocity command asks for motion, 0 while it asks to stand (1)."""

    term: Literal["moving"]
    below: float = Field(default=0.1, gt=0.0)
    """Norm of vx, vy (m/s) and yaw rate (rad/s) of the command, below which it is to stand."""


class Target(ScaledTerm):
    """What the task asks for beside a velocity, such as a height: one number for each name."""

    term: Literal["target"]
    of: Annotated[dict[Foot, float], Field(min_length=1, max_length=200)]
    """Names, in their order, each with its value where the task does not ask for it: a joint's
    angle, rad, or what a suite's `targets` call the same, such as `height`, m."""


class Speed(ScaledTerm):
    """Forward speed that the card's `command` asks for, m/s (1)."""

    term: Literal["speed"]


JointKeys = Annotated[list[Foot], Field(max_length=200)]
"""Joints, types or patterns, as the keys of `control.scale` are."""


class _OfJoints(ScaledTerm):
    leave_out: JointKeys | None = None
    """Joints that it has no number for, such as the positions of wheels: names, types, patterns.
    None = those of `control.held`; [] = none, so that held joints are seen."""

    @model_serializer(mode="wrap")
    def _as_before(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out lists of joints that are not given: cards keep the digest that they had."""
        fields: dict[str, Any] = write(self)
        return {k: v for k, v in fields.items() if v is not None or k not in {"leave_out", "zero"}}


class JointPosition(_OfJoints):
    """Joint positions, rad, in the order of `control.joints` (12)."""

    term: Literal["joint_pos"]
    relative: bool = True
    """Minus `control.default_pose`."""
    zero: JointKeys | None = None
    """Joints whose number is 0, such as those of wheels, which turn for ever."""


class JointVelocity(_OfJoints):
    """Joint velocities, rad/s, in the order of `control.joints` (12)."""

    term: Literal["joint_vel"]


class _FedBack(_OfJoints):
    clipped: bool = False
    """Whether it is fed back after `control.clip`, as legged_gym does; else as the network said it,
    as extreme-parkour does."""


class AppliedAction(_FedBack):
    """The raw action that the last control step applied: after the delay, before scaling (12)."""

    term: Literal["applied_action"]


class LastOutput(_FedBack):
    """The policy's own last raw output, which may still wait in the delay queue (12)."""

    term: Literal["last_output"]
    ago: int = Field(default=0, ge=0, le=EARLIER_OUTPUTS)
    """How many outputs lie between: 1 = the last but one. Zeros stand for those before the first.
    """


class FootContacts(ScaledTerm):
    """1 for a foot on the ground (force over 2 N), 0 for one in the air: one for each foot."""

    term: Literal["foot_contacts"]
    feet: Annotated[tuple[Foot, ...], Field(min_length=1, max_length=100)] = (
        "FR",
        "FL",
        "RR",
        "RL",
    )
    """The feet that are seen, in their order, by the robot's names of them."""
    filter: Literal["two_steps", "none"] = "two_steps"
    """`two_steps`: on the ground now or one control step ago. `none`: now."""


class Standing(CardModel):
    """Value of a gait clock while the command is to stand. The clock itself continues."""

    below: float = Field(gt=0.0)
    """Norm of vx, vy (m/s) and yaw rate (rad/s) of the command, below which it is so."""
    phase: float | None = Field(default=None, ge=-1.0, lt=1.0)
    """The phase of every foot then, of which -1 is none that a foot has else; null = every number
    of the term is 0."""


class GaitClock(ScaledTerm):
    """A clock that paces the feet: functions of the phase of each of them.

    Phase = (`frequency` * seconds since the start + offset of the foot) modulo 1, in cycles; the
    share `stance` of a cycle is stretched, or shrunk, to its first half.
    """

    term: Literal["clock"]
    frequency: float = Field(gt=0.0, le=25.0)
    """Cycles per second, Hz; a period of 0.8 s is 1.25."""
    offsets: list[float] = Field(default=[0.0], min_length=1, max_length=16)
    """Phase of each foot at the start, in cycles."""
    stance: float = Field(default=0.5, gt=0.0, lt=1.0)
    """Share of a cycle that a foot is meant to stand: the `duration` of walk-these-ways."""
    values: list[Literal["sine", "cosine", "phase"]] = Field(
        default=["sine", "cosine"], min_length=1, max_length=3
    )
    """What stands there, one after another, each of all feet: sine and cosine of 2 pi phase, or the
    phase itself, in [0, 1)."""
    standing: Standing | None = None
    """null = the clock runs at any command."""


class Constant(ScaledTerm):
    """Numbers that never change."""

    term: Literal["constant"]
    values: Annotated[list[float], Field(max_length=_NUMBERS)] = Field(default_factory=list[float])
    """The numbers; or, where all are the same, `value` and `width`."""
    value: float | None = Field(default=None, exclude=True)
    """What each of them is."""
    width: Annotated[int, Field(ge=1, le=_NUMBERS)] | None = Field(default=None, exclude=True)
    """How many there are."""

    @model_validator(mode="before")
    @classmethod
    def _written_out(cls, data: Any) -> Any:
        """Read `value` and `width` as `values`: both forms are the same card."""
        if not isinstance(data, dict) or "values" in data:
            return data
        value, width = data.get("value"), data.get("width")
        if isinstance(value, bool) or not isinstance(value, int | float):
            return data
        if not isinstance(width, int) or not 1 <= width <= _NUMBERS:
            return data
        rest = {key: data[key] for key in data if key not in {"value", "width"}}
        return {**rest, "values": [float(value)] * width}

    @model_validator(mode="after")
    def _one_form(self) -> Constant:
        if not self.values or self.value is not None or self.width is not None:
            message = "a constant has `values: [...]`, or `value` and `width`"
            raise ValueError(f"{message}; write `{{term: constant, value: 0.0, width: 187}}`")
        return self


def bare_word(value: Any) -> Any:
    """Read `joint_vel` as `{term: joint_vel}`."""
    return {"term": value} if isinstance(value, str) else value


AnyTerm = (
    AngularVelocity
    | LinearVelocity
    | Gravity
    | RollPitch
    | Imu
    | Yaw
    | Orientation
    | Acceleration
    | DeltaYaw
    | Command
    | Moving
    | Target
    | Speed
    | JointPosition
    | JointVelocity
    | AppliedAction
    | LastOutput
    | FootContacts
    | GaitClock
    | Constant
)
Term = Annotated[Annotated[AnyTerm, Field(discriminator="term")], BeforeValidator(bare_word)]


def check_feet(term: FootContacts, feet: Sequence[str]) -> None:
    """Check that a robot with `feet` has those of a term.

    Raises:
        PolicyError: it does not.
    """
    for foot in term.feet:
        if foot not in feet:
            known = nearest(foot, feet)
            raise PolicyError(f"foot_contacts: the robot has no foot {foot!r}", fix=known)


def seen_joints(term: _OfJoints, joints: Sequence[str]) -> list[int]:
    """Return the positions in `joints` that a term has a number for.

    Raises:
        PolicyError: `leave_out` names no joint, or all of them.
    """
    word = cast("AnyTerm", term).term
    out = named_places(term.leave_out or (), joints, f"{word}: leave_out")
    if len(out) == len(joints):
        raise PolicyError(f"{word}: leave_out names every joint", fix="remove the term")
    return [index for index in range(len(joints)) if index not in out]


def named_places(keys: Sequence[str], joints: Sequence[str], where: str) -> set[int]:
    """Return the positions in `joints` that keys name: joints, types or patterns.

    Raises:
        PolicyError: a key names no joint; the message begins with `where`.
    """
    names = [short_name(joint) for joint in joints]
    places: set[int] = set()
    for key in keys:
        hits = named_joints(key, names)
        if not hits:
            message = f"{where}: {key!r} names no joint"
            raise PolicyError(message, fix=nearest(short_name(key), names))
        places |= {names.index(name) for name in hits}
    return places


def term_size(  # noqa: C901, PLR0912 - one line a term.
    term: AnyTerm, joints: Sequence[str]
) -> int:
    """Return how many numbers a term has on a robot with those joints.

    Raises:
        PolicyError: it names joints that the robot does not have.
    """
    match term:
        case AngularVelocity() | LinearVelocity() | Gravity() | Imu() | Acceleration():
            return 3
        case Command():
            return 3 if term.parts is None else len(term.parts)
        case Target():
            return len(term.of)
        case Orientation():
            return 4
        case RollPitch():
            return 2
        case Speed() | Moving():
            return 1
        case FootContacts():
            return len(term.feet)
        case Yaw():
            return 1 if term.values == "angle" else 2
        case DeltaYaw():
            return term.copies
        case JointPosition() | JointVelocity() | AppliedAction() | LastOutput():
            return len(seen_joints(term, joints)) if term.leave_out else len(joints)
        case GaitClock():
            return len(term.offsets) * len(term.values)
        case Constant():
            return len(term.values)
        case _:
            assert_never(term)


LayoutName = Literal["parkour53"]

LAYOUTS: dict[LayoutName, tuple[AnyTerm, ...]] = {
    # The 53 numbers of extreme-parkour, LucidSim and Neverwhere. Index 7 is a copy of 6, as in
    # their evaluation; 11 and 12 mask the environment kind, always (1, 0) here.
    "parkour53": (
        AngularVelocity(term="ang_vel", scale=0.25),
        Imu(term="imu"),
        DeltaYaw(term="delta_yaw", copies=2),
        Constant(term="constant", values=[0.0, 0.0]),
        Speed(term="speed"),
        Constant(term="constant", values=[1.0, 0.0]),
        JointPosition(term="joint_pos"),
        JointVelocity(term="joint_vel", scale=0.05),
        AppliedAction(term="applied_action"),
        FootContacts(term="foot_contacts", offset=-0.5),
    ),
}
