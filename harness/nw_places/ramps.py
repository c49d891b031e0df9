"""Ramps: staggered boards that lean to one side, and slopes up and down.

Inclined boards are boxes, told by where their upper surface is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from nw_places.entry import Entry
from nw_places.places.builder import ALL_FACES, SceneBuilder, about
from nw_places.places.gardens import Cloister, Courtyard, Garden, Park
from nw_places.places.halls import Underpass, Warehouse, Workshop
from nw_places.places.parts import Decal, Pair
from nw_places.places.rooms import Corridor, Room
from nw_places.places.streets import CarPark, Plaza
from nw_scenes.scene import Vector

# Height of the lower edge of a leaning board above the ground, metres.
_LOW_EDGE = 0.03

THICKNESS = 0.04
"""Of a board, metres."""

# Of the strips that keep shoes from slipping: from one to the next, width, to the sides; metres.
_TREAD_EVERY, _TREAD, _TREAD_MARGIN = 0.24, 0.06, 0.05


@dataclass(frozen=True, kw_only=True)
class Boards:
    """Staggered boards that lean inwards from alternate sides, low edges towards the middle.

    Attributes:
        angles: of the boards in degrees, nearest first.
        first: where the first board begins, metres along x.
        length: of each board along the course, metres.
        width: of each board across the course, on its slope, metres.
        offset: of the boards' middles from the course's line, to alternate sides, metres: small
            ones are in line, large ones spread.
        gap: metres between boards along the course.
        side: +1 where the first board lies on the left, -1 on the right.
        material: of the boards.
        props: material of the blocks under their high edges.
    """

    angles: tuple[float, ...]
    first: float = 1.1
    length: float = 0.85
    width: float = 0.90
    offset: float = 0.2
    gap: float = 0.10
    side: int = 1
    material: str = "plywood"
    props: str = "timber/brown"

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: on each board near its middle, then on the ground."""
        points: list[Vector] = []
        for index, degrees in enumerate(self.angles):
            low, high = self._span(index)
            side = self._side(index)
            # A little nearer to the course's line, as one walks; so a little lower.
            y = 0.8 * self.offset
            z = self._middle(degrees) - (self.offset - y) * math.tan(math.radians(degrees))
            points.append(((low + high) / 2, side * y, z))
        return (*points, (self._span(len(self.angles) - 1)[1] + 1.0, 0.0, 0.0))

    def build(self, builder: SceneBuilder) -> None:
        """Build boards and props."""
        for index, degrees in enumerate(self.angles):
            x = self._span(index)
            side = self._side(index)
            angle = math.radians(degrees)
            z = self._middle(degrees)
            rolled_board(
                builder, x, side * self.offset, z, self.width, side * angle, self.material,
                texture=(1.3 * index, 0.0),
            )  # fmt: skip
            # Props stand under the outer part; the board's underside clears their inner edge.
            inner = 0.30 * self.width
            outer = inner + 0.10
            top = z + inner * math.tan(angle) - 1.05 * THICKNESS / math.cos(angle)
            y = tuple(sorted((side * (self.offset + inner), side * (self.offset + outer))))
            for end in (x[0] + 0.08, x[1] - 0.20):
                builder.box(
                    (end, end + 0.12), (y[0], y[1]), (0.0, top), self.props, kind="structure",
                    fine=0.8,
                )  # fmt: skip

    def _span(self, index: int) -> tuple[float, float]:
        start = self.first + index * (self.length + self.gap)
        return (start, start + self.length)

    def _side(self, index: int) -> int:
        return self.side * (1 if index % 2 == 0 else -1)

    def _middle(self, degrees: float) -> float:
        return _LOW_EDGE + 0.5 * self.width * math.sin(math.radians(degrees))


