"""A workshop: concrete floor, benches, tools, racks, drums and a roller door."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.indoors import furniture
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import room_shell, window_lamp


@dataclass(frozen=True, kw_only=True)
class Workshop:
    """A machine shop with high windows.

    Attributes:
        floor, walls: materials.
        width, height: metres.
    """

    floor: str = "concrete/worn"
    walls: str = "block_wall/white"
    width: float = 7.0
    height: float = 3.8
    indoor: bool = True

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the workshop."""
        x = (-2.4, length + 3.0)
        y = (-self.width / 2, self.width / 2)
        span = x[1] - x[0]
        count = max(2, int(span / 2.8))
        pitch = span / count
        windows = [pitch * (index + 0.5) - 0.95 for index in range(count)]
        lamps = [
            (x[0] + pitch * (index + 0.5), side) for index in range(count) for side in (-1.6, 1.6)
        ]
        middle = self.width / 2
        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            walls=dict.fromkeys(("left", "right", "far", "back"), self.walls),
            ceiling="corrugated/grey",
            skirting=None,
            decals={
                "left": [
                    Decal(rect=(0.0, 0.0, span, 1.2), material="block_wall/grey", fine=1.0),
                    *(
                        Decal(
                            rect=(u, 1.9, u + 1.9, 3.2),
                            material="steel_window",
                            fine=0.5,
                            opening=True,
                        )
                        for u in windows
                    ),
                    Decal(
                        rect=(span * 0.30, 0.95, span * 0.30 + 2.2, 1.8),
                        material="pegboard",
                        fine=0.45,
                    ),
                ],
                "right": [
                    Decal(rect=(0.0, 0.0, span, 1.2), material="block_wall/grey", fine=1.0),
                    Decal(
                        rect=(span * 0.55, 1.35, span * 0.55 + 2.4, 2.5),
                        material="pegboard",
                        fine=0.45,
                    ),
                    Decal(rect=(span * 0.30, 1.5, span * 0.30 + 0.7, 2.45), material="poster/red"),
                ],
                "far": [
                    Decal(rect=(0.0, 0.0, self.width, 1.2), material="block_wall/grey", fine=1.0),
                    Decal(
                        rect=(middle - 1.6, 0.0, middle + 1.6, 2.9),
                        material="roller_door",
                        fine=0.6,
                    ),
                    Decal(rect=(0.35, 0.0, 1.25, 2.05), material="door/blue", fine=0.6),
                ],
                "back": [Decal(rect=(0.0, 0.0, self.width, 1.2), material="block_wall/grey")],
            },
        )
        for at, side in lamps:
            builder.box(
                (at - 0.65, at + 0.65),
                (side - 0.09, side + 0.09),
                (3.10, 3.16),
                "lamp",
                kind="overhead",
                solid=False,
                faces=("-x", "+x", "-y", "+y", "-z"),
            )
            builder.lamp(
                (at - 0.65, side - 0.09, 3.09), (0.0, 0.18, 0.0), (1.3, 0.0, 0.0), (9.5, 9.4, 9.0)
            )
        for u in windows:
            window_lamp(builder, (x[0] + u, y[1] - 0.02, 1.9), (1.9, 0.0, 0.0), (0.0, 0.0, 1.3))
        self._furnish(builder, x, y)

    def _furnish(
        self, builder: PlaceBuilder, x: tuple[float, float], y: tuple[float, float]
    ) -> None:
        start = x[0] + (x[1] - x[0]) * 0.30
        furniture.table(
            builder, (start, start + 2.4), (y[1] - 0.8, y[1] - 0.05), top="planks/worn", height=0.9
        )
        furniture.crate(
            builder, (start + 0.3, start + 0.8), (y[1] - 0.6, y[1] - 0.2), (0.9, 1.15), "metal/red"
        )
        furniture.crate(
            builder,
            (start + 1.5, start + 1.75),
            (y[1] - 0.55, y[1] - 0.25),
            (0.9, 1.2),
            "metal/blue",
        )
        rack = x[1] - 3.4
        for shelf in (0.05, 0.75, 1.45):
            builder.box(
                (rack, rack + 2.4), (y[0] + 0.05, y[0] + 0.65), (shelf, shelf + 0.05), "metal/blue"
            )
        for post in (rack, rack + 2.35):
            for side in (y[0] + 0.05, y[0] + 0.6):
                builder.box((post, post + 0.05), (side, side + 0.05), (0.0, 2.1), "metal/blue")
        boxes = (
            (0.15, 0.60, 0.10, 0.45, "cardboard"),
            (0.75, 1.15, 0.10, 0.35, "plastic/orange"),
            (1.35, 2.05, 0.10, 0.55, "planks/pallet"),
            (0.20, 0.75, 0.80, 1.20, "plastic/navy"),
            (0.95, 1.45, 0.80, 1.10, "cardboard"),
            (1.60, 2.10, 0.80, 1.25, "cardboard"),
            (0.40, 1.10, 1.50, 1.90, "cardboard"),
            (1.40, 1.90, 1.50, 1.80, "plastic/orange"),
        )
        for low, high, z0, z1, material in boxes:
            builder.box(
                (rack + low, rack + high),
                (y[0] + 0.12, y[0] + 0.55),
                (z0, z1),
                material,
                solid=False,
            )
        for index, colour in enumerate(("metal/blue", "metal/red", "metal/green")):
            furniture.drum(builder, 0.4 + 0.66 * index, y[0] + 0.45, colour)
        furniture.crate(builder, (2.9, 3.7), (y[0] + 0.15, y[0] + 0.95), (0.0, 0.6))
        furniture.crate(builder, (3.0, 3.6), (y[0] + 0.25, y[0] + 0.8), (0.6, 1.05), "cardboard")
        furniture.drum(builder, x[1] - 0.5, y[1] - 0.6, "metal/yellow")
        builder.box(
            (x[1] - 2.2, x[1] - 1.0), (y[1] - 0.9, y[1] - 0.1), (0.0, 0.14), "planks/pallet"
        )
