"""What a task asks for beside a velocity: angles of joints, a height, whatever a policy reads.

A policy that drives the legs of a humanoid walks whatever its arms do, and at the height that it is
told. `control.commanded` of its card says which joints a task may move; terms `target` say which
other names the policy reads. Values are drawn from the trial's own seed and known before it begins.
"""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Annotated, NamedTuple, Self

import numpy as np
from pydantic import Field, Strict, model_validator

from nw_base.errors import nearest
from nw_sim.tasks.task import Array, Streams, TaskFault, TaskPart

HEIGHT = "height"
"""The name of the trunk's height over the ground, m, which a task can measure."""

_TINY = 1e-9  # s: times of control steps are sums
_Value = Annotated[float, Field(ge=-1e6, le=1e6)]
_Asked = _Value | Annotated[tuple[_Value, _Value], Strict(False)]


class Targets(TaskPart):
    """Values by name, anew every few seconds: `{of: {height: [0.6, 0.75]}, every: 4, over: 1}`."""

    of: Annotated[dict[str, _Asked], Field(min_length=1, max_length=200)]
    """A number, or a range that is drawn from uniformly; joints by name, type or pattern."""
    every: float = Field(default=4.0, ge=0.1, le=600.0)
    """s until the next values."""
    over: float = Field(default=1.0, ge=0.0, le=600.0)
    """s in which a value changes linearly to the next one."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for name, asked in self.of.items():
            low, high = _range(asked)
            if low > high:
                raise ValueError(
                    f"{name} {low:g} to {high:g} is not a range; write the smaller one first"
                )
        if self.over > self.every:
            raise ValueError(f"over, {self.over:g} s, is more than every, {self.every:g} s")
        return self


class OwnTarget(NamedTuple):
    """What a policy's card has where no task asks for anything, and what may be asked for."""

    value: float
    low: float
    high: float
    joint: int | None
    """Its index in the robot's order; None = no joint."""
    is_moved: bool
    """Whether the task moves the joint; else the policy reads the angle and moves it."""


def targets_fault(
    targets: Targets, own: Mapping[str, OwnTarget], *, measured: bool = False
) -> TaskFault | None:
    """Return why a policy cannot be asked for targets.

    Args:
        targets: of the suite.
        own: of the policy.
        measured: whether the angles of joints are compared with the targets.
    """
    for key, asked in targets.of.items():
        names = _named(key, own)
        if not names:
            return TaskFault(
                ("targets", "of", key),
                f"the policy holds no joint {key!r}, and no term `target` of its card reads it",
                nearest(key, list(own))
                if own
                else "add a term `target` to the card, or hold joints with `control.held`",
            )
        for name in names:
            low, high = own[name].low, own[name].high
            if _range(asked)[0] < low or _range(asked)[1] > high:
                return TaskFault(
                    ("targets", "of", key),
                    f"{name} turns from {low:.3g} to {high:.3g} rad",
                    "ask for angles within that",
                )
    joints = [name for name in _values_of(targets, own) if own[name].joint is not None]
    if measured and not joints:
        return TaskFault(
            ("within", "joints"),
            "the targets name no joint of the robot",
            "remove it, or ask for angles of joints",
        )
    return None


class DrawnTargets:
    """What a trial is asked for over time.

    Args:
        targets: of the suite.
        own: of the policy; nothing of it is a fault.
        streams: of the trial.
        seconds: that it lasts at most.
        joints: how many the robot has.

    Attributes:
        names: what is asked for, each once.
        is_joint: (N,) whether each is an angle of a joint.
        is_moved: (N,) whether the task moves it.
    """

    def __init__(
        self,
        targets: Targets,
        own: Mapping[str, OwnTarget],
        streams: Streams,
        *,
        seconds: float,
        joints: int,
    ) -> None:
        asked = _values_of(targets, own)
        self.names = tuple(asked)
        self._every, self._over, self._joints = targets.every, targets.over, joints
        self._own = np.array([own[name].value for name in asked])
        places = [own[name].joint for name in asked]
        self.is_joint = np.array([place is not None for place in places], dtype=bool)
        self.is_moved = np.array([own[name].is_moved for name in asked], dtype=bool)
        self._places = np.array([place for place in places if place is not None], dtype=np.intp)
        self._moves = np.array([own[n].joint for n in asked if own[n].is_moved], dtype=np.intp)
        low, high = np.array(list(asked.values())).reshape(-1, 2).T
        # A row for each time: a longer trial begins as a shorter one. A stream for each name: what
        # else another policy can be asked for changes nothing, should it take over.
        count = int((seconds + _TINY) / targets.every) + 1
        drawn = [streams.generator(f"targets {name}").random(count) for name in asked]
        self._drawn = low + np.array(drawn).reshape(-1, count).T * (high - low)

    def at(self, seconds: float) -> Array:
        """Return what is asked for at a time since the start, (N,)."""
        number = min(int((seconds + _TINY) / self._every), len(self._drawn) - 1)
        since = max(seconds - number * self._every, 0.0)
        if since >= self._over:
            return self._drawn[number]
        before = self._own if number == 0 else self._drawn[number - 1]
        return before + since / self._over * (self._drawn[number] - before)

    def offsets(self, values: Array) -> Array:
        """Return how far joints' angles at action 0 are from the card's, (J,) rad.

        Args:
            values: from `at`.
        """
        result = np.zeros(self._joints)
        result[self._moves] = (values - self._own)[self.is_moved]
        return result

    def off(self, values: Array, positions: Array) -> float:
        """Return the mean absolute error of the joints that are asked for, rad; 0 without any.

        Args:
            values: from `at`.
            positions: (J,) rad.
        """
        if not len(self._places):
            return 0.0
        errors = np.abs(positions[self._places] - values[self.is_joint])
        return float(errors.sum()) / len(self._places)


def _range(asked: float | tuple[float, float]) -> tuple[float, float]:
    return asked if isinstance(asked, tuple) else (asked, asked)


def _values_of(targets: Targets, own: Mapping[str, OwnTarget]) -> dict[str, tuple[float, float]]:
    """Return the range of each name: where several keys mean it, that of the most exact one."""
    rank = {key: 2 if key.removesuffix("_joint") in own else _is_pattern(key) for key in targets.of}
    asked: dict[str, tuple[float, float]] = {}
    for key in sorted(targets.of, key=lambda each: rank[each]):
        asked |= dict.fromkeys(_named(key, own), _range(targets.of[key]))
    return asked


def _is_pattern(key: str) -> bool:
    return any(sign in key for sign in "*?[")


def _named(key: str, own: Mapping[str, OwnTarget]) -> list[str]:
    """Return the names that a key means: a name; of joints, a type or a pattern, as on a card."""
    name = key.removesuffix("_joint")
    if name in own:
        return [name]
    joints = [each for each in own if own[each].joint is not None]
    return [each for each in joints if each.endswith(f"_{name}") or fnmatchcase(each, name)]