@dataclass(frozen=True, kw_only=True)
class Humps:
    """Slopes up to a deck and down again, one hump after another; a waypoint on each deck.

    Attributes:
        angles: of each hump's slopes in degrees.
        lengths: of each slope, metres on the slope.
        decks: length of each hump's level top, metres.
        first: where the first slope begins, metres along x.
        apart: metres of ground between humps.
        width: across the course, metres.
        shift: of each hump's middle to the left, metres; missing ones are 0.
        material: of the boards.
        body: of the blocks under the decks.
        top: of the decks; the boards' material where not given.
        treads: of strips across the slopes; none where not given.
    """

    angles: tuple[float, ...]
    lengths: tuple[float, ...]
    decks: tuple[float, ...]
    first: float = 1.3
    apart: float = 0.7
    width: float = 1.0
    shift: tuple[float, ...] = ()
    material: str = "plywood"
    body: str = "timber/brown"
    top: str | None = None
    treads: str | None = None

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: in the middle of each deck, then on the ground."""
        points = tuple(
            (start + run + deck / 2, self._shift(index), height)
            for index, (start, run, deck, height) in enumerate(self._humps())
        )
        start, run, deck, _ = self._humps()[-1]
        return (*points, (start + 2 * run + deck + 1.0, 0.0, 0.0))

    def build(self, builder: SceneBuilder) -> None:
        """Build slopes and decks."""
        for index, (start, run, deck, height) in enumerate(self._humps()):
            y = (self._shift(index) - self.width / 2, self._shift(index) + self.width / 2)
            crest, brink = start + run, start + run + deck
            texture = (2.1 * index, 0.0)
            pitched_board(
                builder, (start, crest), (0.0, height), y, self.material, treads=self.treads,
                texture=texture,
            )  # fmt: skip
            builder.box(
                (crest, brink), y, (0.0, height), self.body, top=self.top or self.material,
                kind="obstacle", fine=0.7, texture=texture,
            )  # fmt: skip
            pitched_board(
                builder, (brink, brink + run), (height, 0.0), y, self.material, treads=self.treads,
                texture=texture,
            )  # fmt: skip

    def _humps(self) -> tuple[tuple[float, float, float, float], ...]:
        """Return where each hump starts, the run of its slopes, its deck's length and height."""
        humps: list[tuple[float, float, float, float]] = []
        start = self.first
        for degrees, length, deck in zip(self.angles, self.lengths, self.decks, strict=True):
            angle = math.radians(degrees)
            run, height = length * math.cos(angle), length * math.sin(angle)
            humps.append((start, run, deck, height))
            start += 2 * run + deck + self.apart
        return tuple(humps)

    def _shift(self, index: int) -> float:
        return self.shift[index] if index < len(self.shift) else 0.0


def pitched_board(
    builder: SceneBuilder,
    x: Pair,
    z: Pair,
    y: Pair,
    material: str,
    *,
    treads: str | None = None,
    texture: Pair = (0.0, 0.0),
) -> None:
    """Lay a board whose upper surface runs from one height to another along the course.

    Args:
        builder: of the scene that it is part of.
        x: where its upper surface starts and ends, metres.
        z: the heights there.
        y: from and to.
        material: of all its faces.
        treads: material of strips across it, which show that it slants; None for none.
        texture: so that equal boards differ.
    """
    run, rise = x[1] - x[0], z[1] - z[0]
    length, slope = math.hypot(run, rise), math.atan2(rise, run)
    half = THICKNESS / 2
    # The middle lies half a thickness below the middle of the upper surface, across the slope.
    middle_x = (x[0] + x[1]) / 2 + half * math.sin(slope)
    middle_z = (z[0] + z[1]) / 2 - half * math.cos(slope)
    builder.box(
        about(middle_x, length / 2),
        y,
        about(middle_z, half),
        material,
        pitch=-slope,
        kind="obstacle",
        faces=ALL_FACES,
        fine=0.7,
        decals=None if treads is None else {"+z": _treads(length, y[1] - y[0], treads)},
        texture=texture,
    )


