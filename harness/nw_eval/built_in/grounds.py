"""Wide grounds without a course, for tasks that command a velocity: level, sloping and rough."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nw_eval.built_in.entry import Entry
from nw_eval.built_in.hurdles import Hurdles
from nw_eval.built_in.places.builder import SceneBuilder
from nw_eval.built_in.places.gardens import Field
from nw_eval.scenes.scene import Vector

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
                (x - half_x, x + half_x),
                (y - half_y, y + half_y),
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
        task="open",
        setting=Field(),
        course=Hurdles(heights=(), gaps=(), finish=4.0),
        light="afternoon",
    ),
    Entry(
        name="open/bowl",
        title="grass slopes of 10 degrees on all sides of a level square of 4 by 4 m",
        task="open",
        setting=Field(),
        course=Bowl(degrees=10.0),
        light="noon",
    ),
    Entry(
        name="open/rubble",
        title="flat stones, 2 to 6 cm, strewn over a lawn",
        task="open",
        setting=Field(ground="grass/dry"),
        course=Rubble(count=1000, heights=(0.02, 0.06)),
        light="overcast",
    ),
)
