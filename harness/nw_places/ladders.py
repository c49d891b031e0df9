"""Ladders: scenes with a number, such as the height of three bars.

`hurdles/bar@0.34` is a rung: the course of a family at one value, in the first of three settings.
`~1` and `~2` behind it are the same course in the other two. Every value of the published range
makes a scene, the published rungs among them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal

from nw_base.errors import SceneError
from nw_places.courses import Passages, Slope, StepsDown
from nw_places.entries import Rubble
from nw_places.entry import Course, Entry, Setting
from nw_places.gaps import Gaps
from nw_places.hurdles import Hurdles
from nw_places.places.gardens import Courtyard, Field
from nw_places.places.rooms import Room
from nw_places.places.streets import CarPark
from nw_places.ramps import Boards
from nw_places.stairs import Stairs

Unit = Literal["m", "rad"]

DIGITS = 4
"""Decimals of a value: a tenth of a millimetre."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """A setting of a ladder, and what its obstacles are made of there.

    Attributes:
        words: where it is, for titles.
        setting: the scene round the course.
        light: a name of `LIGHTS`.
        paint: materials by field of courses; fields that a course lacks are left out.
        exposure: multiplies the light's own.
    """

    words: str
    setting: Setting
    light: str
    paint: Mapping[str, str]
    exposure: float = 1.0


_LOOKS = (
    Look(
        words="in a gymnasium",
        setting=Room(
            floor="parquet/walnut",
            walls="plaster/white",
            accent="plaster/teal",
            width=7.0,
            height=4.2,
            hall=True,
        ),
        light="indoor",
        paint={"material": "planks/pine", "body": "timber/brown", "props": "timber/brown"},
    ),
    Look(
        words="in a courtyard",
        setting=Courtyard(ground="pavers/grey", walls="brick/yellow"),
        light="noon",
        paint={"material": "timber/dark", "body": "brick/red", "props": "concrete/light"},
        exposure=0.85,
    ),
    Look(
        words="in a car park",
        setting=CarPark(),
        light="overcast",
        paint={"material": "concrete/light", "body": "kerb/yellow", "props": "kerb/yellow"},
    ),
)

_LAWNS = (
    Look(words="on a lawn", setting=Field(), light="noon", paint={"material": "granite/grey"}),
    Look(
        words="on dry grass",
        setting=Field(ground="grass/dry"),
        light="overcast",
        paint={"material": "slabs/sand"},
    ),
    Look(
        words="on gravel",
        setting=Field(ground="gravel/grey"),
        light="afternoon",
        paint={"material": "granite/pink"},
    ),
)


@dataclass(frozen=True, kw_only=True)
class Family:
    """A built-in ladder: one course with one number.

    Attributes:
        name: such as `hurdles/bar`; what comes before the slash is the task.
        title: what the course is, without its number.
        parameter: what the number is.
        unit: of it.
        rungs: the published values, from easy to hard.
        course: makes the course of a value.
        looks: the settings, the default first.
        aside: half width by which a trial may move waypoints to a side, metres.
    """

    name: str
    title: str
    parameter: str
    rungs: tuple[float, ...]
    course: Callable[[float], Course]
    unit: Unit = "m"
    looks: tuple[Look, ...] = field(default=_LOOKS)
    aside: float = 0.1

    @property
    def low(self) -> float:
        """Least value."""
        return min(self.rungs)

    @property
    def high(self) -> float:
        """Greatest value."""
        return max(self.rungs)

    def reference(self, value: float, number: int | None = None) -> str:
        """Return the name of a rung's scene.

        Args:
            value: within the range.
            number: of another setting; None for the default.

        Raises:
            SceneError: the value is outside of the range or has too many decimals, or there is no
                such setting.
        """
        name = f"{self.name}@{_plain(value)}"
        if not self.low <= value <= self.high:
            inside = self.reference(min(max(value, self.low), self.high))
            raise SceneError(
                f"{name} is outside of its ladder: {self.parameter} is {_plain(self.low)} to "
                f"{_plain(self.high)} {self.unit}",
                fix=f"name a value in that range, such as {inside}",
            )
        if value != round(value, DIGITS):
            near = self.reference(round(value, DIGITS))
            raise SceneError(f"{name} has more than {DIGITS} decimals", fix=f"write {near}")
        if number is not None and number >= len(self.looks):
            raise SceneError(
                f"{name}~{number} names setting {number} of a ladder that has {len(self.looks)}",
                fix=f"write {name}, {name}~1 or {name}~{len(self.looks) - 1}",
            )
        return name if number is None else f"{name}~{number}"

    @property
    def reference_of_easiest(self) -> str:
        """The name of its easiest published rung."""
        return self.reference(self.rungs[0])

    def entry(self, value: float, number: int | None = None) -> Entry:
        """Return the scene of a rung; arguments and errors are those of `reference`."""
        name = self.reference(value, number)
        look = self.looks[number or 0]
        course: Any = self.course(value)  # A dataclass, as all courses are.
        known = {each.name for each in fields(course)}
        paint = {part: material for part, material in look.paint.items() if part in known}
        return Entry(
            name=name,
            title=f"{self.title}, {told(value, self.unit)}, {look.words}",
            setting=look.setting,
            course=replace(course, **paint),
            light=look.light,
            exposure=look.exposure,
            waypoint_noise=(0.0, self.aside),
        )


def told(value: float, unit: str) -> str:
    """Return a value with its unit for people; angles in degrees, too."""
    degrees = f" ({math.degrees(value):.1f} degrees)" if unit == "rad" else ""
    return f"{_plain(value)} {unit}{degrees}".rstrip()


def _plain(value: float) -> str:
    """Return a number as names have it: without an exponent and without zeros at its end."""
    whole = f"{value:.10f}".rstrip("0").rstrip(".")
    return whole if whole not in {"", "-0"} else "0"


def steps(first: float, last: float, step: float) -> tuple[float, ...]:
    """Return values from the first to the last, both counted, a step apart in either direction."""
    count = round(abs(last - first) / step)
    way = step if last > first else -step
    return tuple(round(first + way * index, DIGITS) for index in range(count + 1))


_FAMILIES = (
    Family(
        name="hurdles/bar",
        title="three bars of equal height",
        parameter="height of the bars",
        rungs=steps(0.10, 0.62, 0.04),
        course=lambda value: Hurdles(heights=(value,) * 3, gaps=(1.7, 1.8, 1.8)),
    ),
    Family(
        name="hurdles/block",
        title="a block to climb onto and off",
        parameter="height of the block",
        rungs=steps(0.10, 0.75, 0.05),
        course=lambda value: Hurdles(
            heights=(value,), gaps=(2.2,), length=1.6, width=2.0, finish=2.2
        ),
    ),
    Family(
        name="hurdles/clearance",
        title="two boards to pass under",
        parameter="clearance under the boards",
        rungs=steps(0.70, 0.18, 0.04),
        course=lambda value: Passages(clearance=value),
    ),
    Family(
        name="gaps/gap",
        title="two platforms over three equal gaps",
        parameter="width of the gaps",
        rungs=steps(0.20, 0.98, 0.06),
        course=lambda value: Gaps(gaps=(value,) * 3),
    ),
    Family(
        name="gaps/beam",
        title="a narrow beam between two platforms",
        parameter="width of the beam",
        rungs=steps(1.00, 0.09, 0.07),
        aside=0.0,
        # It reaches into both platforms, so that no foot finds a seam.
        course=lambda value: Gaps(gaps=(-0.05, -0.05), width=value, length=2.4),
    ),
    Family(
        name="stairs/up",
        title="five steps up",
        parameter="rise of the steps",
        rungs=steps(0.08, 0.34, 0.02),
        course=lambda value: Stairs(rises=(value,) * 5),
    ),
    Family(
        name="stairs/down",
        title="five steps down",
        parameter="drop of the steps",
        rungs=steps(0.08, 0.34, 0.02),
        course=lambda value: StepsDown(drops=(value,) * 5),
    ),
    Family(
        name="stairs/drop",
        title="one step down from a platform",
        parameter="drop of the step",
        rungs=steps(0.10, 0.75, 0.05),
        course=lambda value: StepsDown(drops=(value,)),
    ),
    Family(
        name="ramps/up",
        title="a slope up to a deck",
        parameter="angle of the slope",
        unit="rad",
        rungs=steps(0.10, 0.75, 0.05),
        course=lambda value: Slope(angle=value),
    ),
    Family(
        name="ramps/down",
        title="a slope down from a deck",
        parameter="angle of the slope",
        unit="rad",
        rungs=steps(0.10, 0.75, 0.05),
        course=lambda value: Slope(angle=-value),
    ),
    Family(
        name="ramps/side",
        title="four boards that lean to one side each",
        parameter="angle of the boards",
        unit="rad",
        rungs=steps(0.05, 0.70, 0.05),
        aside=0.05,
        course=lambda value: Boards(angles=(math.degrees(value),) * 4, offset=0.10),
    ),
    Family(
        name="open/stones",
        title="strewn flat stones, up to a height",
        parameter="height of the highest stones",
        rungs=steps(0.02, 0.28, 0.02),
        # So dense that there is no way round them.
        course=lambda value: Rubble(
            count=2000,
            heights=(0.25 * value, value),
            sides=(0.2, 0.4),
            reach=6.0,
            clear=0.7,
            finish=4.5,
        ),
        looks=_LAWNS,
    ),
)

FAMILIES: Mapping[str, Family] = MappingProxyType({each.name: each for each in _FAMILIES})
"""All built-in ladders, by name."""

_RUNG = re.compile(
    r"(?P<name>[^@~]+)@(?P<value>[0-9]{1,3}(?:\.[0-9]{1,12})?)(?:~(?P<number>[1-9][0-9]?))?"
)


def rung(reference: str) -> Entry | None:
    """Return the scene of a rung by its name; None if no built-in ladder is meant.

    Raises:
        SceneError: the ladder has no such value or setting, with its range and the fix.
    """
    family, at, _ = reference.partition("@")
    if not at or family not in FAMILIES:
        return None
    mine = FAMILIES[family]
    found = _RUNG.fullmatch(reference)
    if found is None:
        raise SceneError(
            f"{reference!r} is no rung of the ladder {family}",
            fix=f"write a number behind @, such as {mine.reference_of_easiest}",
        )
    return mine.entry(float(found["value"]), int(found["number"]) if found["number"] else None)
