"""Tasks without waypoints: what they share. `velocity` has two of them, `push` the third.

A command is known before its trial begins: it follows from the suite and from the trial's own seed,
so a trial that is continued from its middle is told the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    Strict,
    model_serializer,
    model_validator,
)

from nw_base.errors import UsageError
from nw_base.memory import pack, unpack
from nw_base.words import Outcome
from nw_sim.tasks.course import Limits, draw_start, fallen_by, touched_by
from nw_sim.tasks.targets import DrawnTargets, Targets, targets_fault
from nw_sim.tasks.task import (
    Array,
    Goal,
    Place,
    Readings,
    Streams,
    TaskEvent,
    TaskFault,
    TaskPart,
    TaskRobot,
    TaskRules,
    TaskSettings,
    TimedTask,
    Velocity,
)

_FASTEST, _TURNING = 5.0, 10.0  # m/s and rad/s, of commands
_LONGEST = 600.0  # s, as trials are at most
_STILL: Velocity = (0.0, 0.0, 0.0)
_PARTS = ("vx", "vy", "yaw")
_OTHER_WAYS = {
    "speed": ", its speed is the forward one",
    "way": ", it turns towards waypoints",
}
_TINY = 1e-9  # s: times of control steps are sums

Range = Annotated[tuple[float, float], Strict(False)]
"""Two numbers; a list is one, too."""
Speed = Annotated[float, Field(ge=-_FASTEST, le=_FASTEST)]
TurnRate = Annotated[float, Field(ge=-_TURNING, le=_TURNING)]
SpeedRange = Annotated[tuple[Speed, Speed], Strict(False)]
TurnRange = Annotated[tuple[TurnRate, TurnRate], Strict(False)]


class Asked(TaskPart):
    """A velocity in the yaw frame."""

    vx: Speed = 0.0
    """Forward, m/s."""
    vy: Speed = 0.0
    """To the left, m/s."""
    yaw: TurnRate = 0.0
    """Yaw rate, rad/s to the left."""

    @property
    def velocity(self) -> Velocity:
        """All three."""
        return self.vx, self.vy, self.yaw


class AskedFrom(Asked):
    """A velocity from a time on."""

    at: float = Field(ge=0.0, le=_LONGEST)
    """s since the start."""


class Sweep(TaskPart):
    """Velocities that change linearly from the first number to the second, and stay there."""

    vx: SpeedRange = (0.0, 0.0)
    vy: SpeedRange = (0.0, 0.0)
    yaw: TurnRange = (0.0, 0.0)
    over: float = Field(gt=0.0, le=_LONGEST)
    """s that the change takes, from the start of the trial."""


class Draw(TaskPart):
    """Velocities that are drawn uniformly for each trial, from its own seed."""

    vx: SpeedRange = (0.0, 0.0)
    vy: SpeedRange = (0.0, 0.0)
    yaw: TurnRange = (0.0, 0.0)
    every: float = Field(default=4.0, ge=0.1, le=_LONGEST)
    """s until the next one is drawn."""
    still: float = Field(default=0.0, ge=0.0, le=1.0)
    """Probability of a draw to command zero."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for name in _PARTS:
            check_order(name, getattr(self, name))
        return self


def check_order(name: str, given: tuple[float, float]) -> None:
    """Refuse a range whose ends are in the wrong order.

    Raises:
        ValueError: they are.
    """
    low, high = given
    if low > high:
        raise ValueError(f"{name} {low:g} to {high:g} is not a range; write the smaller one first")


