"""What a task is: where a trial begins, what the robot is to do, what counts, and when it ends.

A kind of task is one class in one file: `course` (waypoints in order) is built in, and the entry
points of the group `nw_eval.tasks` add others. A task sees physics through `Readings` alone, which
`sim.World` gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from nw_base.memory import read_only
from nw_base.plural import plural
from nw_base.protocol import STRICT, EvaluationProtocol
from nw_base.words import Outcome
from nw_gate.scores import ScoreSpec

if TYPE_CHECKING:
    from nw_sim.tasks.reference import PlacedReference, Reference
    from nw_sim.tasks.targets import OwnTarget

Array = NDArray[np.float64]
Velocity = tuple[float, float, float]
"""Forward and left, m/s in the yaw frame, and yaw rate, rad/s."""

_NO_WAYPOINTS = read_only(np.zeros((0, 3)))


class TaskSettings(BaseModel):
    """What a suite says of its task: `kind`, and the keys of that kind.

    The settings of a kind are a subclass whose `kind` is a `Literal` of its name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    kind: Any


class TaskPart(BaseModel):
    """A mapping within the settings of a task."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True, kw_only=True)
class TaskRules:
    """What a suite says of all its trials, whatever the task.

    Attributes:
        protocol: which behaviours are the published ones.
        duration: simulated time after which a trial ends at the latest, s.
        control_period: seconds of one control step.
        contact_termination: whether a collision ends a trial.
        reference: the motion that the policy tracks, on its robot; None = it tracks none.
        own: what a task may ask of the policy beside a velocity, by name; None = not known.
    """

    protocol: EvaluationProtocol = STRICT
    duration: float = 12.0
    control_period: float = 0.02
    contact_termination: bool = True
    reference: Reference | None = None
    own: Mapping[str, OwnTarget] | None = None


class Streams(Protocol):
    """The randomness of one trial; `suite.trials.Trial` is one."""

    @property
    def index(self) -> int:
        """Number of the trial in its scene, from 0."""
        ...

    def generator(self, stream: str) -> np.random.Generator:
        """Return a fresh generator at the start of a named stream."""
        ...


class StartArea(Protocol):
    """Where a scene has robots start; `scenes.Spawn` is one."""

    @property
    def position(self) -> tuple[float, float, float]:
        """Ground under the robot, m."""
        ...

    @property
    def yaw(self) -> float:
        """Heading, rad."""
        ...

    @property
    def x_jitter(self) -> float:
        """Half-width of the uniform draw on x, m."""
        ...

    @property
    def y_jitter(self) -> float:
        """The same on y, m."""
        ...

    @property
    def yaw_jitter(self) -> float:
        """The same on the heading, rad."""
        ...


class GroundPlane(Protocol):
    """The plane that a scene stands on."""

    @property
    def z(self) -> float:
        """Its height, m."""
        ...


class Place(Protocol):
    """What a task may know of a scene; `scenes.Scene` is one."""

    @property
    def spawn(self) -> StartArea:
        """Where robots start."""
        ...

    @property
    def ground(self) -> GroundPlane:
        """The plane under everything."""
        ...

    @property
    def trail(self) -> Array:
        """Nominal waypoints, (K, 3) m."""
        ...

    @property
    def waypoint_noise(self) -> tuple[float, float]:
        """Half-widths by which a trial may move waypoints along x and y, m."""
        ...


class TaskRobot(Protocol):
    """What a task may know of a robot; `robots.RobotSpec` is one."""

    @property
    def name(self) -> str:
        """Such as go1."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Their names, in the order of actions."""
        ...

    @property
    def feet(self) -> tuple[str, ...]:
        """Names of their geoms, in leg order."""
        ...

    @property
    def fell_tilt(self) -> float:
        """Roll or pitch beyond which it fell, rad."""
        ...

    @property
    def fell_height(self) -> float | None:
        """Height of the trunk over the ground below which it fell, m; None = none."""
        ...

    @property
    def collided_force(self) -> float:
        """Contact force on a monitored part beyond which it collided, N."""
        ...

    @property
    def spawn_height(self) -> float:
        """Trunk origin above the ground at the start, m."""
        ...


