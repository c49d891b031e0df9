"""An entrance hall: tall, with a gallery at its end that a flight of stairs leads to."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.indoors import furniture
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import room_shell, window_lamp


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
        beyond: from the trail's end to the far wall, metres.
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

    def build(self, builder: PlaceBuilder, length: float) -> None:
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
            walls={
                "left": self.walls,
                "right": self.walls,
                "far": self.accent,
                "back": self.walls,
            },
            ceiling="ceiling_tiles",
            skirting="skirting/grey",
            decals={
                "left": [
                    Decal(rect=(u, 1.0, u + w, 3.9), material="window", fine=0.5, opening=True)
                    for u, w in windows
                ],
                "right": [
                    Decal(rect=(span * 0.14, 1.2, span * 0.14 + 1.5, 2.2), material="poster/teal"),
                    Decal(rect=(span * 0.50, 0.9, span * 0.50 + 2.0, 2.1), material="pinboard"),
                ],
                "far": [
                    Decal(
                        rect=(middle - 0.95, up, middle + 0.95, up + 2.15),
                        material="doors",
                        fine=0.5,
                    ),
                    Decal(
                        rect=(middle - 0.25, up + 2.25, middle + 0.25, up + 2.45),
                        material="exit",
                        fine=0.5,
                    ),
                    Decal(
                        rect=(0.5, up + 1.0, 1.3, up + 2.1), material="poster/red", fine=0.55
                    ),
                ],
                "back": [
                    Decal(rect=(middle - 1.3, 0.0, middle + 1.3, 2.3), material="glass_doors")
                ],
                "ceiling": [
                    Decal(
                        rect=(side - 0.35 - y[0], at - 0.6 - x[0],
                              side + 0.35 - y[0], at + 0.6 - x[0]),
                        material="lamp",
                        fine=0.5,
                    )
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
        self, builder: PlaceBuilder, x: tuple[float, float], y: tuple[float, float], length: float
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
