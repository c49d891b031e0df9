"""Rooms that people live and work in: a room, a long corridor, an entrance hall."""

from __future__ import annotations

from dataclasses import dataclass

from nw_places.places import furniture
from nw_places.places.builder import SceneBuilder
from nw_places.places.furniture import room_shell, window_lamp
from nw_places.places.parts import Decal


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

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the room."""
        x = (-2.4, length + 2.6)
        y = (-self.width / 2, self.width / 2)
        span = x[1] - x[0]
        sill, lintel = (1.3, 2.9) if self.hall else (0.85, 2.2)
        windows = self._windows(span)
        panels = self._panels(x)
        decals = {
            "left": [
                Decal((u, sill, u + w, lintel), "window", 0.5, opening=True) for u, w in windows
            ],
            "right": self._right_wall(span),
            "far": self._far_wall(),
            "back": [Decal((0.5, 0.0, 1.45, 2.05), "door/oak", 0.6)],
            "ceiling": [
                Decal((y0 - y[0], x0 - x[0], y1 - y[0], x1 - x[0]), "lamp", 0.5)
                for x0, x1, y0, y1 in panels
            ],
        }
        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            walls=self.walls,
            far=self.accent,
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
            return [Decal((0.6, 0.15, span - 0.6, 2.5), "wall_bars", 0.6)]
        return [
            Decal((span * 0.16, 0.95, span * 0.16 + 1.9, 2.05), "whiteboard"),
            Decal((span * 0.52, 1.1, span * 0.52 + 0.6, 1.95), "poster/teal"),
            Decal((span * 0.52 + 0.75, 1.1, span * 0.52 + 1.35, 1.95), "poster/red"),
            Decal((span * 0.86, 1.25, span * 0.86 + 0.45, 1.75), "poster/ochre"),
        ]

    def _far_wall(self) -> list[Decal]:
        door = self.width * 0.66
        if self.hall:
            return [
                Decal((self.width / 2 - 1.0, 0.0, self.width / 2 + 1.0, 2.2), "doors"),
                Decal((self.width / 2 - 0.25, 2.35, self.width / 2 + 0.25, 2.55), "exit"),
            ]
        return [
            Decal((door, 0.0, door + 0.95, 2.08), "door/oak", 0.5),
            Decal((0.7, 1.0, 2.3, 2.0), "pinboard", 0.5),
            Decal((door - 0.25, 1.1, door - 0.13, 1.25), "plastic/white", 0.5),
        ]

    def _seminar(
        self,
        builder: SceneBuilder,
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

    def _hall(self, builder: SceneBuilder, x: tuple[float, float], y: tuple[float, float]) -> None:
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


@dataclass(frozen=True, kw_only=True)
class Corridor:
    """A corridor of a school or a laboratory.

    Attributes:
        floor, walls: materials.
        dado: material of the walls' lower part.
        width, height: metres.
    """

    floor: str = "linoleum/sea"
    walls: str = "plaster/white"
    dado: str = "plaster/sage"
    width: float = 2.6
    height: float = 2.6
    indoor: bool = True

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the corridor."""
        x = (-3.0, length + 7.0)
        y = (-self.width / 2, self.width / 2)
        span = x[1] - x[0]
        doors = [span * share for share in (0.1, 0.34, 0.58, 0.82)]
        middle = self.width / 2
        panels = [x[0] + 1.2 + 2.4 * index for index in range(int((span - 1.0) / 2.4))]

        def side(shift: float) -> list[Decal]:
            strip = Decal((0.0, 0.09, span, 1.05), self.dado, 1.0)
            rail = Decal((0.0, 1.05, span, 1.10), "skirting/oak", 0.8)
            signs = [Decal((u + shift + 1.1, 1.45, u + shift + 1.28, 1.57), "sign") for u in doors]
            boards = [
                Decal(
                    (u + shift + 1.7, 1.25, u + shift + 2.6, 1.95),
                    ("pinboard", "poster/teal")[index % 2],
                    0.55,
                )
                for index, u in enumerate(doors[:-1])
            ]
            leaves = [
                Decal(
                    (u + shift, 0.0, u + shift + 0.98, 2.08),
                    ("door/blue", "door/oak")[index % 2],
                    0.55,
                )
                for index, u in enumerate(doors)
            ]
            return [strip, rail, *boards, *signs, *leaves]

        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            walls=self.walls,
            ceiling="ceiling_tiles",
            skirting="skirting/grey",
            decals={
                "left": side(0.0),
                "right": side(0.5),
                "far": [
                    Decal((middle - 0.75, 0.0, middle + 0.75, 2.15), "glass_doors", 0.5),
                    Decal((middle - 0.2, 2.25, middle + 0.2, 2.42), "exit", 0.5),
                ],
                "back": [Decal((middle - 0.8, 0.0, middle + 0.8, 2.15), "doors", 0.6)],
                "ceiling": [
                    Decal(
                        (middle - 0.15, at - 0.6 - x[0], middle + 0.15, at + 0.6 - x[0]),
                        "lamp",
                        0.5,
                    )
                    for at in panels
                ],
            },
        )
        for at in panels:
            builder.lamp(
                (at - 0.6, -0.15, self.height - 0.02), (0.0, 0.3, 0.0), (1.2, 0.0, 0.0),
                (5.2, 5.1, 4.7),
            )  # fmt: skip
        window_lamp(builder, (x[1] - 0.02, 0.75, 0.05), (0.0, -1.5, 0.0), (0.0, 0.0, 2.1))
        self._furnish(builder, length, y)

    def _furnish(self, builder: SceneBuilder, length: float, y: tuple[float, float]) -> None:
        lockers = length + 1.2
        for index in range(4):
            start = lockers + 0.42 * index
            builder.box(
                (start, start + 0.40), (y[0], y[0] + 0.34), (0.0, 1.75), "locker/blue", fine=0.7
            )
        builder.box((-0.2, 0.25), (y[1] - 0.10, y[1]), (0.85, 1.45), "extinguisher", solid=False)
        furniture.plant(builder, length + 3.6, y[1] - 0.32, height=1.3)
        furniture.chair(builder, length + 1.6, y[1] - 0.35, facing=-1.0, seat="plastic/orange")
        furniture.chair(builder, length + 2.2, y[1] - 0.35, facing=-1.0)