class Readings(Protocol):
    """What a task may read of the physics after a control step; `sim.World` has it.

    Frames: world z up; the trunk frame x forward, y left, z up.
    """

    @property
    def scene(self) -> Place:
        """Where the robot is."""
        ...

    @property
    def time(self) -> float:
        """Seconds since the reset."""
        ...

    @property
    def trunk_position(self) -> Array:
        """(3,) world, m."""
        ...

    @property
    def trunk_rotation(self) -> Array:
        """R_world_trunk, (3, 3)."""
        ...

    @property
    def trunk_linear_velocity(self) -> Array:
        """(3,) world, m/s."""
        ...

    @property
    def trunk_angular_velocity(self) -> Array:
        """(3,) trunk frame, rad/s."""
        ...

    @property
    def roll_pitch_yaw(self) -> Array:
        """(3,) rad."""
        ...

    def height_over_ground(self) -> float:
        """Return how far the trunk's origin is above what collides under it, m; inf = nothing."""
        ...

    @property
    def uprightness(self) -> float:
        """Cosine of the angle between the trunk's z axis and the world's."""
        ...

    @property
    def foot_contacts(self) -> NDArray[np.bool_]:
        """Whether each foot is in contact, in the order of `robot.feet`."""
        ...

    @property
    def joint_positions(self) -> Array:
        """(J,) rad, in the order of `robot.joints`."""
        ...

    def body_poses(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """Return where bodies of the robot are: (B, 3) m, and (B, 4) quaternions w x y z; world."""
        ...

    def monitored_force(self) -> float:
        """Return the largest contact force on any monitored geom, N."""
        ...

    def monitored_forces(self) -> dict[str, float]:
        """Return the contact force on each monitored geom by name, N."""
        ...


class StartPose(NamedTuple):
    """A robot in motion, as a trial begins; world frame but for the rates."""

    position: Array  # (3,) of the root, m
    quat: Array  # (4,) of it, w x y z
    velocity: Array  # (3,) of its origin, m/s
    rates: Array  # (3,) in its own frame, rad/s
    joint_positions: Array  # (J,) rad
    joint_velocities: Array  # (J,) rad/s


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Where a trial begins, and what is to be reached from there; world frame.

    Attributes:
        x: of the robot at the start, m.
        y: of the robot at the start, m.
        yaw: its heading, rad.
        waypoints: (K, 3) m, in order; those that a viewer draws, and a camera shows as cones. None
            where the task has none.
        pose: how the robot moves at the start; None = it stands in its default pose.
    """

    x: float
    y: float
    yaw: float
    waypoints: Array = field(default_factory=lambda: _NO_WAYPOINTS)
    pose: StartPose | None = None


class TaskEvent(NamedTuple):
    """Something that happened to the task in a control step, for the log."""

    kind: Literal["waypoint", "task"]
    text: str
    number: int = -1
    """Of the waypoint, from 0; -1 = none."""


class TaskFault(NamedTuple):
    """Why a suite's task cannot be run with its policy or its episode."""

    location: tuple[str | int, ...]
    """Keys below `task`."""
    message: str
    fix: str


class Task(Protocol):
    """One trial's task; a `Memory` of what it has seen, by the names that its parts have in a log.

    `reset` is called once, before the first control step, and `update` after each one.

    Attributes:
        kind: the name of the kind.
        settings: the class of its settings.
        declared: the scores of its own, which `scores` returns.
        goal: what `reset` has returned.
    """

    kind: ClassVar[str]
    settings: ClassVar[type[TaskSettings]]
    declared: ClassVar[tuple[ScoreSpec, ...]] = ()
    goal: Goal

    @classmethod
    def fault(
        cls, settings: TaskSettings, *, hears: frozenset[str], rules: TaskRules
    ) -> TaskFault | None:
        """Return why a suite cannot run the task, before anything runs; None where it can.

        Args:
            settings: of the suite.
            hears: what tells the policy what to do, by its card: `command`, a velocity; `speed`, a
                forward speed; `vy`, `yaw`, these parts; `way`, the direction to a waypoint;
                `motion`, one of its own.
            rules: of the suite's trials.
        """
        del settings, hears, rules
        return None

    def reset(self, streams: Streams, scene: Place, robot: TaskRobot) -> Goal:
        """Draw a trial, and return where it begins.

        Args:
            streams: the trial's randomness.
            scene: where.
            robot: which robot.
        """
        ...

    def update(self, readings: Readings) -> tuple[TaskEvent, ...]:
        """Take what a control step came to; return what happened in it."""
        ...

    def end(self) -> Outcome | None:
        """Return how the trial ends after the control step of the last `update`, or None."""
        ...

    @property
    def end_reason(self) -> str:
        """What decided how it ended: the angle, the geom, the clock; empty before."""
        ...

    @property
    def reached(self) -> int:
        """How many parts of the task are done, such as waypoints."""
        return 0

    @property
    def total(self) -> int:
        """Of how many; 0 where the task has no parts."""
        return 0

    @property
    def times(self) -> tuple[float, ...]:
        """When each part was done, s since the reset."""
        return ()

    @property
    def contact_seconds(self) -> float:
        """Simulated time so far in collision, s."""
        return 0.0

    @property
    def success(self) -> float:
        """Score of the trial so far, 0 to 1; 1 is a completed trial, and nothing else is."""
        return self.reached / self.total if self.total else 0.0

    @property
    def target(self) -> Array | None:
        """The point to go to, (3,) world, m; None where the task names none."""
        return None

    @property
    def command(self) -> Velocity | None:
        """The velocity that the task asks for now; None leaves it to the policy's card."""
        return None

    @property
    def targets(self) -> Mapping[str, float]:
        """What the task asks for now beside a velocity, by name: rad of joints, m of a height."""
        return {}

    @property
    def joint_offsets(self) -> Array | None:
        """How far angles of joints at action 0 are from the card's now, (J,) rad; None = not."""
        return None

    @property
    def reference(self) -> PlacedReference | None:
        """The motion that is to be tracked, where it lies in the trial; None = there is none."""
        return None

    @property
    def force(self) -> Array | None:
        """The force on the robot's root in the next control step, (3,) N, world; None = none.

        It acts on the centre of mass of that body, throughout the step.
        """
        return None

    @property
    def standing(self) -> str:
        """How far it is, in words."""
        return f"{self.reached} of {plural(self.total, 'waypoint')}"

    def scores(self) -> dict[str, float]:
        """Return the scores that it declares, by name; those that are undefined are left out."""
        return {}

    def state(self) -> dict[str, bytes]:
        """Return what the rest of the trial depends on, by part; keys are names in the log."""
        ...

    def restore(self, state: Mapping[str, bytes]) -> None:
        """Go back, or on, to a `state` of the same trial; other parts in it are ignored.

        Raises:
            KeyError, TypeError, ValueError: it is damaged, or of another kind of task.
        """
        ...


class TimedTask(Task):
    """A task without parts: it ends by rules of its own, or when its time is over.

    Args:
        rules: of the suite's trials.

    Attributes:
        step: control steps done.
        steps: of the whole trial.
    """

    def __init__(self, rules: TaskRules | None = None) -> None:
        self._rules = TaskRules() if rules is None else rules
        self.steps = 1
        self._begin_anew()

    def _begin_anew(self) -> None:
        self.step, self._contact_steps = 0, 0
        self._ended: Outcome | None = None
        self._reason = ""

    def end(self) -> Outcome | None:
        """Return how the trial ends, or None."""
        return self._ended

    @property
    def end_reason(self) -> str:
        """Say what decided the outcome."""
        return self._reason

    @property
    def success(self) -> float:
        """1 of a completed trial, else 0."""
        return float(self._ended == "completed")

    @property
    def contact_seconds(self) -> float:
        """Simulated time so far during which a monitored part collided, s."""
        return self._contact_steps * self._rules.control_period
