"""Gaps: platforms above a lower floor, with nothing between them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Literal

from nw_eval.built_in.places.builder import SIDES_AND_TOP, PlaceBuilder
from nw_eval.scenes.scene import Vector

DEPTH = 0.4064
"""From the tops of platforms, z = 0, down to the floor, metres: 16 inches, as published."""

_START = 1.35  # Metres that the first platform reaches behind the spawn.
_START_WIDTH = 1.524
_LEG = 0.09


@dataclass(frozen=True, kw_only=True)
class Gaps:
    """Platforms in a row, a waypoint in the middle of each, and one at the end.

    Attributes:
        gaps: metres of nothing before each platform, nearest first. With `last` = `platform` the
            last gap is the one before the end platform.
        edge: where the platform under the spawn ends, metres along x.
        length: of each platform along the trail, metres.
        width: of each platform across the trail, metres.
        shift: of each platform's middle to the left, metres; missing ones are 0.
        material: of the platforms' sides.
        top: of their tops, where that differs.
        thickness: of decks on four legs that one can look under, metres; solid blocks where not
            given.
        last: whether the trail ends on a long platform or down on the floor.
    """

    gaps: tuple[float, ...]
    edge: float = 1.3
    length: float = 1.05
    width: float = 1.0
    shift: tuple[float, ...] = ()
    material: str = "plywood"
    top: str | None = None
    thickness: float | None = None
    last: Literal["platform", "floor"] = "platform"

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return -DEPTH

    def spans(self) -> tuple[tuple[float, float], ...]:
        """Return from where to where along x the platforms of the row reach, metres."""
        row = self.gaps if self.last == "floor" else self.gaps[:-1]
        ends = tuple(accumulate((gap + self.length for gap in row), initial=self.edge))[1:]
        return tuple((end - self.length, end) for end in ends)

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: in the middle of each platform, then at the end."""
        spans = self.spans()
        middles = tuple(
            ((low + high) / 2, self._shift(index), 0.0) for index, (low, high) in enumerate(spans)
        )
        if self.last == "floor":
            return (*middles, (spans[-1][1] + 1.4, 0.0, self.floor))
        return (*middles, (self._end()[0] + 1.2, 0.0, 0.0))

    def build(self, builder: PlaceBuilder) -> None:
        """Build the platforms; the ground lies at z = 0."""
        half = _START_WIDTH / 2
        self._platform(builder, (-_START, self.edge), (-half, half), 0)
        for index, span in enumerate(self.spans()):
            y = self._shift(index)
            self._platform(builder, span, (y - self.width / 2, y + self.width / 2), index + 1)
        if self.last == "platform":
            self._platform(builder, self._end(), (-half, half), len(self.gaps))

    def _platform(
        self, builder: PlaceBuilder, x: tuple[float, float], y: tuple[float, float], index: int
    ) -> None:
        texture = (1.7 * index, 0.31 * index)
        thick = DEPTH if self.thickness is None else self.thickness
        builder.box(
            x,
            y,
            (DEPTH - thick, DEPTH),
            self.material,
            top=self.top,
            kind="obstacle",
            faces=SIDES_AND_TOP,
            fine=0.7,
            texture=texture,
        )
        if self.thickness is None:
            return
        inset = 0.08
        for leg_x in (x[0] + inset, x[1] - inset - _LEG):
            for leg_y in (y[0] + inset, y[1] - inset - _LEG):
                builder.box(
                    (leg_x, leg_x + _LEG),
                    (leg_y, leg_y + _LEG),
                    (0.0, DEPTH - thick),
                    self.material,
                    kind="structure",
                    faces=("-x", "+x", "-y", "+y"),
                    fine=0.8,
                )

    def _end(self) -> tuple[float, float]:
        spans = self.spans()
        start = (spans[-1][1] if spans else self.edge) + self.gaps[-1]
        return (start, start + 2.6)

    def _shift(self, index: int) -> float:
        return self.shift[index] if index < len(self.shift) else 0.0