@dataclass(frozen=True, kw_only=True)
class Lobby:
    """A hall whose far wall has doors at the height of a gallery.

    Attributes:
        gallery: height of the gallery's floor, metres; 0 for a hall without one.
        floor, walls: materials.
        accent: material of the far wall.
        deck: material of the gallery.
        flight: width that the gallery leaves free for the flight, metres.
        width, height: metres.
        beyond: from the course's end to the far wall, metres.
    """

    gallery: float = 0.0
    floor: str = "tiles/white"
    walls: str = "plaster/white"
    accent: str = "plaster/ochre"
    deck: str = "concrete/light"
    flight: float = 2.0
    width: float = 6.4
    height: float = 4.6
    beyond: float = 1.6
    indoor: bool = True

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the hall."""
        x = (-2.6, length + self.beyond)
        y = (-self.width / 2, self.width / 2)
        span = x[1] - x[0]
        windows = [(share * span - 0.8, 1.6) for share in (0.22, 0.5, 0.78)]
        middle, up = self.width / 2, self.gallery
        panels = [(x[0] + span * share, side) for share in (0.2, 0.5, 0.8) for side in (-1.6, 1.6)]
        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            walls=self.walls,
            far=self.accent,
            ceiling="ceiling_tiles",
            skirting="skirting/grey",
            decals={
                "left": [
                    Decal((u, 1.0, u + w, 3.9), "window", 0.5, opening=True)
                    for u, w in windows
                ],
                "right": [
                    Decal((span * 0.14, 1.2, span * 0.14 + 1.5, 2.2), "poster/teal"),
                    Decal((span * 0.50, 0.9, span * 0.50 + 2.0, 2.1), "pinboard"),
                ],
                "far": [
                    Decal(
                        (middle - 0.95, up, middle + 0.95, up + 2.15),
                        "doors",
                        0.5),
                    Decal(
                        (middle - 0.25, up + 2.25, middle + 0.25, up + 2.45),
                        "exit",
                        0.5),
                    Decal(
                        (0.5, up + 1.0, 1.3, up + 2.1), "poster/red", 0.55
                    ),
                ],
                "back": [
                    Decal((middle - 1.3, 0.0, middle + 1.3, 2.3), "glass_doors")
                ],
                "ceiling": [
                    Decal(
                        (side - 0.35 - y[0], at - 0.6 - x[0],
                              side + 0.35 - y[0], at + 0.6 - x[0]),
                        "lamp",
                        0.5)
                    for at, side in panels
                ],
            },
        )  # fmt: skip
        for at, side in panels:
            builder.lamp(
                (at - 0.6, side - 0.35, self.height - 0.02), (0.0, 0.7, 0.0), (1.2, 0.0, 0.0),
                (6.5, 6.3, 5.8),
            )  # fmt: skip
        for u, w in windows:
            window_lamp(builder, (x[0] + u, y[1] - 0.02, 1.0), (w, 0.0, 0.0), (0.0, 0.0, 2.9))
        self._furnish(builder, x, y, length)

    def _furnish(
        self, builder: SceneBuilder, x: tuple[float, float], y: tuple[float, float], length: float
    ) -> None:
        if self.gallery > 0.0:
            for side in (-1, 1):
                wall = y[1] if side > 0 else y[0]
                across = (min(side * self.flight / 2, wall), max(side * self.flight / 2, wall))
                builder.box(
                    (length - 0.9, x[1]), across, (0.0, self.gallery), self.deck,
                    kind="structure", faces=("-x", "+z"),
                )  # fmt: skip
                builder.box(
                    (length - 0.9, length - 0.84), across, (self.gallery, self.gallery + 0.55),
                    "metal/grey", kind="structure", fine=0.9,
                )  # fmt: skip
        desk = (-0.4, 1.4)
        builder.box(desk, (y[0] + 0.5, y[0] + 1.0), (0.0, 1.05), "veneer/beech", top="metal/dark")
        for index in range(3):
            furniture.chair(
                builder, 0.3 + 0.6 * index, y[1] - 0.4, facing=-1.0,
                seat=("plastic/navy", "plastic/orange")[index % 2],
            )  # fmt: skip
        furniture.plant(builder, -1.2, y[1] - 0.5, height=1.6)
        furniture.plant(builder, max(length - 1.6, 2.2), y[0] + 0.5, height=1.4)
