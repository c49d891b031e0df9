"""Hurdles: bars, blocks and benches across the course; and one scene with nothing in the way."""

from __future__ import annotations

from dataclasses import dataclass

from nw_places.entry import Entry
from nw_places.places.builder import SceneBuilder, about
from nw_places.places.gardens import Cloister, Courtyard, Garden, Park
from nw_places.places.halls import Warehouse, Workshop
from nw_places.places.rooms import Corridor, Room
from nw_places.places.streets import Alley, CarPark, Plaza, Yard
from nw_scenes.scene import Vector


@dataclass(frozen=True, kw_only=True)
class Hurdles:
    """Solid bars that lie across the course, a waypoint on top of each and one after the last.

    Attributes:
        heights: of the bars in metres, nearest first; none makes a flat trail.
        gaps: metres from the spawn to the first bar's middle, then from middle to middle.
        length: of each bar along the course, metres.
        width: of each bar across the course, metres.
        shift: of each bar's middle to the left, metres; missing ones are 0.
        material: of the bars' sides.
        top: of their tops, where that differs.
        finish: metres from the last bar's middle (or the spawn) to the last waypoint.
    """

    heights: tuple[float, ...]
    gaps: tuple[float, ...]
    length: float = 0.35
    width: float = 1.6
    shift: tuple[float, ...] = ()
    material: str = "plywood"
    top: str | None = None
    finish: float = 1.6

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    def middles(self) -> tuple[float, ...]:
        """Return the bars' middles along x, metres."""
        return tuple(sum(self.gaps[: index + 1]) for index in range(len(self.heights)))

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: on top of each bar, then on the floor after the last."""
        middles = self.middles()
        tops = tuple(
            (x, self._shift(index), height)
            for index, (x, height) in enumerate(zip(middles, self.heights, strict=True))
        )
        last = middles[-1] if middles else 0.0
        return (*tops, (last + self.finish, 0.0, 0.0))

    def build(self, builder: SceneBuilder) -> None:
        """Build the bars."""
        for index, (x, height) in enumerate(zip(self.middles(), self.heights, strict=True)):
            y = self._shift(index)
            builder.box(
                about(x, self.length / 2),
                about(y, self.width / 2),
                (0.0, height),
                self.material,
                top=self.top,
                kind="obstacle",
                fine=0.6,
                texture=(3.7 * index, 0.0),
            )

    def _shift(self, index: int) -> float:
        return self.shift[index] if index < len(self.shift) else 0.0


HURDLES: tuple[Entry, ...] = (
    Entry(
        name="hurdles/one_low_carpet",
        title="one plywood box, 15 cm, on the blue carpet of a sunny seminar room",
        setting=Room(floor="carpet/blue", walls="plaster/cream"),
        course=Hurdles(heights=(0.15,), gaps=(1.7,), width=1.8, finish=1.7),
        light="indoor",
    ),
    Entry(
        name="hurdles/two_foam_office",
        title="two foam blocks, 14 and 18 cm, on grey carpet tiles between bookshelves",
        setting=Room(
            floor="carpet_tiles/grey", walls="plaster/white", accent="plaster/teal", width=5.4
        ),
        course=Hurdles(
            heights=(0.14, 0.18), gaps=(1.5, 1.8), length=0.40, width=1.4, material="foam/red"
        ),
        light="indoor",
    ),
    Entry(
        name="hurdles/three_low",
        title="three planked bars, 12 to 20 cm, on the brick paving of a sunny courtyard",
        setting=Courtyard(ground="pavers/red", walls="brick/yellow"),
        course=Hurdles(
            heights=(0.12, 0.16, 0.20),
            gaps=(1.6, 1.8, 1.7),
            width=2.0,
            shift=(0.0, 0.05, -0.05),
            material="planks/pine",
        ),
        light="noon",
    ),
    Entry(
        name="hurdles/two_rubber_corridor",
        title="two rubber blocks, 18 and 20 cm, on the sea-green floor of a long corridor",
        setting=Corridor(),
        course=Hurdles(
            heights=(0.18, 0.20), gaps=(1.6, 1.9), width=1.3, length=0.32, material="rubber/black"
        ),
        light="indoor",
    ),
    Entry(
        name="hurdles/three_crates_workshop",
        title="three pallet crates, 20 to 25 cm, on the concrete floor of a workshop",
        setting=Workshop(),
        course=Hurdles(
            heights=(0.20, 0.25, 0.22),
            gaps=(1.5, 1.9, 1.8),
            width=1.5,
            length=0.40,
            shift=(0.05, -0.05, 0.0),
            material="planks/pallet",
        ),
        light="indoor",
    ),
    Entry(
        name="hurdles/three_grassy_courtyard",
        title="three railway sleepers, 16 to 22 cm, in the grass of a brick courtyard",
        setting=Courtyard(ground="grass/green", walls="brick/brown", path=False),
        course=Hurdles(
            heights=(0.16, 0.22, 0.18),
            gaps=(1.7, 1.7, 1.9),
            length=0.30,
            width=2.2,
            shift=(-0.05, 0.0, 0.05),
            material="timber/dark",
        ),
        light="afternoon",
    ),
    Entry(
        name="hurdles/two_kerbs_alley",
        title="two concrete kerbs, 20 and 24 cm, in a narrow alley between brick houses",
        setting=Alley(),
        course=Hurdles(
            heights=(0.20, 0.24),
            gaps=(1.6, 2.0),
            width=1.6,
            length=0.30,
            material="concrete/light",
        ),
        light="forenoon",
    ),
    Entry(
        name="hurdles/two_logs_park",
        title="two squared logs, 18 and 25 cm, on a gravel path through a park",
        setting=Park(path="gravel/sand"),
        course=Hurdles(
            heights=(0.18, 0.25), gaps=(1.6, 1.8), width=2.0, length=0.30, material="timber/brown"
        ),
        light="afternoon",
    ),
    Entry(
        name="hurdles/three_stops_car_park",
        title="three painted wheel stops, 10 to 15 cm, on the tarmac of a car park",
        setting=CarPark(),
        course=Hurdles(
            heights=(0.10, 0.12, 0.15),
            gaps=(1.7, 1.8, 1.8),
            width=1.8,
            length=0.28,
            material="kerb/yellow",
        ),
        light="overcast",
    ),
    Entry(
        name="hurdles/two_brick_dusk",
        title="two low brick walls, 22 and 25 cm, in a courtyard at dusk",
        setting=Courtyard(ground="slabs/sand", walls="brick/red", lit=True),
        course=Hurdles(
            heights=(0.22, 0.25),
            gaps=(1.7, 2.0),
            width=1.9,
            length=0.34,
            material="brick/red",
            top="coping/grey",
        ),
        light="dusk",
    ),
    Entry(
        name="hurdles/one_high_stone_plaza",
        title="one granite bench, 30 cm, on the slabs of a campus plaza",
        setting=Plaza(),
        course=Hurdles(
            heights=(0.30,), gaps=(1.8,), width=2.2, length=0.42, material="granite/black"
        ),
        light="afternoon",
    ),
    Entry(
        name="hurdles/three_high_wood_hall",
        title="three plywood boxes, 30 to 36 cm, on the wooden floor of a hall",
        setting=Room(
            floor="parquet/oak",
            walls="plaster/white",
            accent="plaster/ochre",
            width=7.0,
            height=3.4,
            hall=True,
        ),
        course=Hurdles(
            heights=(0.30, 0.33, 0.36),
            gaps=(1.7, 1.9, 2.0),
            width=1.8,
            length=0.42,
        ),
        light="indoor_evening",
    ),
    Entry(
        name="hurdles/two_pallets_warehouse",
        title="two boxes of pallet wood, 16 and 21 cm, in the aisle of a warehouse",
        setting=Warehouse(),
        course=Hurdles(
            heights=(0.16, 0.21),
            gaps=(1.6, 2.0),
            width=1.6,
            length=0.44,
            material="planks/pallet",
        ),
        light="indoor",
    ),
    Entry(
        name="hurdles/three_benches_cloister",
        title="three benches of red granite, 18 to 22 cm, in the walk of a cloister",
        setting=Cloister(),
        course=Hurdles(
            heights=(0.18, 0.22, 0.20),
            gaps=(1.7, 1.9, 1.8),
            width=1.7,
            length=0.38,
            material="granite/pink",
        ),
        light="morning",
    ),
    Entry(
        name="hurdles/two_beams_yard_night",
        title="two timber beams, 17 and 22 cm, under the lamps of a container yard at night",
        setting=Yard(lit=True),
        course=Hurdles(
            heights=(0.17, 0.22), gaps=(1.6, 1.9), width=2.2, length=0.30, material="timber/brown"
        ),
        light="night",
    ),
    Entry(
        name="hurdles/three_boxes_garden",
        title="three planked boxes, 14 to 18 cm, on the path of a back garden",
        setting=Garden(),
        course=Hurdles(
            heights=(0.14, 0.18, 0.16),
            gaps=(1.6, 1.7, 1.8),
            width=1.5,
            length=0.36,
            shift=(0.0, -0.06, 0.06),
            material="planks/teak",
        ),
        light="overcast",
    ),
    Entry(
        name="flat/carpet_room",
        title="a seminar room with nothing in the way",
        setting=Room(floor="carpet/blue", walls="plaster/cream"),
        course=Hurdles(heights=(), gaps=(), finish=4.0),
        light="indoor",
    ),
)
