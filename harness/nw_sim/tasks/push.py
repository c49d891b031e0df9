"""The task `push`: stand or walk, and stay on one's feet where somebody pushes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, Strict, model_validator

from nw_base.words import Outcome
from nw_gate.scores.score import lower_better
from nw_sim.tasks.commanded import (
    STAND,
    Command,
    Commanded,
    CommandedSettings,
    Range,
    check_order,
    off_command,
)
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
    Velocity,
)

WINDOW = 0.2
"""s over which the velocity error is averaged: less than a stride, so that it shows a stumble."""
_STRONGEST = 10_000.0  # N s
Size = Annotated[float, Field(gt=0.0, le=_STRONGEST)]
Angle = Annotated[float, Field(ge=-2.0 * math.pi, le=2.0 * math.pi)]


class Impulse(TaskPart):
    """One push."""

    at: float = Field(ge=0.0, le=600.0)
    """s since the start, when it begins."""
    size: Size
    """N s."""
    direction: Angle = 0.0
    """Into which it pushes, rad to the left of the robot's heading when it begins."""


class DrawnImpulses(TaskPart):
    """Pushes that are drawn for each trial, from its own seed."""

    size: Annotated[tuple[Size, Size], Strict(False)]
    """N s, uniformly."""
    direction: Annotated[tuple[Angle, Angle], Strict(False)] = (-math.pi, math.pi)
    """rad, uniformly."""
    at: Range = (2.0, 3.0)
    """s, uniformly: when the first one begins."""
    every: float = Field(default=4.0, ge=0.1, le=600.0)
    """s from the beginning of one to that of the next."""
    count: int = Field(default=1, ge=1, le=100)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for name in ("size", "direction", "at"):
            check_order(name, getattr(self, name))
        if self.at[0] < 0.0:
            raise ValueError(f"at {self.at[0]:g} s is before the start; give 0 or more")
        return self


class Recovered(TaskPart):
    """When a robot has recovered: all of this holds for a while."""

    tilt: float = Field(default=0.3, gt=0.0, le=1.5)
    """Largest roll and pitch, rad."""
    speed: float = Field(default=0.3, gt=0.0, le=5.0)
    """Largest distance of the velocity in the ground plane, averaged over 0.2 s, from the command,
    m/s."""
    hold: float = Field(default=0.5, gt=0.0, le=60.0)
    """s."""


class PushSettings(CommandedSettings):
    """`task: {kind: push, impulses: ...}` or with `draw`."""

    kind: Literal["push"] = "push"
    command: Command = STAND
    impulses: Annotated[tuple[Impulse, ...], Strict(False), Field(min_length=1)] | None = None
    draw: DrawnImpulses | None = None
    lasts: float = Field(default=0.1, ge=0.02, le=10.0)
    """s that each push takes; its force is the same throughout."""
    recovered: Recovered = Recovered()

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.impulses is None) == (self.draw is None):
            said = "nothing pushes" if self.draw is None else "impulses and draw exclude each other"
            raise ValueError(f"{said}; give impulses or draw")
        times = [each.at for each in self.impulses or ()]
        if any(later - before < self.lasts for before, later in pairwise(times)):
            raise ValueError(
                f"an impulse begins less than the {self.lasts:g} s that each lasts after the one "
                "before; put them in the order of their times and farther apart"
            )
        if self.draw is not None and self.draw.every < self.lasts:
            raise ValueError(f"draw.every is under lasts, {self.lasts:g} s; raise it")
        return self

    @property
    def last_at(self) -> float:
        """When the last push begins at the latest, s."""
        if self.draw is not None:
            return self.draw.at[1] + (self.draw.count - 1) * self.draw.every
        return max(each.at for each in self.impulses or ())


class _Push(NamedTuple):
    begins: int  # control step
    size: float  # N s
    direction: float  # rad, from the heading