class Command(TaskPart):
    """The velocities that a trial commands, said in one of four ways."""

    constant: Asked | None = None
    steps: Annotated[tuple[AskedFrom, ...], Strict(False), Field(min_length=1)] | None = None
    """Each from its time on; zero before the first."""
    sweep: Sweep | None = None
    draw: Draw | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = [name for name in ("constant", "steps", "sweep", "draw") if getattr(self, name)]
        if len(ways) != 1:
            said = "it is empty" if not ways else f"{' and '.join(ways)} exclude each other"
            raise ValueError(f"{said}; give constant, steps, sweep or draw")
        times = [step.at for step in self.steps or ()]
        if any(later <= before for before, later in pairwise(times)):
            raise ValueError("steps are not in the order of their times; sort them by `at`")
        return self

    @model_serializer(mode="wrap")
    def _without_other_ways(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value is not None}

    def profile(self, streams: Streams, *, steps: int, period: float) -> Array:
        """Return what is commanded in each control step of a trial, (steps, 3) m/s, m/s, rad/s.

        Args:
            streams: the trial's, of which `command` is drawn from.
            steps: control steps of the trial.
            period: seconds of one.
        """
        times = np.arange(steps) * period
        velocities = np.zeros((steps, 3))
        if self.constant is not None:
            velocities[:] = self.constant.velocity
        for step in self.steps or ():
            velocities[times >= step.at - _TINY] = step.velocity
        if (sweep := self.sweep) is not None:
            ends = np.array([sweep.vx, sweep.vy, sweep.yaw])
            share = np.minimum(times / sweep.over, 1.0)[:, np.newaxis]
            velocities[:] = ends[:, 0] + share * (ends[:, 1] - ends[:, 0])
        if (draw := self.draw) is not None:
            low, high = np.array([draw.vx, draw.vy, draw.yaw]).T
            numbers = np.floor((times + _TINY) / draw.every).astype(np.int64)
            # Four numbers a draw: a longer trial begins as a shorter one.
            drawn = streams.generator("command").random((int(numbers[-1]) + 1, 4))
            values = low + drawn[:, :3] * (high - low)
            values[drawn[:, 3] < draw.still] = 0.0
            velocities[:] = values[numbers]
        return velocities

    @property
    def parts(self) -> frozenset[str]:
        """Which of `vx`, `vy` and `yaw` it may command to be other than zero."""
        asked: list[Any] = [self.constant, *(self.steps or ()), self.sweep, self.draw]
        return frozenset(
            name
            for each in asked
            if each is not None
            for name in _PARTS
            if np.any(np.array(getattr(each, name)) != 0.0)
        )


STAND = Command(constant=Asked())
"""Zero at all times."""


def is_commanded(settings: TaskSettings) -> bool:
    """Whether a suite states the velocity command of its task."""
    return "command" in type(settings).model_fields


def with_command(settings: TaskSettings, parts: Mapping[str, float]) -> TaskSettings:
    """Return settings that command a constant velocity.

    Args:
        settings: of a task that `is_commanded`; of any other one where `parts` is empty.
        parts: `vx`, `vy`, `yaw`, m/s and rad/s. What is not among them keeps the value of
            `command.constant`, and is zero if the command is not constant. Without any, the
            command is left as it is.

    Raises:
        UsageError: the task has no command.

    Example:
        >>> from nw_sim.tasks.commanded import Command, with_command
        >>> from nw_sim.tasks.velocity import VelocitySettings
        >>> settings = VelocitySettings(command=Command(constant={"vx": 0.5}))
        >>> with_command(settings, {"yaw": 0.2}).command.constant.velocity
        (0.5, 0.0, 0.2)
    """
    if not parts:
        return settings
    if not is_commanded(settings):
        raise UsageError(
            f"task {settings.kind} has no velocity command that an axis could change",
            fix="use task: velocity",
        )
    own = getattr(settings, "command", STAND).constant or Asked()
    asked = Asked.model_validate({**own.model_dump(), **parts})
    return settings.model_copy(update={"command": Command(constant=asked)})


class CommandedSettings(TaskSettings):
    """Keys that all tasks of this file's kind have."""

    area: float | None = Field(default=None, gt=0.0, le=1000.0)
    """m in the ground plane from the start, beyond which a trial ends as `off_course`; None = no
    limit but the ground itself."""
    targets: Targets | None = None
    """What is asked for beside the velocity."""

    @model_serializer(mode="wrap")
    def _without_none(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value is not None}


