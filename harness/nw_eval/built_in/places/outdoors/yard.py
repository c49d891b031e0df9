"""A container yard: stacks of steel boxes, drums, light masts, a crane's legs."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.indoors import furniture
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import house

_COLOURS = ("red", "blue", "green", "yellow", "grey")


@dataclass(frozen=True, kw_only=True)
class Yard:
    """A lane between stacked containers.

    Attributes:
        ground: material.
        lane: metres between the stacks.
        shift: turns the order of colours.
        lit: whether the masts' lamps burn.
    """

    ground: str = "concrete/worn"
    lane: float = 5.0
    shift: int = 0
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the yard."""
        x = (-9.0, length + 12.0)
        half = self.lane / 2
        edges = [
            Decal(rect=(x[0], y - 0.06, x[1], y + 0.06), material="stripe/yellow", fine=0.8)
            for y in (-half + 0.35, half - 0.35)
        ]
        stains = [
            Decal(rect=(at - 0.5, y - 0.5, at + 0.5, y + 0.5), material="oil_stain")
            for at, y in ((1.5, -1.4), (length + 2.2, 1.0))
        ]
        builder.ground(self.ground, x, (-14.0, 14.0), decals=(*edges, *stains))
        for side in (-1, 1):
            near, far = sorted((side * half, side * (half + 2.44)))
            # The left row starts earlier, so that the stacks' ends do not stand side by side.
            start = x[0] + (0.0 if side > 0 else 2.7)
            for index in range(int((x[1] - 4.0 - start) / 6.3)):
                low = start + 6.3 * index
                for level in range(1 + (index + (side > 0)) % 2):
                    colour = _COLOURS[(self.shift + 2 * index + level + (side > 0)) % len(_COLOURS)]
                    self._container(
                        builder, (low, low + 6.06), (near, far), 2.6 * level, colour, side
                    )
        house(
            builder, (x[1] + 2.0, x[1] + 3.0), (-14.0, 14.0), 7.0, "corrugated/grey", face="-x",
            pitch=4.6, storey=6.0, sill=3.6, size=(2.4, 1.1), windows="house_window/dark",
            plinth="brick/red", trim=None,
            extra=(Decal(rect=(12.0, 0.0, 16.0, 4.2), material="roller_door", fine=0.7),),
        )  # fmt: skip
        house(builder, (x[0] - 3.0, x[0] - 2.0), (-14.0, 14.0), 6.0, "corrugated/blue", face="+x",
              pitch=4.6, storey=5.0, windows="house_window/dark", trim=None)  # fmt: skip
        outdoors.lamp_post(builder, length + 2.6, half - 0.6, height=5.0, lit=self.lit)
        outdoors.lamp_post(builder, -1.8, -half + 0.5, height=5.0, lit=self.lit)
        for index, colour in enumerate(("metal/blue", "metal/red", "metal/yellow")):
            furniture.drum(builder, length + 3.4 + 0.66 * index, -half + 0.5, colour)
        for level in range(5):
            builder.box((length + 1.6, length + 2.8), (half - 1.05, half - 0.05),
                      (0.14 * level, 0.14 * level + 0.13), "planks/pallet", fine=0.9)  # fmt: skip

    def _container(
        self,
        builder: PlaceBuilder,
        x: tuple[float, float],
        y: tuple[float, float],
        z: float,
        colour: str,
        side: int,
    ) -> None:
        face = "-y" if side > 0 else "+y"
        length = x[1] - x[0]
        frame = [
            Decal(rect=(0.0, 0.0, length, 0.16), material="metal/dark", fine=0.9),
            Decal(rect=(0.0, 2.46, length, 2.6), material="metal/dark", fine=0.9),
            Decal(rect=(0.0, 0.16, 0.14, 2.46), material="metal/grey", fine=0.9),
            Decal(rect=(length - 0.14, 0.16, length, 2.46), material="metal/grey", fine=0.9),
            Decal(rect=(0.9, 1.75, 1.9, 2.25), material="sign", fine=0.7),
        ]
        builder.box(
            x, y, (z, z + 2.6), f"corrugated/{colour}", top="metal/grey", kind="structure",
            faces=("-x", "+x", face), decals={face: frame}, solid=z == 0.0,
        )  # fmt: skip
