"""A car park: tarmac with bays, cars, kerbs, a hedge, a warehouse."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import house


@dataclass(frozen=True, kw_only=True)
class CarPark:
    """An aisle between two rows of bays.

    Attributes:
        ground: material.
        aisle: metres between the bays.
        lit: whether the lamps burn.
    """

    ground: str = "tarmac/dark"
    aisle: float = 4.6
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the car park."""
        half = self.aisle / 2
        far = length + 11.0
        depth = 4.8
        lines: list[Decal] = []
        bays = range(-2, int((far - 2.0) / 2.5))
        for bay in bays:
            x = 2.5 * bay + 0.4
            lines.append(Decal(rect=(x, half, x + 0.1, half + depth), material="stripe/white"))
            lines.append(Decal(rect=(x, -half - depth, x + 0.1, -half), material="stripe/white"))
        lines.append(Decal(rect=(length + 1.4, -0.75, length + 4.2, 0.75), material="arrow"))
        for x, y, reach in ((0.9, 1.4, 0.5), (length - 0.4, -1.3, 0.45), (4.0, -3.6, 0.6)):
            lines.append(
                Decal(rect=(x - reach, y - reach, x + reach, y + reach), material="oil_stain")
            )
        side = half + depth
        builder.ground(self.ground, (-14.0, far), (-side, side), decals=lines)
        builder.ground("grass/green", (-14.0, far + 8.0), (side, 22.0))
        builder.ground("grass/green", (-14.0, far + 8.0), (-22.0, -side))
        builder.ground("grass/green", (far, far + 8.0), (-side, side))
        for y in (side, -side - 0.15):
            builder.box((-14.0, far), (y, y + 0.15), (0.0, 0.12), "concrete/light")
        builder.box((far - 0.15, far), (-side, side), (0.0, 0.12), "concrete/light")
        cars = (
            (-2, 1, "car/silver"),
            (0, 1, "car/red"),
            (1, 1, "car/blue"),
            (3, 1, "car/white"),
            (-1, -1, "car/white"),
            (1, -1, "car/black"),
            (2, -1, "car/silver"),
            (4, -1, "car/red"),
            (5, 1, "car/silver"),
        )
        for bay, where, paint in cars:
            outdoors.car(
                builder,
                2.5 * bay + 1.7,
                where * (half + 2.55),
                paint,
                nose=float(where if bay % 2 else -where),
            )
        outdoors.hedge(builder, (-6.0, far), (side + 0.6, side + 1.4), 1.0)
        outdoors.hedge(builder, (far + 0.6, far + 1.4), (-side, side), 1.0)
        house(
            builder,
            (far + 7.0, far + 8.0),
            (-20.0, 20.0),
            6.4,
            "corrugated/blue",
            face="-x",
            pitch=5.0,
            storey=5.0,
            sill=3.0,
            size=(3.6, 1.0),
            windows="house_window/dark",
            plinth="brick/red",
            trim=None,
        )
        house(builder, (-14.0, far), (-23.0, -22.0), 7.5, "stucco/cream", face="+y", pitch=3.0)
        house(builder, (-14.0, far), (22.0, 23.0), 6.5, "brick/brown", face="-y", pitch=3.0)
        for index, x in enumerate((-8.0, -1.5, 5.0, far - 1.0)):
            outdoors.tree(
                builder,
                x,
                -side - 2.0 - (index % 2),
                height=6.0,
                radius=1.9,
                turn=1.1 * index,
                leaves=("leaves/oak", "leaves/lime")[index % 2],
            )
            outdoors.tree(
                builder,
                x + 3.0,
                side + 3.2,
                height=6.6,
                radius=2.0,
                turn=0.7 * index,
                leaves=("leaves/lime", "leaves/oak")[index % 2],
            )
        outdoors.lamp_post(builder, length + 5.5, half + 0.2, height=4.8, lit=self.lit)
        outdoors.lamp_post(builder, -3.0, -half - 0.2, height=4.8, lit=self.lit)
