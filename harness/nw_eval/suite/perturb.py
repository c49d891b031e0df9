"""What a suite may change about robot, place and senses, to see how much a policy bears.

An axis of a sweep is written `friction=0.3..1.2`, `payload=0..6:4`, `push=0,0.5,1`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from nw_eval.errors import UsageError, nearest
from nw_eval.plural import plural

CONTROL_STEP = 0.02
"""Seconds between two looks at the robot, which latencies are whole numbers of."""

NEUTRAL: Mapping[str, float | None] = MappingProxyType(
    {
        "friction": None,
        "payload": 0.0,
        "push": 0.0,
        "strength": 1.0,
        "latency": 0.0,
        "noise": 0.0,
        "exposure": 1.0,
        "fog": 0.0,
        "camera_pitch": 0.0,
        "camera_height": 0.0,
        "field_of_view": 1.0,
        "missing_cones": 0.0,
    }
)
"""The value of each axis that changes nothing; None where each solid has its own."""

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "payload": "kg",
        "push": "m/s",
        "latency": "s",
        "fog": "1/m",
        "camera_pitch": "rad",
        "camera_height": "m",
    }
)
"""Of the axes that are no plain numbers."""


def each_once(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Refuse a value that is given twice."""
    for index, value in enumerate(values):
        if value in values[:index]:
            raise ValueError(f"{value!r} is given twice; remove one")
    return values


def _whole_steps(seconds: float) -> float:
    steps = seconds / CONTROL_STEP
    if abs(steps - round(steps)) > 1e-6:
        raise ValueError(f"{seconds:g} s is no whole number of control steps of {CONTROL_STEP:g} s")
    return seconds


_Value = TypeVar("_Value", bound=float)
_Values = Annotated[tuple[_Value, ...], AfterValidator(each_once)]
_Friction = Annotated[float, Field(gt=0.0, le=5.0)]
_Load = Annotated[float, Field(ge=0.0, le=20.0)]
_Speed = Annotated[float, Field(ge=0.0, le=3.0)]
_Strength = Annotated[float, Field(gt=0.0, le=2.0)]
_Latency = Annotated[float, Field(ge=0.0, le=1.0), AfterValidator(_whole_steps)]
_Deviation = Annotated[float, Field(ge=0.0, le=10.0)]
_Brightness = Annotated[float, Field(gt=0.0, le=4.0)]
_Density = Annotated[float, Field(ge=0.0, le=5.0)]
_Pitch = Annotated[float, Field(ge=-0.8, le=0.8)]
_Height = Annotated[float, Field(ge=-0.3, le=0.3)]
_View = Annotated[float, Field(ge=0.3, le=1.5)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Perturb(BaseModel):
    """Axes of the perturbation grid. An axis that is left out is not touched.

    A trial runs once in every cell of the grid, and the cell is part of the trial's identity.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    friction: _Values[_Friction] = Field(
        (), description="Sliding friction of ground and obstacles (1.25 as built)."
    )
    payload: _Values[_Load] = Field((), description="Load on the robot's back, kg.")
    push: _Values[_Speed] = Field(
        (),
        description="Speed that the trunk is given every 3 s, level, in a drawn direction, m/s.",
    )
    strength: _Values[_Strength] = Field(
        (), description="Share of the motors' gain and of their largest torque that is left."
    )
    latency: _Values[_Latency] = Field(
        (), description="Age added to every observation, s, in control steps of 0.02 s."
    )
    noise: _Values[_Deviation] = Field(
        (),
        description="Standard deviation of errors of every number observed: of the body as the "
        "policy is fed, of heights and depths in m, of colours as a share of white.",
    )
    exposure: _Values[_Brightness] = Field(
        (), description="Brightness of camera images, as a factor."
    )
    fog: _Values[_Density] = Field(
        (), description="Share of its light that a camera image loses per metre, as exponent, 1/m."
    )
    camera_pitch: _Values[_Pitch] = Field(
        (), description="Angle by which cameras look farther down, rad."
    )
    camera_height: _Values[_Height] = Field(
        (), description="Length by which cameras sit higher on the trunk, m."
    )
    field_of_view: _Values[_View] = Field(
        (), description="Vertical field of view of cameras, as a factor."
    )
    missing_cones: _Values[_Share] = Field(
        (), description="Probability of each cone of the trail to be missing in images."
    )

    @property
    def cells(self) -> tuple[tuple[tuple[str, float], ...], ...]:
        """The cells of the grid, axes in alphabetical order; one empty cell without axes."""
        cells: list[tuple[tuple[str, float], ...]] = [()]
        for axis in sorted(type(self).model_fields):
            values: tuple[float, ...] = getattr(self, axis)
            if values:
                cells = [(*cell, (axis, float(value))) for cell in cells for value in values]
        return tuple(cells)


STEPS = 7
"""Values from one end to the other, both counted, where nothing else is said."""
MOST_STEPS = 100
_DIGITS = 4
_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)(?:e-?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})\.\.({_NUMBER})(?::(\d{{1,6}}))?")
_LIST = re.compile(rf"{_NUMBER}(?:,{_NUMBER})*")


@dataclass(frozen=True, kw_only=True)
class SweptAxis:
    """An axis and its values, ascending."""

    name: str
    values: tuple[float, ...]

    @classmethod
    def of(cls, words: str) -> SweptAxis:
        """Return the axis that words such as `friction=0.3..1.2:7` name.

        Latencies are taken to the nearest control step.

        Raises:
            UsageError: there is no such axis, or its values cannot be used.
        """
        name, equals, span = words.partition("=")
        if name not in NEUTRAL:
            fix = nearest(name, list(NEUTRAL))
            raise UsageError(f"--axis {words!r}: there is no axis {name!r}", fix=fix)
        found = _RANGE.fullmatch(span)
        if found is not None:
            values = _between(float(found[1]), float(found[2]), int(found[3] or STEPS), words)
        elif equals and _LIST.fullmatch(span):
            values = [float(value) for value in span.split(",")]
        else:
            raise UsageError(
                f"--axis {words!r}: {span!r} is no range of values",
                fix=f"write {name}=FROM..TO, {name}=FROM..TO:STEPS or {name}=VALUE,VALUE",
            )
        if name == "latency":
            values = [
                round(round(value / CONTROL_STEP) * CONTROL_STEP, _DIGITS) for value in values
            ]
        kept = tuple(sorted(set(values)))
        if len(kept) < 2:
            raise UsageError(f"--axis {words!r} has one value", fix="give two or more")
        try:
            Perturb.model_validate({name: kept})
        except ValidationError as error:
            first = error.errors()[0]
            value = first.get("input")
            raise UsageError(
                f"--axis {words!r}: {value!r}: {first['msg'].lower()}",
                fix="see the axes in docs/suites.md",
            ) from None
        return cls(name=name, values=kept)


def _between(low: float, high: float, steps: int, words: str) -> list[float]:
    if not 2 <= steps <= MOST_STEPS:
        raise UsageError(
            f"--axis {words!r} has {plural(steps, 'step')}", fix=f"give 2 to {MOST_STEPS}"
        )
    gap = (high - low) / (steps - 1)
    return [round(low + gap * step, _DIGITS) for step in range(steps)]
