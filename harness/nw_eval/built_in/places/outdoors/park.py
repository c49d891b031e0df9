"""A park: a path between lawns, trees, benches, lamps, and trees far off."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nw_eval.built_in.places.builder import PlaceBuilder
from nw_eval.built_in.places.outdoors import scenery as outdoors
from nw_eval.built_in.places.parts import Decal


@dataclass(frozen=True, kw_only=True)
class Park:
    """A straight path through lawns.

    Attributes:
        path, lawn: materials.
        width: of the path, metres.
        leaves: materials of the trees' leaves.
        lit: whether the lamps burn.
    """

    path: str = "gravel/sand"
    lawn: str = "grass/green"
    width: float = 2.8
    leaves: tuple[str, str] = ("leaves/lime", "leaves/oak")
    lit: bool = False
    indoor: bool = False

    def build(self, builder: PlaceBuilder, length: float) -> None:
        """Build the park."""
        reach = 34.0
        half = self.width / 2
        builder.ground(
            self.lawn,
            (-reach, length + reach),
            (-reach, reach),
            decals=(Decal(rect=(-reach, -half, length + reach, half), material=self.path, fine=1),),
        )
        builder.lawn((-8.0, length + 14.0), (half, 11.0), self.lawn)
        builder.lawn((-8.0, length + 14.0), (-11.0, -half), self.lawn)
        light, dark = self.leaves
        near = (
            (3.4, 3.3, 6.2, 2.0, light),
            (length + 3.5, 3.8, 7.0, 2.3, dark),
            (length + 4.6, -3.4, 6.0, 1.9, light),
            (-3.5, -3.6, 6.6, 2.1, dark),
            (1.2, -5.6, 7.2, 2.4, dark),
        )
        for index, (x, y, height, radius, leaves) in enumerate(near):
            outdoors.tree(
                builder,
                x,
                y,
                height=height,
                radius=radius,
                leaves=leaves,
                turn=1.3 * index,
                trunk=0.17,
            )
        middle = length / 2
        for index in range(26):
            angle = 2 * math.pi * (index + 0.37 * ((index * 7) % 5) / 5) / 26
            away = 22.0 + 3.0 * ((index * 5) % 4)
            if abs(math.sin(angle)) * away < 3.5:
                continue
            outdoors.tree(
                builder,
                middle + away * math.cos(angle),
                away * math.sin(angle),
                height=8.0 + 1.2 * ((index * 3) % 4),
                radius=3.0 + 0.4 * ((index * 2) % 3),
                leaves=(dark, "leaves/dark", light)[index % 3],
                far=True,
                trunk=0.3,
            )
        for index in range(18):
            angle = 2 * math.pi * (index + 0.5) / 18
            if abs(math.sin(angle)) * 30 < 3.5:
                continue
            builder.crown(
                (middle + 31 * math.cos(angle), 31 * math.sin(angle), 2.2),
                (5.5, 5.5, 3.4),
                "leaves/dark",
                kind="clutter",
                fine=1.3,
            )
        outdoors.bench(builder, 1.6, half + 0.45, facing=-1.0)
        outdoors.bench(builder, length + 0.9, -half - 0.45, facing=1.0)
        outdoors.litter_bin(builder, 2.9, half + 0.4)
        outdoors.lamp_post(builder, length + 2.4, half + 0.35, lit=self.lit)
        outdoors.lamp_post(builder, -2.5, half + 0.35, lit=self.lit)
        outdoors.bush(builder, length + 6.2, 2.4, 0.7)
        outdoors.bush(builder, 4.6, -half - 1.6, 0.55, "leaves/lime")
        outdoors.hedge(builder, (length + 7.5, length + 12.0), (-half - 1.3, -half - 0.5), 0.9)