class PushTask(Commanded):
    """Stand, or walk at a command, while pushes act on the root.

    A push of J N s is a level force of J / `lasts` on the centre of mass of the robot's root for
    `lasts` s. The robot has recovered from it at the first control step from which on `recovered`
    holds. A trial is completed if the robot recovered from all pushes, each before the next one,
    and ran to its end.
    """

    kind = "push"
    settings = PushSettings
    declared = (
        lower_better(
            "recovery_time",
            "s",
            5.0,
            "mean time from the beginning of a push until the robot had recovered",
        ),
    )

    def __init__(self, settings: PushSettings, rules: TaskRules | None = None) -> None:
        super().__init__(settings, rules)
        period = self._rules.control_period
        self._settings = settings
        self._lasts = max(1, round(settings.lasts / period))
        self._hold = max(1, round(settings.recovered.hold / period))
        self._pushes: tuple[_Push, ...] = ()
        self._errors = np.zeros((max(1, round(WINDOW / period)), 2))
        self._angle = 0.0  # of the newest push in the world, rad
        self._begun = 0
        self._steady = 0  # control steps in a row
        self._times: tuple[float, ...] = ()

    @classmethod
    def fault(
        cls, settings: TaskSettings, *, hears: frozenset[str], rules: TaskRules
    ) -> TaskFault | None:
        """Return as `Commanded` does, or that a push comes too late to be recovered from."""
        assert isinstance(settings, PushSettings)
        ends = settings.last_at + settings.lasts + settings.recovered.hold
        if ends > rules.duration:
            where: tuple[str | int, ...] = ("draw",)
            if settings.impulses is not None:
                where = ("impulses", len(settings.impulses) - 1, "at")
            return TaskFault(
                where,
                f"the last push may begin at {settings.last_at:g} s, and recovery from it would "
                f"end at {ends:g} s at the earliest, after the trial of {rules.duration:g} s",
                "let it begin earlier, or raise episode.duration",
            )
        return super().fault(settings, hears=hears, rules=rules)

    def reset(self, streams: Streams, scene: Place, robot: TaskRobot) -> Goal:
        """Draw start, command and pushes."""
        goal = super().reset(streams, scene, robot)
        period, draw = self._rules.control_period, self._settings.draw
        pushes = [(each.at, each.size, each.direction) for each in self._settings.impulses or ()]
        if draw is not None:
            generator = streams.generator("impulses")
            first = draw.at[0] + generator.random() * (draw.at[1] - draw.at[0])
            for number, (size, angle) in enumerate(generator.random((draw.count, 2)).tolist()):
                pushes.append(
                    (
                        first + number * draw.every,
                        draw.size[0] + size * (draw.size[1] - draw.size[0]),
                        draw.direction[0] + angle * (draw.direction[1] - draw.direction[0]),
                    )
                )
        self._pushes = tuple(_Push(round(at / period), *push) for at, *push in pushes)
        self._begun, self._steady, self._times = 0, 0, ()
        self._errors[:] = 0.0
        self._begin(goal.yaw)
        return goal

    @property
    def force(self) -> Array | None:
        """The push of the next control step, (3,) N, world; None between pushes."""
        if not self._begun:
            return None
        push = self._pushes[self._begun - 1]
        if self.step >= push.begins + self._lasts:
            return None
        newtons = push.size / (self._lasts * self._rules.control_period)
        return newtons * np.array([math.cos(self._angle), math.sin(self._angle), 0.0])

    @property
    def recovery_times(self) -> tuple[float, ...]:
        """Time from the beginning of each push to recovery, s, of those that it recovered from."""
        return self._times

    def _begin(self, heading: float) -> TaskEvent | None:
        """Begin the push that is due at the next control step, if one is."""
        if self._begun == len(self._pushes) or self._pushes[self._begun].begins != self.step:
            return None
        push = self._pushes[self._begun]
        self._angle = heading + push.direction
        self._begun += 1
        self._steady = 0
        return TaskEvent(
            "task",
            f"push {self._begun} of {len(self._pushes)}: {push.size:.1f} N s, "
            f"{math.degrees(push.direction):+.0f} degrees from the heading",
        )

    def _see(self, readings: Readings, asked: Velocity) -> tuple[TaskEvent, ...]:
        self._errors[(self.step - 1) % len(self._errors)] = off_command(readings, asked)[:2]
        x, y = (self._errors.sum(axis=0) / len(self._errors)).tolist()
        roll, pitch, yaw = readings.roll_pitch_yaw.tolist()
        limits, events = self._settings.recovered, list[TaskEvent]()
        is_steady = max(abs(roll), abs(pitch)) <= limits.tilt and math.hypot(x, y) <= limits.speed
        self._steady = self._steady + 1 if is_steady else 0
        # Not where it has not recovered from the push before.
        if len(self._times) == self._begun - 1 and self._steady == self._hold:
            begins = self._pushes[self._begun - 1].begins
            took = (self.step - self._hold - begins) * self._rules.control_period
            self._times = (*self._times, took)
            events.append(TaskEvent("task", f"recovered after {took:.2f} s"))
        if (begun := self._begin(yaw)) is not None:
            events.append(begun)
        return tuple(events)

    def _judge(self) -> tuple[Outcome, str]:
        if len(self._times) == len(self._pushes):
            return "completed", "recovered"
        return "timeout", "not recovered"

    @property
    def standing(self) -> str:
        """What is commanded, and how many pushes it has recovered from."""
        done = f"recovered from {len(self._times)} of {len(self._pushes)} pushes"
        return f"{super().standing}, {done}"

    def scores(self) -> dict[str, float]:
        """Return the mean recovery time; none of a trial that did not recover from all pushes."""
        if self._ended != "completed":
            return {}
        return {"recovery_time": sum(self._times) / len(self._times)}

    def _memory(self) -> dict[str, Array]:
        counts = np.array([float(self._begun), float(self._steady), self._angle])
        return {"pushes": counts, "errors": self._errors, "times": np.array(self._times)}

    def _remember(self, arrays: Mapping[str, Any]) -> None:
        begun, steady, self._angle = arrays["pushes"].tolist()
        self._begun, self._steady = int(begun), int(steady)
        self._errors[:] = arrays["errors"]
        self._times = tuple(arrays["times"].tolist())
