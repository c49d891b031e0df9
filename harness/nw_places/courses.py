"""Courses that only ladders have: steps down, one slope up or down, and boards to pass under."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nw_places.places.builder import ALL_FACES, SIDES, SceneBuilder, about
from nw_places.ramps import pitched_board
from nw_scenes.scene import Vector

_BEHIND = 1.5
"""Metres that the ground under the spawn reaches behind it, where that is raised."""
_DIGITS = 9
"""Of lengths in metres, as of all that is built: sums and sines end differently elsewhere."""
_HIGH = 0.95
"""Height of the upper edge of a board to pass under, metres, and at least `_BOARD` of board."""
_BOARD = 0.25


@dataclass(frozen=True, kw_only=True)
class StepsDown:
    """Steps from a platform under the spawn down to the ground, a waypoint on every other one.

    Attributes:
        drops: of the steps in metres, highest first.
        depth: of a tread along the way, metres.
        first: where the platform ends, metres along x.
        width: metres.
        arrival: from the last edge to the last waypoint, metres.
        material: of risers and sides.
        top: of treads and platform, where that differs.
    """

    drops: tuple[float, ...]
    depth: float = 0.30
    first: float = 1.5
    width: float = 1.8
    arrival: float = 1.4
    material: str = "concrete/light"
    top: str | None = None

    @property
    def floor(self) -> float:
        """Height of the ground in the world, metres."""
        return round(-sum(self.drops), _DIGITS)

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: on every other tread, then on the ground."""
        treads = self._treads()
        on_treads = tuple(((low + high) / 2, 0.0, z) for low, high, z in treads[::2])
        end = treads[-1][1] if treads else self.first
        return (*on_treads, (end + self.arrival, 0.0, self.floor))

    def build(self, builder: SceneBuilder) -> None:
        """Build platform and treads; the ground lies at z = 0."""
        levels = ((-_BEHIND, self.first, 0.0), *self._treads())
        for index, (low, high, z) in enumerate(levels):
            builder.box(
                (low, high),
                about(0.0, self.width / 2),
                (0.0, z - self.floor),
                self.material,
                top=self.top,
                kind="obstacle",
                fine=0.75,
                texture=(0.41 * index, 0.17 * index),
            )

    def _treads(self) -> tuple[tuple[float, float, float], ...]:
        """Return from where to where along x each tread reaches, and its height, metres, world."""
        return tuple(
            (
                self.first + index * self.depth,
                self.first + (index + 1) * self.depth,
                -sum(self.drops[: index + 1]),
            )
            for index in range(len(self.drops) - 1)
        )


@dataclass(frozen=True, kw_only=True)
class Slope:
    """One slope up to a deck, or from a deck under the spawn down; waypoints on it and behind it.

    Attributes:
        angle: radians; positive up, negative down.
        length: on the slope, metres.
        first: where the slope begins, metres along x.
        deck: length of the deck behind a slope up, metres.
        width: across the course, metres.
        material: of the slope.
        body: of the block under the deck.
        treads: of strips across the slope; none where not given.
    """

    angle: float
    length: float = 2.4
    first: float = 1.4
    deck: float = 2.4
    width: float = 1.8
    material: str = "plywood"
    body: str = "timber/brown"
    treads: str | None = None

    @property
    def floor(self) -> float:
        """Height of the ground in the world, metres."""
        return min(0.0, self._rise)

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: in the middle of the slope, then on the level behind it."""
        end = self.first + self._run
        return (
            (self.first + self._run / 2, 0.0, self._rise / 2),
            (end + 1.2, 0.0, self._rise),
        )

    def build(self, builder: SceneBuilder) -> None:
        """Build slope and deck; the ground lies at z = 0."""
        end, height = self.first + self._run, abs(self._rise)
        across = about(0.0, self.width / 2)
        up = self.angle > 0.0
        pitched_board(
            builder, (self.first, end), (0.0, height) if up else (height, 0.0), across,
            self.material, treads=self.treads,
        )  # fmt: skip
        builder.box(
            (end, end + self.deck) if up else (-_BEHIND, self.first), across, (0.0, height),
            self.body, top=self.material, kind="obstacle", fine=0.7,
        )  # fmt: skip

    @property
    def _run(self) -> float:
        return round(self.length * math.cos(self.angle), _DIGITS)

    @property
    def _rise(self) -> float:
        return round(self.length * math.sin(self.angle), _DIGITS)


@dataclass(frozen=True, kw_only=True)
class Passages:
    """Boards on two posts to pass under, a waypoint behind each.

    Rays that measure the ground look through them, as through all that hangs overhead.

    Attributes:
        clearance: of each board's lower edge above the ground, metres.
        count: of the boards.
        first: of the first board's middle along x, metres.
        apart: from one board to the next, metres.
        length: of each board along the course, metres.
        width: between the posts, metres.
        material: of boards and posts.
    """

    clearance: float
    count: int = 2
    first: float = 1.7
    apart: float = 1.8
    length: float = 0.30
    width: float = 1.6
    material: str = "plywood"

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints, on the ground."""
        return tuple((x + 0.9, 0.0, 0.0) for x in self._middles())

    def build(self, builder: SceneBuilder) -> None:
        """Build boards and posts."""
        high = max(_HIGH, self.clearance + _BOARD)
        for index, x in enumerate(self._middles()):
            texture = (1.9 * index, 0.0)
            builder.box(
                about(x, self.length / 2), about(0.0, self.width / 2), (self.clearance, high),
                self.material, kind="overhead", faces=ALL_FACES, fine=0.6, texture=texture,
            )  # fmt: skip
            for side in (-1.0, 1.0):
                builder.box(
                    about(x, self.length / 2), about(side * (self.width / 2 + 0.06), 0.06),
                    (0.0, high), self.material, kind="structure", faces=(*SIDES, "+z"), fine=0.8,
                    texture=texture,
                )  # fmt: skip

    def _middles(self) -> tuple[float, ...]:
        return tuple(self.first + index * self.apart for index in range(self.count))
