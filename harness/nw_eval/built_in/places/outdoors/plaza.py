"""A plaza: stone slabs before a modern building, planters, steps, young trees."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal
from nw_eval.built_in.places.walls import house


@dataclass(frozen=True, kw_only=True)
class Plaza:
    """A square on a campus.

    Attributes:
        ground: material of the slabs.
        building: material of the building at the far end.
        lit: whether lamps and the windows of the houses shine.
    """

    ground: str = "slabs/light"
    building: str = "panels/white"
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the plaza."""
        far = length + 9.0
        windows = "house_window_lit" if self.lit else "house_window/dark"
        builder.ground(
            self.ground,
            (-16.0, far),
            (-16.0, 16.0),
            decals=(
                Decal(rect=(-16.0, -1.9, far, -1.6), material="granite/grey", fine=1.0),
                Decal(rect=(-16.0, 1.6, far, 1.9), material="granite/grey", fine=1.0),
            ),
        )
        house(
            builder,
            (far + 1.5, far + 3.0),
            (-14.0, 14.0),
            8.4,
            self.building,
            face="-x",
            windows="curtain_wall",
            pitch=3.5,
            storey=4.0,
            sill=0.35,
            size=(3.1, 3.3),
            plinth=None,
            trim=None,
        )
        for step in range(3):
            builder.box(
                (far + 0.4 * step, far + 1.5),
                (-9.0, 9.0),
                (0.14 * step, 0.14 * (step + 1)),
                "slabs/light",
                kind="structure",
                faces=("-x", "+z", "-y", "+y"),
            )
        for column in (-7.0, -3.5, 0.0, 3.5, 7.0):
            builder.box(
                (far + 1.2, far + 1.5),
                (column - 0.15, column + 0.15),
                (0.42, 8.0),
                "concrete/light",
                kind="structure",
            )
        house(
            builder,
            (-16.0, far),
            (14.0, 15.0),
            10.5,
            "brick/red",
            face="-y",
            pitch=3.2,
            storey=3.4,
            size=(1.5, 1.7),
            windows=windows,
        )
        house(
            builder,
            (-16.0, far),
            (-16.5, -15.5),
            7.0,
            "concrete/light",
            face="+y",
            pitch=3.0,
            storey=3.4,
            size=(1.8, 1.6),
            windows=windows,
        )
        house(
            builder,
            (-17.5, -16.5),
            (-16.0, 16.0),
            9.0,
            "panels/sand",
            face="+x",
            pitch=3.2,
            windows=windows,
        )
        for x in (0.6, length + 1.6):
            outdoors.planter(builder, (x, x + 2.4), (3.0, 4.0), stone="granite/grey")
            outdoors.planter(builder, (x - 0.4, x + 2.0), (-4.2, -3.2), stone="granite/grey")
        for index, (x, y) in enumerate(
            ((4.2, 5.2), (length + 5.0, 4.6), (length + 5.4, -4.4), (-3.4, -5.0), (2.6, -6.4))
        ):
            outdoors.tree(
                builder,
                x,
                y,
                height=4.6 + 0.3 * (index % 3),
                radius=1.35,
                trunk=0.09,
                leaves="leaves/lime",
                turn=1.7 * index,
            )
        for x in (length + 3.2, length + 4.8):
            builder.box((x, x + 0.5), (-3.2, -1.4), (0.0, 0.45), "granite/grey")
        outdoors.lamp_post(builder, length + 3.6, 2.6, height=4.2, lit=self.lit)
        outdoors.lamp_post(builder, -2.0, -2.6, height=4.2, lit=self.lit)
        outdoors.litter_bin(builder, 3.4, 2.6, "metal/dark")
        for index in range(5):
            builder.prism(
                (length + 7.6, -2.4 + 1.2 * index),
                (0.0, 0.85),
                (0.055, 0.055),
                "metal/chrome",
                sides=8,
                cap="metal/dark",
            )