def _treads(length: float, width: float, material: str) -> list[Decal]:
    """Return strips across a board, as far from its lower as from its upper end."""
    count = int((length - _TREAD) / _TREAD_EVERY)
    first = (length - (count - 1) * _TREAD_EVERY - _TREAD) / 2
    return [
        Decal(
            (
                first + number * _TREAD_EVERY,
                _TREAD_MARGIN,
                first + number * _TREAD_EVERY + _TREAD,
                width - _TREAD_MARGIN,
            ),
            material,
        )
        for number in range(count)
    ]


def rolled_board(
    builder: SceneBuilder,
    x: Pair,
    y: float,
    z: float,
    width: float,
    roll: float,
    material: str,
    *,
    texture: Pair = (0.0, 0.0),
) -> None:
    """Lay a board along the course that leans to one side.

    Args:
        builder: of the scene that it is part of.
        x: from and to.
        y: of the middle of its upper surface, metres.
        z: height of that middle, metres.
        width: across the course, measured on the slope, metres.
        roll: radians; positive lifts its left side.
        material: of all its faces.
        texture: so that equal boards differ.
    """
    half = THICKNESS / 2
    middle_y = y + half * math.sin(roll)
    middle_z = z - half * math.cos(roll)
    builder.box(
        x,
        about(middle_y, width / 2),
        about(middle_z, half),
        material,
        roll=roll,
        kind="obstacle",
        faces=ALL_FACES,
        fine=0.7,
        texture=texture,
    )


