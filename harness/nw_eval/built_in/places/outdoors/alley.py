"""An alley between brick houses: tarmac, doors, drainpipes, rubbish containers, cables."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import house


@dataclass(frozen=True, kw_only=True)
class Alley:
    """A lane as wide as a cart.

    Attributes:
        left, right: materials of the houses.
        ground: material between the gutters.
        width: metres.
        lit: whether windows shine, and a lantern over a door.
    """

    left: str = "brick/brown"
    right: str = "brick/yellow"
    ground: str = "tarmac/old"
    width: float = 3.6
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the alley."""
        x = (-7.0, length + 9.0)
        half = self.width / 2
        span = x[1] - x[0]
        builder.ground(
            self.ground,
            (x[0] - 3.0, x[1] + 8.0),
            (-9.0, 9.0),
            decals=(
                Decal(rect=(x[0], half - 0.32, x[1], half), material="gutter/grey"),
                Decal(rect=(x[0], -half, x[1], -half + 0.32), material="gutter/grey"),
                Decal(rect=(length + 0.6, -0.25, length + 1.1, 0.25), material="drain", fine=0.5),
                Decal(rect=(x[1] + 1.0, -9.0, x[1] + 2.4, 9.0), material="slabs/grey"),
            ),
        )
        windows = "house_window_lit" if self.lit else "house_window/white"
        left_doors = (
            Decal(rect=(span * 0.46, 0.0, span * 0.46 + 1.0, 2.15), material="door/green"),
            Decal(rect=(span * 0.72, 0.0, span * 0.72 + 2.3, 2.3), material="roller_door"),
        )
        right_doors = (
            Decal(rect=(span * 0.30, 0.0, span * 0.30 + 1.0, 2.15), material="door/blue"),
            Decal(rect=(span * 0.55, 0.3, span * 0.55 + 1.6, 1.9), material="mural/teal", fine=0.6),
        )
        house(builder, x, (half, half + 1.0), 6.8, self.left, face="-y", other_faces=("+x",),
              pitch=2.6, sill=1.3, size=(0.95, 1.25), extra=left_doors, skip=(2, 3, 4),
              windows=windows)  # fmt: skip
        house(builder, x, (-half - 1.0, -half), 5.9, self.right, face="+y", other_faces=("+x",),
              pitch=3.1, sill=1.35, size=(0.9, 1.2), extra=right_doors, skip=(1, 2, 3),
              windows=windows)  # fmt: skip
        house(builder, (x[1] + 6.0, x[1] + 7.0), (-9.0, 9.0), 7.6, "stucco/cream", face="-x",
              pitch=2.4, roof="roof/tile")  # fmt: skip
        house(builder, (x[0] - 4.0, x[0] - 3.0), (-9.0, 9.0), 6.0, "stucco/ochre", face="+x",
              pitch=2.4)  # fmt: skip
        for at in (2.4, length + 4.4):
            builder.prism((at, half - 0.06), (0.0, 6.6), (0.05, 0.05), "metal/grey", sides=8)
        builder.prism((length + 0.2, -half + 0.06), (0.0, 5.7), (0.05, 0.05), "metal/grey", sides=8)
        outdoors.dumpster(builder, (length + 1.5, length + 3.1), (-half + 0.05, -half + 0.85))
        outdoors.dumpster(
            builder, (length + 3.4, length + 4.6), (-half + 0.05, -half + 0.75), "metal/blue"
        )
        for low, high, z in ((0.0, 0.55, 0.45), (0.6, 1.0, 0.3), (0.1, 0.5, 0.8)):
            start = length + 2.0
            builder.box((start + low, start + high), (half - 0.55, half - 0.08),
                      (0.45 if z > 0.5 else 0.0, z), "cardboard")  # fmt: skip
        builder.box((1.2, 1.26), (half - 0.42, half - 0.02), (2.6, 3.1), "sign_board",
                  kind="overhead", solid=False)  # fmt: skip
        builder.box((3.0, 3.8), (-half, -half + 0.35), (2.9, 3.5), "metal/grey", kind="overhead",
                  solid=False, faces=("-x", "+x", "+y", "-z", "+z"))  # fmt: skip
        outdoors.lamp_post(builder, x[1] + 2.0, 1.5, lit=self.lit)
        if self.lit:
            for at, side in ((0.8, 1), (length + 0.8, -1)):
                outdoors.wall_lamp(builder, at, side * half, side)
        outdoors.tree(builder, x[1] + 4.2, -3.4, height=5.5, radius=1.7, turn=0.4)
        outdoors.car(builder, x[1] + 4.0, 3.6, "car/red", nose=-1.0)
