"""A courtyard: brick houses round paving or grass, a tree, benches, flower beds."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import house


@dataclass(frozen=True, kw_only=True)
class Courtyard:
    """A yard closed by houses on three sides and a wall behind.

    Attributes:
        ground: material; grass grows blades.
        walls: material of the houses.
        path: whether paving runs along the trail through a grass yard's edge.
        lit: whether lamps and windows shine.
    """

    ground: str
    walls: str
    path: bool = True
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the courtyard."""
        x = (-5.0, length + 5.5)
        y = (-5.2, 5.6)
        grass = self.ground.startswith("grass")
        if grass:
            builder.ground(
                self.ground,
                x,
                y,
                decals=(
                    Decal(rect=(x[0], y[1] - 1.5, x[1], y[1]), material="slabs/grey"),
                    Decal(rect=(x[1] - 1.5, y[0], x[1], y[1]), material="slabs/grey"),
                ),
            )
            builder.lawn((x[0], x[1] - 1.5), (y[0], y[1] - 1.5), self.ground)
        else:
            beds = Decal(rect=(-1.0, y[0] + 0.2, length + 1.5, y[0] + 1.7), material="soil")
            builder.ground(self.ground, x, y, decals=(beds,))
        window = "house_window_lit" if self.lit else "house_window/white"
        length_y, length_x = y[1] - y[0], x[1] - x[0]
        house(
            builder, (x[1], x[1] + 1.0), y, 6.6, self.walls, face="-x", windows=window,
            extra=(
                Decal(
                    rect=(length_y / 2 - 0.7, 0.0, length_y / 2 + 0.7, 2.5),
                    material="doors",
                    fine=0.5,
                ),
            ),
            skip=(1, 2),
        )  # fmt: skip
        house(
            builder, x, (y[1], y[1] + 1.0), 6.6, self.walls, face="-y", windows=window, pitch=2.7,
            extra=(
                Decal(
                    rect=(length_x * 0.42, 0.0, length_x * 0.42 + 1.0, 2.2),
                    material="door/green",
                    fine=0.5,
                ),
            ),
            skip=(2,),
        )  # fmt: skip
        house(builder, x, (y[0] - 1.0, y[0]), 3.9, self.walls, face="+y", windows=window, pitch=3.0)
        builder.box((x[0] - 0.4, x[0]), y, (0.0, 2.3), self.walls, top="coping/grey",
                  kind="structure", faces=("+x", "+z"))  # fmt: skip
        outdoors.tree(builder, length + 2.6, -2.6, height=6.0, radius=1.9, turn=0.6)
        outdoors.tree(builder, x[0] - 2.5, 1.5, height=7.5, radius=2.6, turn=2.0, far=True)
        outdoors.tree(builder, x[1] + 4.0, -6.0, height=11.0, radius=3.2, turn=1.0, far=True)
        outdoors.bench(builder, 1.8, y[1] - 0.9, facing=-1.0)
        outdoors.bench(builder, length + 0.6, y[1] - 0.9, facing=-1.0)
        outdoors.litter_bin(builder, 3.2, y[1] - 0.7)
        if not grass:
            for index in range(int((length + 2.0) / 1.1)):
                outdoors.bush(builder, -0.3 + 1.1 * index, y[0] + 0.95, 0.48,
                              ("leaves/hedge", "leaves/lime")[index % 2])  # fmt: skip
        else:
            outdoors.hedge(builder, (-1.5, length + 1.0), (y[0] + 0.1, y[0] + 0.8), 0.9)
        outdoors.lamp_post(builder, length + 3.4, 2.4, height=2.9, lit=self.lit)
        outdoors.lamp_post(builder, -1.7, 3.3, height=2.9, lit=self.lit)
