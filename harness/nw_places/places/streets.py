"""Paved places under the sky: an alley, a plaza, a car park, a container yard."""

from __future__ import annotations

from dataclasses import dataclass

from nw_places.places import furniture
from nw_places.places import scenery as outdoors
from nw_places.places.builder import SceneBuilder, about
from nw_places.places.parts import Decal
from nw_places.places.scenery import house

_COLOURS = ("red", "blue", "green", "yellow", "grey")


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

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the alley."""
        x = (-7.0, length + 9.0)
        half = self.width / 2
        span = x[1] - x[0]
        builder.ground(
            self.ground,
            (x[0] - 3.0, x[1] + 8.0),
            (-9.0, 9.0),
            decals=(
                Decal((x[0], half - 0.32, x[1], half), "gutter/grey"),
                Decal((x[0], -half, x[1], -half + 0.32), "gutter/grey"),
                Decal((length + 0.6, -0.25, length + 1.1, 0.25), "drain", 0.5),
                Decal((x[1] + 1.0, -9.0, x[1] + 2.4, 9.0), "slabs/grey"),
            ),
        )
        windows = "house_window_lit" if self.lit else "house_window/white"
        left_doors = (
            Decal((span * 0.46, 0.0, span * 0.46 + 1.0, 2.15), "door/green"),
            Decal((span * 0.72, 0.0, span * 0.72 + 2.3, 2.3), "roller_door"),
        )
        right_doors = (
            Decal((span * 0.30, 0.0, span * 0.30 + 1.0, 2.15), "door/blue"),
            Decal((span * 0.55, 0.3, span * 0.55 + 1.6, 1.9), "mural/teal", 0.6),
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

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the plaza."""
        far = length + 9.0
        windows = "house_window_lit" if self.lit else "house_window/dark"
        builder.ground(
            self.ground,
            (-16.0, far),
            (-16.0, 16.0),
            decals=(
                Decal((-16.0, -1.9, far, -1.6), "granite/grey", 1.0),
                Decal((-16.0, 1.6, far, 1.9), "granite/grey", 1.0),
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
                about(column, 0.15),
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

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the car park."""
        half = self.aisle / 2
        far = length + 11.0
        depth = 4.8
        lines: list[Decal] = []
        bays = range(-2, int((far - 2.0) / 2.5))
        for bay in bays:
            x = 2.5 * bay + 0.4
            lines.append(Decal((x, half, x + 0.1, half + depth), "stripe/white"))
            lines.append(Decal((x, -half - depth, x + 0.1, -half), "stripe/white"))
        lines.append(Decal((length + 1.4, -0.75, length + 4.2, 0.75), "arrow"))
        for x, y, reach in ((0.9, 1.4, 0.5), (length - 0.4, -1.3, 0.45), (4.0, -3.6, 0.6)):
            lines.append(Decal((x - reach, y - reach, x + reach, y + reach), "oil_stain"))
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

    def build(self, builder: SceneBuilder, length: float) -> None:
        """Build the yard."""
        x = (-9.0, length + 12.0)
        half = self.lane / 2
        edges = [
            Decal((x[0], y - 0.06, x[1], y + 0.06), "stripe/yellow", 0.8)
            for y in (-half + 0.35, half - 0.35)
        ]
        stains = [
            Decal((at - 0.5, y - 0.5, at + 0.5, y + 0.5), "oil_stain")
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
            extra=(Decal((12.0, 0.0, 16.0, 4.2), "roller_door", 0.7),),
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
        builder: SceneBuilder,
        x: tuple[float, float],
        y: tuple[float, float],
        z: float,
        colour: str,
        side: int,
    ) -> None:
        face = "-y" if side > 0 else "+y"
        length = x[1] - x[0]
        frame = [
            Decal((0.0, 0.0, length, 0.16), "metal/dark", 0.9),
            Decal((0.0, 2.46, length, 2.6), "metal/dark", 0.9),
            Decal((0.0, 0.16, 0.14, 2.46), "metal/grey", 0.9),
            Decal((length - 0.14, 0.16, length, 2.46), "metal/grey", 0.9),
            Decal((0.9, 1.75, 1.9, 2.25), "sign", 0.7),
        ]
        builder.box(
            x, y, (z, z + 2.6), f"corrugated/{colour}", top="metal/grey", kind="structure",
            faces=("-x", "+x", face), decals={face: frame}, solid=z == 0.0,
        )  # fmt: skip
