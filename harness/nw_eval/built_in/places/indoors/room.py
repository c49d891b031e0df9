"""A room: carpet or boards, walls with windows, a door, posters, shelves and seats."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.indoors import furniture
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import room_shell, window_lamp


@dataclass(frozen=True, kw_only=True)
class Room:
    """A seminar room, an office or, higher and emptier, a hall.

    Attributes:
        floor, walls: materials.
        accent: material of the far wall, where that differs.
        width, height: metres.
        hall: gymnasium fittings in place of tables and shelves.
    """

    floor: str
    walls: str
    accent: str | None = None
    width: float = 6.0
    height: float = 2.7
    hall: bool = False
    indoor: bool = True

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the room."""
        x = (-2.4, length + 2.6)
        y = (-self.width / 2, self.width / 2)
        span = x[1] - x[0]
        sill, lintel = (1.3, 2.9) if self.hall else (0.85, 2.2)
        windows = self._windows(span)
        panels = self._panels(x)
        decals = {
            "left": [
                Decal(rect=(u, sill, u + w, lintel), material="window", fine=0.5, opening=True)
                for u, w in windows
            ],
            "right": self._right_wall(span),
            "far": self._far_wall(),
            "back": [Decal(rect=(0.5, 0.0, 1.45, 2.05), material="door/oak", fine=0.6)],
            "ceiling": [
                Decal(rect=(y0 - y[0], x0 - x[0], y1 - y[0], x1 - x[0]), material="lamp", fine=0.5)
                for x0, x1, y0, y1 in panels
            ],
        }
        accent = self.accent or self.walls
        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            walls={"left": self.walls, "right": self.walls, "far": accent, "back": self.walls},
            ceiling="ceiling_tiles",
            decals=decals,
        )
        for x0, x1, y0, y1 in panels:
            builder.lamp(
                (x0, y0, self.height - 0.02), (0.0, y1 - y0, 0.0), (x1 - x0, 0.0, 0.0),
                (5.0, 4.8, 4.4),
            )  # fmt: skip
        for u, w in windows:
            window_lamp(
                builder,
                (x[0] + u, y[1] - 0.02, sill),
                (w, 0.0, 0.0),
                (0.0, 0.0, lintel - sill),
            )
        if self.hall:
            self._hall(builder, x, y)
        else:
            self._seminar(builder, x, y, windows)

    def _windows(self, span: float) -> list[tuple[float, float]]:
        count = max(2, int(span / 2.6))
        pitch = span / count
        return [(pitch * (index + 0.5) - 0.75, 1.5) for index in range(count)]

    def _panels(self, x: tuple[float, float]) -> list[tuple[float, float, float, float]]:
        count = max(2, round((x[1] - x[0]) / 2.6))
        pitch = (x[1] - x[0]) / count
        return [
            (x[0] + pitch * (index + 0.5) - 0.6, x[0] + pitch * (index + 0.5) + 0.6, y0, y0 + 0.3)
            for index in range(count)
            for y0 in (-self.width / 4 - 0.15, self.width / 4 - 0.15)
        ]

    def _right_wall(self, span: float) -> list[Decal]:
        if self.hall:
            return [Decal(rect=(0.6, 0.15, span - 0.6, 2.5), material="wall_bars", fine=0.6)]
        return [
            Decal(rect=(span * 0.16, 0.95, span * 0.16 + 1.9, 2.05), material="whiteboard"),
            Decal(rect=(span * 0.52, 1.1, span * 0.52 + 0.6, 1.95), material="poster/teal"),
            Decal(rect=(span * 0.52 + 0.75, 1.1, span * 0.52 + 1.35, 1.95), material="poster/red"),
            Decal(rect=(span * 0.86, 1.25, span * 0.86 + 0.45, 1.75), material="poster/ochre"),
        ]

    def _far_wall(self) -> list[Decal]:
        door = self.width * 0.66
        if self.hall:
            return [
                Decal(
                    rect=(self.width / 2 - 1.0, 0.0, self.width / 2 + 1.0, 2.2), material="doors"
                ),
                Decal(
                    rect=(self.width / 2 - 0.25, 2.35, self.width / 2 + 0.25, 2.55),
                    material="exit",
                ),
            ]
        return [
            Decal(rect=(door, 0.0, door + 0.95, 2.08), material="door/oak", fine=0.5),
            Decal(rect=(0.7, 1.0, 2.3, 2.0), material="pinboard", fine=0.5),
            Decal(rect=(door - 0.25, 1.1, door - 0.13, 1.25), material="plastic/white", fine=0.5),
        ]

    def _seminar(
        self,
        builder: PlaceBuilder,
        x: tuple[float, float],
        y: tuple[float, float],
        windows: list[tuple[float, float]],
    ) -> None:
        for u, w in windows:
            furniture.radiator(builder, (x[0] + u + 0.1, x[0] + u + w - 0.1), (y[1] - 0.11, y[1]))
        far = x[1]
        furniture.bookshelf(builder, (far - 2.3, far - 1.2), (y[0], y[0] + 0.32), face="+y")
        furniture.bookshelf(
            builder, (far - 3.5, far - 2.4), (y[0], y[0] + 0.32), face="+y", height=1.2
        )
        furniture.plant(builder, far - 0.45, y[1] - 0.5)
        furniture.table(builder, (0.9, 2.5), (y[1] - 0.95, y[1] - 0.25))
        furniture.chair(builder, 1.3, y[1] - 1.1, facing=1.0)
        furniture.chair(builder, 2.1, y[1] - 1.15, facing=1.0, seat="plastic/orange")
        furniture.table(builder, (far - 2.4, far - 0.9), (y[1] - 0.95, y[1] - 0.25))
        furniture.chair(builder, far - 1.7, y[1] - 1.15, facing=1.0)
        furniture.crate(
            builder, (far - 0.5, far - 0.1), (y[0] + 0.1, y[0] + 0.5), (0.0, 0.34), "cardboard"
        )

    def _hall(self, builder: PlaceBuilder, x: tuple[float, float], y: tuple[float, float]) -> None:
        for start in (x[0] + 1.0, x[1] - 3.2):
            builder.box(
                (start, start + 2.2), (y[1] - 0.35, y[1] - 0.05), (0.30, 0.36), "planks/pine"
            )
            for end in (start + 0.2, start + 1.9):
                builder.box(
                    (end, end + 0.08), (y[1] - 0.33, y[1] - 0.07), (0.0, 0.30), "planks/pine"
                )
        builder.box((x[1] - 1.6, x[1] - 0.2), (y[0] + 0.35, y[0] + 1.15), (0.0, 0.40), "foam/blue")
        builder.box((x[1] - 1.5, x[1] - 0.3), (y[0] + 0.40, y[0] + 1.10), (0.40, 0.62), "foam/red")