class Commanded(TimedTask):
    """A trial whose task is a commanded velocity, and no way.

    It ends as `fell` or `collided` by the robot's limits, as `off_course` where the robot leaves
    the ground or the suite's `area`, and else when its time is over: then `_judge` says how.

    Args:
        settings: of the kind.
        rules: of the suite's trials.

    Attributes:
        asked: the command.
    """

    def __init__(self, settings: CommandedSettings, rules: TaskRules | None = None) -> None:
        super().__init__(rules)
        self._area = math.inf if settings.area is None else settings.area
        self._limits = Limits()
        self.asked = self.asked_by(settings)
        self.steps = max(1, round(self._rules.duration / self._rules.control_period))
        self._profile: Array = np.zeros((self.steps, 3))
        self._wanted = settings.targets
        self._drawn: DrawnTargets | None = None
        self._values: tuple[int, Array] = (-1, np.zeros(0))  # A step, and what is asked for then

    @classmethod
    def asked_by(cls, settings: CommandedSettings) -> Command:
        """Return the command of settings."""
        return getattr(settings, "command", STAND)

    @classmethod
    def fault(
        cls, settings: TaskSettings, *, hears: frozenset[str], rules: TaskRules
    ) -> TaskFault | None:
        """Return why a policy cannot be asked for this, or why the trial is too short."""
        assert isinstance(settings, CommandedSettings)
        asked = cls.asked_by(settings)
        for number, step in enumerate(asked.steps or ()):
            if step.at >= rules.duration:
                return TaskFault(
                    ("command", "steps", number, "at"),
                    f"a step at {step.at:g} s is not within the trial of {rules.duration:g} s",
                    "lower it, or raise episode.duration",
                )
        if settings.targets is not None and rules.own is not None:
            within = getattr(settings, "within", None)
            measured = getattr(within, "joints", None) is not None
            fault = targets_fault(settings.targets, rules.own, measured=measured)
            if fault is not None:
                return fault
        parts = asked.parts
        unheard = (parts - {"vx"} if "speed" in hears else parts) - hears
        if unheard and "command" not in hears:
            text = "".join(_OTHER_WAYS[way] for way in ("speed", "way") if way in hears)
            return TaskFault(
                ("command",),
                f"the policy does not observe {' and '.join(sorted(unheard, key=_PARTS.index))}: "
                f"its card has no term `command`{text}",
                f"give {cls.kind} a policy that follows velocity commands, or give only commands "
                "that this one observes",
            )
        if not parts and "way" in hears and len(hears) == 1:
            return TaskFault(
                ("kind",),
                "nothing tells the policy to stand still: its card has neither a term `command` "
                "nor `speed`, and it walks towards waypoints",
                f"give {cls.kind} a policy with one of them, or use task: course",
            )
        return None

    def reset(self, streams: Streams, scene: Place, robot: TaskRobot) -> Goal:
        """Draw start and command."""
        self._limits = Limits.of(robot)
        spawn = scene.spawn
        self.goal = draw_start(
            streams,
            protocol=self._rules.protocol,
            spawn=(*spawn.position[:2], spawn.yaw),
            jitter=(spawn.x_jitter, spawn.y_jitter, spawn.yaw_jitter),
            trail=np.zeros((0, 3)),
            waypoint_noise=(0.0, 0.0),
        )
        period = self._rules.control_period
        self._profile = self.asked.profile(streams, steps=self.steps, period=period)
        if self._wanted is not None:
            self._drawn = DrawnTargets(
                self._wanted,
                self._rules.own or {},
                streams,
                seconds=self._rules.duration,
                joints=len(robot.joints),
            )
        self._begin_anew()
        return self.goal

    def update(self, readings: Readings) -> tuple[TaskEvent, ...]:
        """Look at the control step, and whether the trial is over."""
        followed = self.commanded(self.step)
        self.step += 1
        events = self._see(readings, followed)
        self._ended, self._reason = self._end(readings)
        return events

    def commanded(self, step: int) -> Velocity:
        """Return what is commanded in a control step, from 0; the last one's after the end."""
        vx, vy, yaw = self._profile[min(step, self.steps - 1)].tolist()
        return vx, vy, yaw

    @property
    def command(self) -> Velocity:
        """The velocity that is commanded now."""
        return self.commanded(self.step)

    @property
    def targets(self) -> Mapping[str, float]:
        """What is asked for now beside the velocity, by name."""
        if self._drawn is None:
            return {}
        return dict(zip(self._drawn.names, self._asked_at(self.step).tolist(), strict=True))

    @property
    def joint_offsets(self) -> Array | None:
        """How far angles of joints at action 0 are from the card's now, (J,) rad."""
        return None if self._drawn is None else self._drawn.offsets(self._asked_at(self.step))

    def _asked_at(self, step: int) -> Array:
        """Return what is asked for in a control step, in the order of the drawn names."""
        assert self._drawn is not None
        if self._values[0] != step:
            self._values = step, self._drawn.at(step * self._rules.control_period)
        return self._values[1]

    @property
    def standing(self) -> str:
        """What is commanded now, in words."""
        vx, vy, yaw = self.command
        if self.command == _STILL:
            return "commanded to stand"
        return f"commanded {vx:+.2f} {vy:+.2f} m/s, {yaw:+.2f} rad/s"

    def state(self) -> dict[str, bytes]:
        """Return what it counts."""
        counts = np.array([self.step, self._contact_steps], dtype=np.int64)
        return {"commanded": pack({"counts": counts, **self._memory()})}

    def restore(self, state: Mapping[str, bytes]) -> None:
        """Go back, or on, to a `state`."""
        arrays = unpack(state["commanded"])
        self.step, self._contact_steps = arrays["counts"].tolist()
        self._remember(arrays)

    def _end(self, readings: Readings) -> tuple[Outcome | None, str]:
        limits = self._limits
        has_collided = readings.monitored_force() > limits.monitored_force
        self._contact_steps += has_collided
        if limits.have_fallen(readings):
            return "fell", fallen_by(readings, limits)
        if has_collided and self._rules.contact_termination:
            return "collided", touched_by(readings)
        if (left := self._left(readings)) is not None:
            return "off_course", left
        return self._judge() if self.step >= self.steps else (None, "")

    def _left(self, readings: Readings) -> str | None:
        """Return which bound the robot has left; None where it is within all of them."""
        x, y, z = readings.trunk_position.tolist()
        if z < readings.scene.ground.z - self._limits.below_ground:
            return "below the ground"
        if math.hypot(x - self.goal.x, y - self.goal.y) > self._area:
            return "out of the area"
        return "no ground" if readings.height_over_ground() == math.inf else None

    def _see(self, readings: Readings, asked: Velocity) -> tuple[TaskEvent, ...]:
        """Take what a control step came to, in which `asked` was commanded."""
        raise NotImplementedError

    def _judge(self) -> tuple[Outcome, str]:
        """Return how a trial ends whose time is over: `completed` or `timeout`, and why."""
        raise NotImplementedError

    def _memory(self) -> dict[str, Array]:
        """Return what the kind remembers beside the counts."""
        raise NotImplementedError

    def _remember(self, arrays: Mapping[str, Any]) -> None:
        """Go back to a `_memory`."""
        raise NotImplementedError


def off_command(readings: Readings, asked: Velocity) -> Velocity:
    """Return a commanded velocity minus that of the trunk: m/s, m/s in the yaw frame, rad/s.

    The yaw rate is about the trunk's z axis, as policies are trained by.
    """
    yaw = float(readings.roll_pitch_yaw[2])
    x, y, _ = readings.trunk_linear_velocity.tolist()
    cosine, sine = math.cos(yaw), math.sin(yaw)
    rate = float(readings.trunk_angular_velocity[2])
    return (
        asked[0] - (cosine * x + sine * y),
        asked[1] - (cosine * y - sine * x),
        asked[2] - rate,
    )


WINDOW = 0.5
"""s over which a velocity error is averaged: about a stride, within which a trunk sways."""
