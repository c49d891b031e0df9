"""Bare places under a roof: a warehouse, a workshop, an underpass."""

from __future__ import annotations

from dataclasses import dataclass

from nw_places.places import furniture
from nw_places.places.builder import ALL_FACES, SIDES, SceneBuilder, about
from nw_places.places.furniture import room_shell, window_lamp
from nw_places.places.parts import Decal

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

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the warehouse."""
        x = (-3.0, length + 4.5)
        y = (-self.width / 2, self.width / 2)
        span, middle = x[1] - x[0], self.width / 2
        lines = [
            Decal((x[0], side - 0.05, x[1], side + 0.05), "stripe/yellow", 0.7)
            for side in (-1.75, 1.75)
        ]
        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            floor_decals=lines,
            walls=self.walls,
            ceiling="corrugated/grey",
            skirting=None,
            decals={
                "far": [
                    Decal((middle - 1.7, 0.0, middle + 1.7, 3.4), "roller_door", 0.6),
                    Decal((0.4, 0.0, 1.35, 2.1), "door/green", 0.6),
                    Decal((0.65, 2.2, 1.1, 2.4), "exit", 0.5),
                ],
            },
        )
        for index in range(max(2, round(span / 3.0))):
            at = x[0] + (index + 0.5) * span / max(2, round(span / 3.0))
            builder.box(
                about(at, 0.75), (-0.12, 0.12), (self.height - 0.6, self.height - 0.52),
                "lamp", kind="overhead", solid=False, faces=ALL_FACES)  # fmt: skip
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

    def _racks(self, builder: SceneBuilder, x: tuple[float, float], side: int) -> None:
        near, far = 1.95, self.width / 2 - 0.1
        y = (side * near, side * far) if side > 0 else (side * far, side * near)
        bays = max(1, round((x[1] - x[0]) / 2.6))
        pitch = (x[1] - x[0]) / bays
        for bay in range(bays + 1):
            at = x[0] + bay * pitch
            for post in (y[0] + 0.04, y[1] - 0.04):
                builder.box(
                    about(at, 0.045), about(post, 0.04), (0.0, 3.6), self.rack,
                    kind="clutter", faces=SIDES, fine=0.9)  # fmt: skip
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
                    about(middle, 0.62), (y[0] + 0.1, y[1] - 0.1), (z, z + 0.13),
                    "planks/pallet", kind="clutter", solid=level == 0, fine=0.9)  # fmt: skip
                builder.box(
                    about(middle, 0.56), (y[0] + 0.14, y[1] - 0.14),
                    (z + 0.13, z + 0.13 + height), material, kind="clutter", solid=level == 0,
                    texture=(0.7 * bay, 0.0))  # fmt: skip


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

    def build(self, builder: SceneBuilder, length: float) -> None:
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
            walls=self.walls,
            ceiling="corrugated/grey",
            skirting=None,
            decals={
                "left": [
                    Decal((0.0, 0.0, span, 1.2), "block_wall/grey", 1.0),
                    *(
                        Decal((u, 1.9, u + 1.9, 3.2), "steel_window", 0.5, opening=True)
                        for u in windows
                    ),
                    Decal((span * 0.30, 0.95, span * 0.30 + 2.2, 1.8), "pegboard", 0.45),
                ],
                "right": [
                    Decal((0.0, 0.0, span, 1.2), "block_wall/grey", 1.0),
                    Decal((span * 0.55, 1.35, span * 0.55 + 2.4, 2.5), "pegboard", 0.45),
                    Decal((span * 0.30, 1.5, span * 0.30 + 0.7, 2.45), "poster/red"),
                ],
                "far": [
                    Decal((0.0, 0.0, self.width, 1.2), "block_wall/grey", 1.0),
                    Decal((middle - 1.6, 0.0, middle + 1.6, 2.9), "roller_door", 0.6),
                    Decal((0.35, 0.0, 1.25, 2.05), "door/blue", 0.6),
                ],
                "back": [Decal((0.0, 0.0, self.width, 1.2), "block_wall/grey")],
            },
        )
        for at, side in lamps:
            builder.box(
                about(at, 0.65),
                about(side, 0.09),
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
        self, builder: SceneBuilder, x: tuple[float, float], y: tuple[float, float]
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


@dataclass(frozen=True, kw_only=True)
class Underpass:
    """A way for people under a road.

    Attributes:
        floor, walls: materials.
        dado: material of the walls' lower part.
        mural: materials of the paintings on the left and the right.
        width, height: metres.
    """

    floor: str = "slabs/grey"
    walls: str = "concrete/light"
    dado: str = "block_wall/white"
    mural: tuple[str, str] = ("mural/teal", "mural/pink")
    width: float = 4.2
    height: float = 2.9
    indoor: bool = True

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the underpass."""
        x = (-4.0, length + 8.0)
        y = (-self.width / 2, self.width / 2)
        span, middle = x[1] - x[0], self.width / 2
        lamps = [x[0] + 1.6 + 2.8 * index for index in range(int((span - 1.2) / 2.8))]

        def side(paintings: tuple[tuple[float, float], ...], mural: str) -> list[Decal]:
            return [
                Decal((0.0, 0.0, span, 1.0), self.dado, 1.0),
                *(Decal((u, 0.35, u + w, 2.2), mural, 0.6) for u, w in paintings),
            ]

        room_shell(
            builder,
            x,
            y,
            self.height,
            floor=self.floor,
            floor_decals=(
                Decal((x[0], y[0], x[1], y[0] + 0.25), "gutter/grey"),
                Decal((x[0], y[1] - 0.25, x[1], y[1]), "gutter/grey"),
                Decal((length + 0.7, -0.25, length + 1.2, 0.25), "drain", 0.5),
            ),
            walls=self.walls,
            ceiling="concrete/grey",
            skirting=None,
            decals={
                "left": side(((3.0, 3.4), (9.5, 2.8)), self.mural[0]),
                "right": side(((5.2, 3.0), (11.5, 3.2)), self.mural[1]),
                "far": [Decal((0.25, 0.0, self.width - 0.25, self.height - 0.35), "portal", 0.6)],
                "back": [Decal((middle - 1.2, 0.0, middle + 1.2, 2.3), "roller_door")],
                "ceiling": [
                    Decal((edge - 0.12, at - 0.7 - x[0], edge + 0.12, at + 0.7 - x[0]), "lamp", 0.5)
                    for at in lamps
                    for edge in (0.5, self.width - 0.5)
                ],
            },
        )
        for at in lamps:
            for edge in (y[0] + 0.5, y[1] - 0.5):
                builder.lamp(
                    (at - 0.7, edge - 0.12, self.height - 0.02), (0.0, 0.24, 0.0), (1.4, 0.0, 0.0),
                    (6.0, 5.8, 5.2),
                )  # fmt: skip
        window_lamp(
            builder, (x[1] - 0.02, middle - 0.25, 0.05), (0.0, -self.width + 0.5, 0.0),
            (0.0, 0.0, self.height - 0.4),
        )  # fmt: skip
        for at in (1.8, length + 2.6):
            builder.box(
                (at, at + 1.6), (y[1] - 0.55, y[1] - 0.12), (0.0, 0.45), "concrete/light", fine=0.9
            )
        builder.prism((length + 3.4, y[0] + 0.35), (0.0, 0.85), (0.2, 0.21), "metal/green",
                    sides=10, cap="metal/black")  # fmt: skip
