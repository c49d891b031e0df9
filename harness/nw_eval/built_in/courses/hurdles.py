"""Hurdles: bars across the trail, one after another."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.scenes.scene import Vector


@dataclass(frozen=True, kw_only=True)
class Hurdles:
    """Solid bars that lie across the trail, a waypoint on top of each and one after the last.

    Attributes:
        heights: of the bars in metres, nearest first; none makes a flat trail.
        gaps: metres from the spawn to the first bar's middle, then from middle to middle.
        length: of each bar along the trail, metres.
        width: of each bar across the trail, metres.
        shift: of each bar's middle to the left, metres; missing ones are 0.
        material: of the bars' sides.
        top: of their tops, where that differs.
        finish: metres from the last bar's middle (or the spawn) to the last waypoint.
    """

    heights: tuple[float, ...]
    gaps: tuple[float, ...]
    length: float = 0.35
    width: float = 1.6
    shift: tuple[float, ...] = ()
    material: str = "plywood"
    top: str | None = None
    finish: float = 1.6

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def middles(self) -> tuple[float, ...]:
        """Return the bars' middles along x, metres."""
        return tuple(sum(self.gaps[: index + 1]) for index in range(len(self.heights)))

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: on top of each bar, then on the floor after the last."""
        middles = self.middles()
        tops = tuple(
            (x, self._shift(index), height)
            for index, (x, height) in enumerate(zip(middles, self.heights, strict=True))
        )
        last = middles[-1] if middles else 0.0
        return (*tops, (last + self.finish, 0.0, 0.0))

    def build(self, builder: PlaceBuilder) -> None:
        """Build the bars."""
        for index, (x, height) in enumerate(zip(self.middles(), self.heights, strict=True)):
            y = self._shift(index)
            builder.box(
                (x - self.length / 2, x + self.length / 2),
                (y - self.width / 2, y + self.width / 2),
                (0.0, height),
                self.material,
                top=self.top,
                kind="obstacle",
                fine=0.6,
                texture=(3.7 * index, 0.0),
            )

    def _shift(self, index: int) -> float:
        return self.shift[index] if index < len(self.shift) else 0.0