RAMPS: tuple[Entry, ...] = (
    Entry(
        name="ramps/aligned_boards_carpet",
        title="four plywood boards in line, 12 to 14 degrees, in a sunny seminar room",
        setting=Room(floor="carpet/blue", walls="plaster/white", accent="plaster/teal"),
        course=Boards(angles=(12.0, 14.0, 12.0, 14.0), offset=0.10),
        light="indoor",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/offset_boards_office",
        title="four birch boards by turns left and right, 14 to 16 degrees, in an office",
        setting=Room(floor="carpet_tiles/grey", walls="plaster/cream", width=5.6),
        course=Boards(
            angles=(14.0, 16.0, 14.0, 16.0), side=-1, material="veneer/birch", props="cardboard"
        ),
        light="indoor",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/offset_boards_corridor",
        title="four rubber mats on boards, 13 to 15 degrees, in a long corridor",
        setting=Corridor(floor="linoleum/grey", walls="plaster/cream", dado="plaster/ochre"),
        course=Boards(
            angles=(13.0, 15.0, 13.0, 15.0), offset=0.15, width=0.85, material="rubber/black"
        ),
        light="indoor",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/spread_boards_hall",
        title="four pine boards far apart, 14 to 16 degrees, in a gymnasium",
        setting=Room(
            floor="parquet/walnut", walls="plaster/cream", width=7.0, height=3.4, hall=True
        ),
        course=Boards(
            angles=(16.0, 18.0, 16.0, 18.0), offset=0.30, gap=0.22, material="planks/pine"
        ),
        light="indoor_evening",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/aligned_boards_bricks",
        title="four planked boards in line, 14 to 16 degrees, on the brick paving of a courtyard",
        setting=Courtyard(ground="pavers/red", walls="brick/yellow"),
        course=Boards(angles=(14.0, 16.0, 15.0, 14.0), offset=0.10, material="planks/worn"),
        light="noon",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/offset_boards_bricks_dusk",
        title="four planked boards by turns left and right, 15 degrees, on grey paving at dusk",
        setting=Courtyard(ground="pavers/grey", walls="brick/brown", lit=True),
        course=Boards(angles=(15.0, 15.0, 15.0, 15.0), side=-1, material="planks/pine"),
        light="dusk",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/spread_boards_grass",
        title="four planked boards far apart, 12 to 15 degrees, in the grass of a courtyard",
        setting=Courtyard(ground="grass/green", walls="stucco/rose", path=False),
        course=Boards(
            angles=(12.0, 15.0, 12.0, 15.0), offset=0.30, gap=0.18, material="planks/pallet"
        ),
        light="morning",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/aligned_boards_park",
        title="four plywood boards in line, 13 to 16 degrees, on the dry grass of a park",
        setting=Park(path="grass/dry"),
        course=Boards(angles=(13.0, 16.0, 14.0, 16.0), offset=0.10, side=-1),
        light="afternoon",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/steep_boards_cloister",
        title="four timber boards, 17 to 19 degrees, in the walk of a cloister",
        setting=Cloister(floor="tiles/terracotta", walls="stucco/rose"),
        course=Boards(
            angles=(17.0, 19.0, 18.0, 19.0),
            offset=0.20,
            material="timber/brown",
            props="concrete/light",
        ),
        light="morning",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/one_ramp_plaza",
        title="one concrete ramp up and down, 14 degrees, on a campus plaza",
        setting=Plaza(ground="slabs/grey", building="panels/sand"),
        course=Humps(
            angles=(14.0,),
            lengths=(1.1,),
            decks=(0.7,),
            width=1.3,
            material="concrete/light",
            body="concrete/light",
            treads="rubber/black",
        ),
        light="noon",
    ),
    Entry(
        name="ramps/two_ramps_park",
        title="two planked bridges, 12 and 15 degrees, on the gravel of a park",
        setting=Park(path="gravel/grey", leaves=("leaves/oak", "leaves/dark")),
        course=Humps(
            angles=(12.0, 15.0), lengths=(1.0, 0.9), decks=(0.6, 0.6), material="planks/teak"
        ),
        light="overcast",
    ),
    Entry(
        name="ramps/two_ramps_garden",
        title="two pine ramps, 14 and 16 degrees, on the path of a back garden",
        setting=Garden(path="gravel/sand", walls="stucco/cream"),
        course=Humps(
            angles=(14.0, 16.0),
            lengths=(0.9, 0.9),
            decks=(0.5, 0.6),
            shift=(0.08, -0.08),
            material="planks/pine",
        ),
        light="morning",
    ),
    Entry(
        name="ramps/two_ramps_warehouse",
        title="two steel ramps, 15 and 18 degrees, in the aisle of a warehouse",
        setting=Warehouse(floor="concrete/dark", rack="metal/red"),
        course=Humps(
            angles=(15.0, 18.0),
            lengths=(0.9, 0.9),
            decks=(0.6, 0.6),
            width=1.1,
            material="metal/grey",
            body="metal/blue",
        ),
        light="indoor_night",
    ),
    Entry(
        name="ramps/one_ramp_underpass",
        title="one plywood ramp up and down, 18 degrees, in a painted underpass",
        setting=Underpass(mural=("mural/green", "mural/teal"), dado="block_wall/grey"),
        course=Humps(angles=(18.0,), lengths=(1.1,), decks=(0.6,)),
        light="indoor",
    ),
    Entry(
        name="ramps/two_ramps_car_park_night",
        title="two concrete ramps, 15 and 17 degrees, under the lamps of a car park at night",
        setting=CarPark(ground="tarmac/old", lit=True),
        course=Humps(
            angles=(15.0, 17.0),
            lengths=(1.0, 0.9),
            decks=(0.6, 0.6),
            width=1.2,
            material="concrete/light",
            body="kerb/yellow",
            treads="stripe/yellow",
        ),
        light="night",
    ),
    Entry(
        name="ramps/two_steep_ramps_workshop",
        title="two timber ramps, 20 and 22 degrees, in a workshop",
        setting=Workshop(floor="concrete/light"),
        course=Humps(
            angles=(20.0, 22.0),
            lengths=(0.9, 0.8),
            decks=(0.6, 0.6),
            material="timber/brown",
            body="timber/dark",
        ),
        light="indoor",
    ),
)
