"""All built-in scenes, and further looks of each.

`gaps/two_stones_park~3` is a variant: the course of a scene in another's place. Sixteen places a
task are few to learn to see from: a network comes to know them by their floors. A variant has the
obstacles and the waypoints of its scene to the last bit, but place, light and materials of others
of the same task, so that what it looks like says nothing of where to step. Variants of training
scenes are made of training scenes alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from hashlib import sha256
from typing import Any

import numpy as np

from nw_places.entry import Course, Entry
from nw_places.gaps import GAPS
from nw_places.hurdles import HURDLES, Hurdles
from nw_places.places.builder import SceneBuilder, about
from nw_places.places.gardens import Field
from nw_places.ramps import RAMPS
from nw_places.splits import split_of
from nw_places.stairs import STAIRS
from nw_scenes.scene import Vector

_THICK = 0.3  # m, of slopes


@dataclass(frozen=True, kw_only=True)
class Bowl:
    """Slopes up from a level square on all four sides; one waypoint on the slope ahead.

    Attributes:
        degrees: of the slopes.
        middle: half a side of the square, metres.
        reach: metres from the spawn to the upper ends.
        material: of the slopes.
    """

    degrees: float
    middle: float = 2.0
    reach: float = 13.0
    material: str = "grass/green"

    @property
    def floor(self) -> float:
        """Height of the square, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoint, three metres up the slope ahead."""
        return ((self.middle + 3.0, 0.0, 3.0 * math.tan(math.radians(self.degrees))),)

    def build(self, builder: SceneBuilder) -> None:
        """Build the slopes: of two that overlap the higher one is walked on, so none ends early."""
        angle = math.radians(self.degrees)
        run = self.reach - self.middle
        half = run / math.cos(angle) / 2
        # The middle of a slab lies half its thickness below the middle of its upper surface.
        away = self.middle + run / 2 + _THICK / 2 * math.sin(angle)
        z = run / 2 * math.tan(angle) - _THICK / 2 * math.cos(angle)
        level = (z - _THICK / 2, z + _THICK / 2)
        across = (2.0 - self.reach, self.reach - 2.0)
        for side in (1.0, -1.0):
            along = (side * away - half, side * away + half)
            for x, y, pitch, roll in (
                (along, across, -side * angle, 0.0),
                (across, along, 0.0, side * angle),
            ):
                builder.box(
                    x,
                    y,
                    level,
                    self.material,
                    pitch=pitch,
                    roll=roll,
                    kind="obstacle",
                    faces=("+z",),
                    fine=1.2,
                )


@dataclass(frozen=True, kw_only=True)
class Rubble:
    """Flat stones that lie about at random, the same ones always; one waypoint ahead.

    Attributes:
        count: of stones that are drawn; those that would lie on an earlier one are left out.
        heights: from and to, metres.
        sides: from and to, metres.
        reach: metres from the spawn within which they lie, along x and y.
        clear: metres around the spawn and the waypoint without any.
        finish: metres from the spawn to the waypoint.
        material: of the stones.
        seed: of their draw.
    """

    count: int
    heights: tuple[float, float]
    sides: tuple[float, float] = (0.2, 0.6)
    reach: float = 11.0
    clear: float = 1.1
    finish: float = 4.0
    material: str = "granite/grey"
    seed: int = 1

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoint, on the ground."""
        return ((self.finish, 0.0, 0.0),)

    def build(self, builder: SceneBuilder) -> None:
        """Lay the stones, none on another one."""
        drawn = np.round(np.random.default_rng(self.seed).random((self.count, 6)), 4).tolist()
        low, high = self.sides
        laid: list[tuple[float, float, float]] = []
        for index, (u, v, length, width, height, turn) in enumerate(drawn):
            x, y = (2.0 * u - 1.0) * self.reach, (2.0 * v - 1.0) * self.reach
            if min(math.hypot(x, y), math.hypot(x - self.finish, y)) < self.clear:
                continue
            half_x, half_y = (0.5 * (low + share * (high - low)) for share in (length, width))
            round_it = math.hypot(half_x, half_y)
            if any(math.hypot(x - at_x, y - at_y) < round_it + other for at_x, at_y, other in laid):
                continue
            laid.append((x, y, round_it))
            top = self.heights[0] + height * (self.heights[1] - self.heights[0])
            builder.box(
                about(x, half_x),
                about(y, half_y),
                (0.0, top),
                self.material,
                yaw=math.pi * turn,
                kind="obstacle",
                fine=1.2,
                texture=(0.7 * index, 0.0),
            )


GROUNDS: tuple[Entry, ...] = (
    Entry(
        name="open/field",
        title="a level lawn of 32 by 32 m with nothing in the way",
        setting=Field(),
        course=Hurdles(heights=(), gaps=(), finish=4.0),
        light="afternoon",
    ),
    Entry(
        name="open/bowl",
        title="grass slopes of 10 degrees on all sides of a level square of 4 by 4 m",
        setting=Field(),
        course=Bowl(degrees=10.0),
        light="noon",
    ),
    Entry(
        name="open/rubble",
        title="flat stones, 2 to 6 cm, strewn over a lawn",
        setting=Field(ground="grass/dry"),
        course=Rubble(count=1000, heights=(0.02, 0.06)),
        light="overcast",
    ),
)


ENTRIES: tuple[Entry, ...] = (*HURDLES, *GAPS, *RAMPS, *STAIRS, *GROUNDS)

MOST = 99
"""Largest number of a variant."""

_VARIANT = re.compile(r"(?P<name>[^~]+)~(?P<number>[1-9][0-9]?)")
_MATERIALS = frozenset({"material", "top", "props", "body", "treads"})
"""Fields of courses that say what obstacles are made of, and no more."""


def parted(text: str) -> tuple[str, int | None]:
    """Return a name or pattern without the number of a variant, and the number; None without."""
    found = _VARIANT.fullmatch(text)
    return (text, None) if found is None else (found["name"], int(found["number"]))


def has_variants(name: str) -> bool:
    """Return whether there are others that a built-in scene's variants can be made of."""
    return split_of(name) is not None


def variant(name: str, number: int, entries: Mapping[str, Entry]) -> Entry:
    """Return a variant of a scene: the same whenever and wherever it is made.

    Args:
        name: of a scene that has variants.
        number: 1 to `MOST`.
        entries: all built-in scenes by name.
    """
    entry = entries[name]
    like = [
        other
        for other in sorted(entries.values(), key=lambda each: each.name)
        if other.name != name
        and other.task == entry.task
        and split_of(other.name) == split_of(name)
    ]
    seed = sha256(f"{name}~{number}".encode()).digest()
    random = np.random.default_rng(list(seed))
    place = like[int(random.integers(len(like)))]
    return replace(
        entry,
        name=f"{name}~{number}",
        title=f"{entry.title}, elsewhere: variant {number}",
        setting=place.setting,
        light=place.light,
        exposure=place.exposure,
        course=_painted(entry, like, random),
    )


def _painted(entry: Entry, like: Sequence[Entry], random: np.random.Generator) -> Course:
    """Return the course of a scene in the materials of another of its kind, if there is one."""
    same = [other.course for other in like if type(other.course) is type(entry.course)]
    if not same:
        return entry.course
    other = same[int(random.integers(len(same)))]
    course: Any = entry.course  # A dataclass, as all courses are.
    names = [each.name for each in fields(course) if each.name in _MATERIALS]
    return replace(course, **{each: getattr(other, each) for each in names})
