"""A warehouse: an aisle between racks of pallets, a roller door at its end."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import ALL_FACES, PlaceBuilder
from nw_eval.built_in.places.indoors import furniture
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import room_shell

# What lies on the pallets, rack by rack.
_LOADS = (
    ("cardboard", 0.85),
    ("plastic/navy", 0.60),
    ("cardboard", 1.05),
    ("planks/pallet", 0.75),
    ("plastic/orange", 0.50),
    ("cardboard", 0.70),
    ("metal/green", 0.80),
)


@dataclass(frozen=True, kw_only=True)
class Warehouse:
    """An aisle of a store.

    Attributes:
        floor, walls: materials.
        rack: material of the uprights' beams.
        width, height: metres.
    """

    floor: str = "concrete/grey"
    walls: str = "corrugated/grey"
    rack: str = "metal/blue"
    width: float = 7.0
    height: float = 5.2
    indoor: bool = True

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the warehouse."""
        x = (-3.0, length + 4.5)
        y = (-self.width / 2, self.width / 2)
        span, middle = x[1] - x[0], self.width / 2
        lines = [
            Decal(rect=(x[0], side - 0.05, x[1], side + 0.05), material="stripe/yellow", fine=0.7)
            for side in (-1.75, 1.75)
        ]
        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            floor_decals=lines,
            walls=dict.fromkeys(("left", "right", "far", "back"), self.walls),
            ceiling="corrugated/grey",
            skirting=None,
            decals={
                "far": [
                    Decal(
                        rect=(middle - 1.7, 0.0, middle + 1.7, 3.4),
                        material="roller_door",
                        fine=0.6,
                    ),
                    Decal(rect=(0.4, 0.0, 1.35, 2.1), material="door/green", fine=0.6),
                    Decal(rect=(0.65, 2.2, 1.1, 2.4), material="exit", fine=0.5),
                ],
            },
        )
        for index in range(max(2, round(span / 3.0))):
            at = x[0] + (index + 0.5) * span / max(2, round(span / 3.0))
            builder.box(
                (at - 0.75, at + 0.75), (-0.12, 0.12), (self.height - 0.6, self.height - 0.52),
                "lamp", kind="overhead", solid=False, faces=ALL_FACES,
            )  # fmt: skip
            builder.lamp(
                (at - 0.75, -0.12, self.height - 0.61), (0.0, 0.24, 0.0), (1.5, 0.0, 0.0),
                (22.0, 21.6, 20.4),
            )  # fmt: skip
        for side in (-1, 1):
            self._racks(builder, (x[0] + 0.4, length + 2.6), side)
        furniture.drum(builder, x[1] - 0.7, y[0] + 0.6, "metal/red")
        furniture.drum(builder, x[1] - 1.4, y[0] + 0.6, "metal/blue")
        for level in range(4):
            builder.box(
                (x[1] - 1.5, x[1] - 0.3), (y[1] - 1.3, y[1] - 0.3),
                (0.14 * level, 0.14 * level + 0.13), "planks/pallet", fine=0.9,
            )  # fmt: skip

    def _racks(self, builder: PlaceBuilder, x: tuple[float, float], side: int) -> None:
        near, far = 1.95, self.width / 2 - 0.1
        y = (side * near, side * far) if side > 0 else (side * far, side * near)
        bays = max(1, round((x[1] - x[0]) / 2.6))
        pitch = (x[1] - x[0]) / bays
        for bay in range(bays + 1):
            at = x[0] + bay * pitch
            for post in (y[0] + 0.04, y[1] - 0.04):
                builder.box(
                    (at - 0.045, at + 0.045), (post - 0.04, post + 0.04), (0.0, 3.6), self.rack,
                    kind="clutter", faces=("-x", "+x", "-y", "+y"), fine=0.9,
                )  # fmt: skip
        for level, z in enumerate((1.35, 2.65)):
            face = y[0] if side > 0 else y[1] - 0.06
            builder.box(
                (x[0], x[1]), (face, face + 0.06), (z, z + 0.13), "metal/yellow",
                kind="clutter", solid=False, faces=ALL_FACES, fine=0.9,
            )  # fmt: skip
            builder.box(
                (x[0], x[1]), y, (z + 0.13, z + 0.16), "planks/worn", kind="clutter",
                solid=level == 0, faces=ALL_FACES,
            )  # fmt: skip
        for bay in range(bays):
            for level, z in enumerate((0.0, 1.51, 2.81)):
                material, height = _LOADS[(2 * bay + 3 * level + (side > 0)) % len(_LOADS)]
                middle = x[0] + (bay + 0.5) * pitch
                builder.box(
                    (middle - 0.62, middle + 0.62), (y[0] + 0.1, y[1] - 0.1), (z, z + 0.13),
                    "planks/pallet", kind="clutter", solid=level == 0, fine=0.9,
                )  # fmt: skip
                builder.box(
                    (middle - 0.56, middle + 0.56), (y[0] + 0.14, y[1] - 0.14),
                    (z + 0.13, z + 0.13 + height), material, kind="clutter", solid=level == 0,
                    texture=(0.7 * bay, 0.0),
                )  # fmt: skip
