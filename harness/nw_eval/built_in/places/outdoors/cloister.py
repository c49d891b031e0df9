"""A cloister: a vaultless walk between a wall and columns, a garden beyond them."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import house


@dataclass(frozen=True, kw_only=True)
class Cloister:
    """A covered walk along a green court.

    Attributes:
        floor: material of the walk.
        walls: material of the houses.
        columns: material.
        width: of the walk, metres.
        lit: whether lanterns burn on the wall.
    """

    floor: str = "slabs/sand"
    walls: str = "stucco/cream"
    columns: str = "slabs/light"
    width: float = 4.4
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the cloister."""
        x = (-5.5, length + 6.0)
        half = self.width / 2
        court = -half - 9.0
        builder.ground(self.floor, x, (-half, half))
        builder.ground("grass/green", x, (court, -half))
        builder.lawn(x, (court + 4.0, -half - 0.1), "grass/green")
        span = x[1] - x[0]
        windows = "house_window_lit" if self.lit else "house_window/dark"
        house(
            builder, x, (half, half + 1.0), 3.4, self.walls, face="-y", windows=windows, pitch=2.6,
            sill=1.1, size=(0.9, 1.4), skip=(2,), trim=None,
            extra=(Decal(rect=(span * 0.44, 0.0, span * 0.44 + 1.1, 2.2), material="door/oak",
                         fine=0.5),),
        )  # fmt: skip
        # The roof over the walk: planks below, tiles above, a beam on the columns.
        builder.box(
            x, (-half - 0.3, half), (3.2, 3.4), "planks/worn", top="roof/tile", kind="overhead",
            solid=False, faces=("-y", "-z", "+x", "-x"), fine=1.3,
        )  # fmt: skip
        builder.box(
            x, (-half - 0.2, -half + 0.2), (2.75, 3.2), self.columns, kind="overhead",
            solid=False, faces=("-y", "+y", "-z"),
        )  # fmt: skip
        for index in range(int(span / 2.3)):
            at = x[0] + 0.8 + 2.3 * index
            builder.box(
                (at - 0.22, at + 0.22), (-half - 0.22, -half + 0.22), (0.0, 0.35), self.columns,
                kind="structure",
            )  # fmt: skip
            builder.box(
                (at - 0.13, at + 0.13), (-half - 0.13, -half + 0.13), (0.35, 2.75), self.columns,
                kind="structure", faces=(),
            )  # fmt: skip
            builder.prism(
                (at, -half), (0.35, 2.75), (0.17, 0.15), self.columns, sides=12, kind="structure"
            )
        middle = half + 1.0
        house(
            builder, (x[1], x[1] + 1.0), (court, middle), 6.2, self.walls, face="-x",
            windows=windows, pitch=2.7, skip=(0, 1),
            extra=(Decal(rect=(middle - 0.9, 0.0, middle + 0.9, 2.4), material="doors", fine=0.5),),
        )  # fmt: skip
        house(builder, (x[0] - 1.0, x[0]), (court, middle), 6.2, self.walls, face="+x",
              windows=windows, pitch=2.7)  # fmt: skip
        house(builder, x, (court - 1.0, court), 6.2, self.walls, face="+y", windows=windows,
              roof="roof/tile", pitch=2.6)  # fmt: skip
        outdoors.tree(builder, length + 1.0, court + 3.4, height=5.6, radius=1.9, turn=0.5)
        outdoors.tree(builder, 0.5, court + 2.8, height=5.0, radius=1.7, turn=1.9)
        outdoors.hedge(builder, (0.0, length + 2.0), (-half - 3.4, -half - 2.8), 0.6)
        outdoors.bench(builder, 2.0, half - 0.45, facing=-1.0)
        outdoors.bench(builder, length + 2.6, half - 0.45, facing=-1.0)
        if self.lit:
            for at in (0.6, length * 0.6, length + 3.0):
                outdoors.wall_lamp(builder, at, half, 1, height=2.2)
