"""Places under the sky with something green: a back garden, a park, a courtyard, a cloister."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nw_places.places import scenery as outdoors
from nw_places.places.builder import SceneBuilder, about
from nw_places.places.parts import Decal
from nw_places.places.scenery import house


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

    def build(self, builder: SceneBuilder, length: float) -> None:
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
                Decal((x[0] + 2.4, -half, terrace, half), self.path, 1.0),
                Decal((terrace, y[0], x[1], y[1]), self.path, 1.0),
                Decal((x[0], y[1] - 1.1, terrace, y[1]), "soil", 1.0),
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
                    about(post, 0.05),
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
                Decal((middle + 0.2, 0.0, middle + 2.0, 2.2), "glass_doors",
                      0.5),
            ),
        )  # fmt: skip
        self._plant(builder, x, y, terrace)
        if self.lit:
            outdoors.lamp_post(builder, terrace + 0.3, 2.4, height=2.4, lit=True)
            outdoors.lamp_post(builder, -1.5, -2.0, height=2.2, lit=True)

    def _plant(
        self, builder: SceneBuilder, x: tuple[float, float], y: tuple[float, float], terrace: float
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
            decals={"+y": (Decal((0.6, 0.0, 1.4, 1.8), "door/green", 0.6),)},
        )  # fmt: skip
        outdoors.bench(builder, terrace - 1.6, y[1] - 1.45, facing=-1.0)
        for at, radius in ((terrace + 0.5, 0.24), (terrace + 1.1, 0.2)):
            builder.box(about(at, 0.14), (y[1] - 0.84, y[1] - 0.56), (0.0, 0.3), "clay",
                      top="soil", fine=0.9)  # fmt: skip
            builder.crown((at, y[1] - 0.7, 0.48), (radius, radius, radius), "leaves/lime",
                        kind="clutter")  # fmt: skip


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

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the park."""
        reach = 34.0
        half = self.width / 2
        builder.ground(
            self.lawn,
            (-reach, length + reach),
            (-reach, reach),
            decals=(Decal((-reach, -half, length + reach, half), self.path, 1),),
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


@dataclass(frozen=True, kw_only=True)
class Courtyard:
    """A yard closed by houses on three sides and a wall behind.

    Attributes:
        ground: material; grass grows blades.
        walls: material of the houses.
        path: whether paving runs along the course through a grass yard's edge.
        lit: whether lamps and windows shine.
    """

    ground: str
    walls: str
    path: bool = True
    lit: bool = False
    indoor: bool = False

    def build(self, builder: SceneBuilder, length: float) -> None:
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
                    Decal((x[0], y[1] - 1.5, x[1], y[1]), "slabs/grey"),
                    Decal((x[1] - 1.5, y[0], x[1], y[1]), "slabs/grey"),
                ),
            )
            builder.lawn((x[0], x[1] - 1.5), (y[0], y[1] - 1.5), self.ground)
        else:
            beds = Decal((-1.0, y[0] + 0.2, length + 1.5, y[0] + 1.7), "soil")
            builder.ground(self.ground, x, y, decals=(beds,))
        window = "house_window_lit" if self.lit else "house_window/white"
        length_y, length_x = y[1] - y[0], x[1] - x[0]
        house(
            builder, (x[1], x[1] + 1.0), y, 6.6, self.walls, face="-x", windows=window,
            extra=(
                Decal(
                    (length_y / 2 - 0.7, 0.0, length_y / 2 + 0.7, 2.5),
                    "doors",
                    0.5),
            ),
            skip=(1, 2),
        )  # fmt: skip
        house(
            builder, x, (y[1], y[1] + 1.0), 6.6, self.walls, face="-y", windows=window, pitch=2.7,
            extra=(
                Decal(
                    (length_x * 0.42, 0.0, length_x * 0.42 + 1.0, 2.2),
                    "door/green",
                    0.5),
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

    def build(self, builder: SceneBuilder, length: float) -> None:
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
            extra=(Decal((span * 0.44, 0.0, span * 0.44 + 1.1, 2.2), "door/oak",
                         0.5),),
        )  # fmt: skip
        # The roof over the walk: planks below, tiles above, a beam on the columns.
        builder.box(
            x, (-half - 0.3, half), (3.2, 3.4), "planks/worn", top="roof/tile", kind="overhead",
            solid=False, faces=("-y", "-z", "+x", "-x"), fine=1.3,
        )  # fmt: skip
        builder.box(
            x, about(-half, 0.2), (2.75, 3.2), self.columns, kind="overhead",
            solid=False, faces=("-y", "+y", "-z"))  # fmt: skip
        for index in range(int(span / 2.3)):
            at = x[0] + 0.8 + 2.3 * index
            builder.box(
                about(at, 0.22), about(-half, 0.22), (0.0, 0.35), self.columns,
                kind="structure")  # fmt: skip
            builder.box(
                about(at, 0.13), about(-half, 0.13), (0.35, 2.75), self.columns,
                kind="structure", faces=())  # fmt: skip
            builder.prism(
                (at, -half), (0.35, 2.75), (0.17, 0.15), self.columns, sides=12, kind="structure"
            )
        middle = half + 1.0
        house(
            builder, (x[1], x[1] + 1.0), (court, middle), 6.2, self.walls, face="-x",
            windows=windows, pitch=2.7, skip=(0, 1),
            extra=(Decal((middle - 0.9, 0.0, middle + 0.9, 2.4), "doors", 0.5),),
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


@dataclass(frozen=True, kw_only=True)
class Field:
    """A wide level lawn within a hedge, with nothing on it.

    Attributes:
        ground: material of the lawn.
        reach: metres from the spawn to the hedge, to each side.
        indoor: never.
    """

    ground: str = "grass/green"
    reach: float = 16.0
    indoor: bool = False

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the field; how long the course is changes nothing."""
        del length
        near, far = self.reach, self.reach + 1.0
        builder.ground(self.ground, (-far - 6.0, far + 6.0), (-far - 6.0, far + 6.0))
        for side in (1.0, -1.0):
            low, high = sorted((side * near, side * far))
            outdoors.hedge(builder, (low, high), (-far, far), 1.7)
            outdoors.hedge(builder, (-near, near), (low, high), 1.7)
        for index in range(12):
            angle = 2.0 * math.pi * (index + 0.3) / 12
            away = far + 3.0 + 1.1 * (index % 3)
            outdoors.tree(
                builder,
                away * math.cos(angle),
                away * math.sin(angle),
                height=5.0 + 0.6 * (index % 4),
                radius=1.7 + 0.2 * (index % 2),
                turn=1.3 * index,
                far=True,
            )
