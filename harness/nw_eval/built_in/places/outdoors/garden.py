"""A back garden: lawn, timber fence, shed, flower beds, the house at its end."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import house


@dataclass(frozen=True, kw_only=True)
class Garden:
    """A garden behind a house.

    Attributes:
        path: material of the path and the terrace.
        lawn: material beside it.
        walls: material of the house.
        fence: material.
        lit: whether the house's windows and a lantern shine.
    """

    path: str = "slabs/sand"
    lawn: str = "grass/green"
    walls: str = "brick/red"
    fence: str = "planks/worn"
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the garden."""
        x = (-4.2, length + 6.0)
        y = (-4.4, 4.4)
        half = 1.3
        terrace = x[1] - 2.2
        builder.ground(
            self.lawn,
            x,
            y,
            decals=(
                Decal(rect=(x[0] + 2.4, -half, terrace, half), material=self.path, fine=1.0),
                Decal(rect=(terrace, y[0], x[1], y[1]), material=self.path, fine=1.0),
                Decal(rect=(x[0], y[1] - 1.1, terrace, y[1]), material="soil", fine=1.0),
            ),
        )
        builder.lawn((x[0] + 2.4, terrace), (half, y[1] - 1.1), self.lawn)
        builder.lawn((x[0] + 2.4, terrace), (y[0], -half), self.lawn)
        for side, inside in ((y[1], "-y"), (y[0] - 0.06, "+y")):
            builder.box((x[0], x[1]), (side, side + 0.06), (0.0, 1.8), self.fence,
                      kind="structure", faces=(inside, "+z"))  # fmt: skip
            for index in range(int((x[1] - x[0]) / 2.0) + 1):
                post = x[0] + 2.0 * index
                inner = -0.05 if side > 0 else 0.11
                builder.box(
                    (post - 0.05, post + 0.05),
                    (side + min(inner, 0.0), side + max(inner, 0.06)),
                    (0.0, 1.95),
                    "timber/brown",
                    kind="structure",
                    fine=0.9,
                )
        builder.box((x[0] - 0.06, x[0]), y, (0.0, 1.8), self.fence, kind="structure",
                  faces=("+x", "+z"))  # fmt: skip
        windows = "house_window_lit" if self.lit else "house_window/white"
        middle = (y[1] - y[0]) / 2
        house(
            builder, (x[1], x[1] + 1.0), (y[0] - 1.0, y[1] + 1.0), 6.2, self.walls, face="-x",
            windows=windows, pitch=2.1, storey=2.9, skip=(2,), roof="roof/tile",
            extra=(
                Decal(rect=(middle + 0.2, 0.0, middle + 2.0, 2.2), material="glass_doors",
                      fine=0.5),
            ),
        )  # fmt: skip
        self._plant(builder, x, y, terrace)
        if self.lit:
            outdoors.lamp_post(builder, terrace + 0.3, 2.4, height=2.4, lit=True)
            outdoors.lamp_post(builder, -1.5, -2.0, height=2.2, lit=True)

    def _plant(
        self, builder: PlaceBuilder, x: tuple[float, float], y: tuple[float, float], terrace: float
    ) -> None:
        count = int((terrace - x[0]) / 0.9)
        for index in range(count):
            outdoors.bush(
                builder, x[0] + 0.6 + 0.9 * index, y[1] - 0.55, (0.42, 0.34, 0.48)[index % 3],
                ("leaves/hedge", "leaves/lime", "leaves/autumn")[index % 3],
            )  # fmt: skip
        outdoors.tree(builder, 2.6, y[0] + 1.0, height=4.4, radius=1.4, trunk=0.1, turn=0.9)
        outdoors.tree(builder, x[0] - 2.5, 3.0, height=7.0, radius=2.4, turn=2.2, far=True)
        outdoors.tree(builder, 3.0, y[1] + 3.4, height=6.5, radius=2.2, turn=0.2, far=True)
        outdoors.tree(builder, 5.0, y[0] - 3.6, height=7.5, radius=2.5, turn=1.2, far=True)
        # A shed with a door, beside the terrace.
        builder.box(
            (terrace - 2.3, terrace - 0.3), (y[0] + 0.15, y[0] + 1.75), (0.0, 2.0), "planks/pine",
            top="metal/dark", kind="structure",
            decals={"+y": (Decal(rect=(0.6, 0.0, 1.4, 1.8), material="door/green", fine=0.6),)},
        )  # fmt: skip
        outdoors.bench(builder, terrace - 1.6, y[1] - 1.45, facing=-1.0)
        for at, radius in ((terrace + 0.5, 0.24), (terrace + 1.1, 0.2)):
            builder.box((at - 0.14, at + 0.14), (y[1] - 0.84, y[1] - 0.56), (0.0, 0.3), "clay",
                      top="soil", fine=0.9)  # fmt: skip
            builder.crown((at, y[1] - 0.7, 0.48), (radius, radius, radius), "leaves/lime",
                        kind="clutter")  # fmt: skip
