"""Ramps: boards that lean to one side, and slopes up and down."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nw_eval.built_in.courses.slopes import THICKNESS, pitched_board, rolled_board
from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.scenes.scene import Vector

# Height of the lower edge of a leaning board above the ground, metres.
_LOW_EDGE = 0.03


@dataclass(frozen=True, kw_only=True)
class Boards:
    """Staggered boards that lean inwards from alternate sides, low edges towards the middle.

    Attributes:
        angles: of the boards in degrees, nearest first.
        first: where the first board begins, metres along x.
        length: of each board along the trail, metres.
        width: of each board across the trail, on its slope, metres.
        offset: of the boards' middles from the trail's line, to alternate sides, metres: small
            ones are in line, large ones spread.
        gap: metres between boards along the trail.
        side: +1 where the first board lies on the left, -1 on the right.
        material: of the boards.
        props: material of the blocks under their high edges.
    """

    angles: tuple[float, ...]
    first: float = 1.1
    length: float = 0.85
    width: float = 0.90
    offset: float = 0.2
    gap: float = 0.10
    side: int = 1
    material: str = "plywood"
    props: str = "timber/brown"

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: on each board near its middle, then on the ground."""
        points: list[Vector] = []
        for index, degrees in enumerate(self.angles):
            low, high = self._span(index)
            side = self._side(index)
            # A little nearer to the trail's line, as one walks; so a little lower.
            y = 0.8 * self.offset
            z = self._middle(degrees) - (self.offset - y) * math.tan(math.radians(degrees))
            points.append(((low + high) / 2, side * y, z))
        return (*points, (self._span(len(self.angles) - 1)[1] + 1.0, 0.0, 0.0))

    def build(self, builder: PlaceBuilder) -> None:
        """Build boards and props."""
        for index, degrees in enumerate(self.angles):
            x = self._span(index)
            side = self._side(index)
            angle = math.radians(degrees)
            z = self._middle(degrees)
            rolled_board(
                builder, x, side * self.offset, z, self.width, side * angle, self.material,
                texture=(1.3 * index, 0.0),
            )  # fmt: skip
            # Props stand under the outer part; the board's underside clears their inner edge.
            inner = 0.30 * self.width
            outer = inner + 0.10
            top = z + inner * math.tan(angle) - 1.05 * THICKNESS / math.cos(angle)
            y = tuple(sorted((side * (self.offset + inner), side * (self.offset + outer))))
            for end in (x[0] + 0.08, x[1] - 0.20):
                builder.box(
                    (end, end + 0.12), (y[0], y[1]), (0.0, top), self.props, kind="structure",
                    fine=0.8,
                )  # fmt: skip

    def _span(self, index: int) -> tuple[float, float]:
        start = self.first + index * (self.length + self.gap)
        return (start, start + self.length)

    def _side(self, index: int) -> int:
        return self.side * (1 if index % 2 == 0 else -1)

    def _middle(self, degrees: float) -> float:
        return _LOW_EDGE + 0.5 * self.width * math.sin(math.radians(degrees))


@dataclass(frozen=True, kw_only=True)
class Humps:
    """Slopes up to a deck and down again, one hump after another; a waypoint on each deck.

    Attributes:
        angles: of each hump's slopes in degrees.
        lengths: of each slope, metres on the slope.
        decks: length of each hump's level top, metres.
        first: where the first slope begins, metres along x.
        apart: metres of ground between humps.
        width: across the trail, metres.
        shift: of each hump's middle to the left, metres; missing ones are 0.
        material: of the boards.
        body: of the blocks under the decks.
        top: of the decks; the boards' material where not given.
        treads: of strips across the slopes; none where not given.
    """

    angles: tuple[float, ...]
    lengths: tuple[float, ...]
    decks: tuple[float, ...]
    first: float = 1.3
    apart: float = 0.7
    width: float = 1.0
    shift: tuple[float, ...] = ()
    material: str = "plywood"
    body: str = "timber/brown"
    top: str | None = None
    treads: str | None = None

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: in the middle of each deck, then on the ground."""
        points = tuple(
            (start + run + deck / 2, self._shift(index), height)
            for index, (start, run, deck, height) in enumerate(self._humps())
        )
        start, run, deck, _ = self._humps()[-1]
        return (*points, (start + 2 * run + deck + 1.0, 0.0, 0.0))

    def build(self, builder: PlaceBuilder) -> None:
        """Build slopes and decks."""
        for index, (start, run, deck, height) in enumerate(self._humps()):
            y = (self._shift(index) - self.width / 2, self._shift(index) + self.width / 2)
            crest, brink = start + run, start + run + deck
            texture = (2.1 * index, 0.0)
            pitched_board(
                builder, (start, crest), (0.0, height), y, self.material, treads=self.treads,
                texture=texture,
            )  # fmt: skip
            builder.box(
                (crest, brink), y, (0.0, height), self.body, top=self.top or self.material,
                kind="obstacle", fine=0.7, texture=texture,
            )  # fmt: skip
            pitched_board(
                builder, (brink, brink + run), (height, 0.0), y, self.material, treads=self.treads,
                texture=texture,
            )  # fmt: skip

    def _humps(self) -> tuple[tuple[float, float, float, float], ...]:
        """Return where each hump starts, the run of its slopes, its deck's length and height."""
        humps: list[tuple[float, float, float, float]] = []
        start = self.first
        for degrees, length, deck in zip(self.angles, self.lengths, self.decks, strict=True):
            angle = math.radians(degrees)
            run, height = length * math.cos(angle), length * math.sin(angle)
            humps.append((start, run, deck, height))
            start += 2 * run + deck + self.apart
        return tuple(humps)

    def _shift(self, index: int) -> float:
        return self.shift[index] if index < len(self.shift) else 0.0
