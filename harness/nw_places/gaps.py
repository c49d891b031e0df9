"""Gaps: two or more platforms above a lower floor, with 30 to 50 cm of nothing between them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from typing import Literal

from nw_places.entry import Entry
from nw_places.places.builder import SIDES, SIDES_AND_TOP, SceneBuilder
from nw_places.places.gardens import Cloister, Courtyard, Garden, Park
from nw_places.places.halls import Underpass, Warehouse, Workshop
from nw_places.places.rooms import Corridor, Lobby, Room
from nw_places.places.streets import Alley, CarPark, Plaza, Yard
from nw_scenes.scene import Vector

DEPTH = 0.4064
"""From the tops of platforms, z = 0, down to the floor, metres: 16 inches, as published."""

_START = 1.35  # Metres that the first platform reaches behind the spawn.
_START_WIDTH = 1.524
_LEG = 0.09


@dataclass(frozen=True, kw_only=True)
class Gaps:
    """Platforms in a row, a waypoint in the middle of each, and one at the end.

    Attributes:
        gaps: metres of nothing before each platform, nearest first. With `last` = `platform` the
            last gap is the one before the end platform.
        edge: where the platform under the spawn ends, metres along x.
        length: of each platform along the course, metres.
        width: of each platform across the course, metres.
        shift: of each platform's middle to the left, metres; missing ones are 0.
        material: of the platforms' sides.
        top: of their tops, where that differs.
        thickness: of decks on four legs that one can look under, metres; solid blocks where not
            given.
        last: whether the course ends on a long platform or down on the floor.
    """

    gaps: tuple[float, ...]
    edge: float = 1.3
    length: float = 1.05
    width: float = 1.0
    shift: tuple[float, ...] = ()
    material: str = "plywood"
    top: str | None = None
    thickness: float | None = None
    last: Literal["platform", "floor"] = "platform"

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return -DEPTH

    def spans(self) -> tuple[tuple[float, float], ...]:
        """Return from where to where along x the platforms of the row reach, metres."""
        row = self.gaps if self.last == "floor" else self.gaps[:-1]
        ends = tuple(accumulate((gap + self.length for gap in row), initial=self.edge))[1:]
        return tuple((end - self.length, end) for end in ends)

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: in the middle of each platform, then at the end."""
        spans = self.spans()
        middles = tuple(
            ((low + high) / 2, self._shift(index), 0.0) for index, (low, high) in enumerate(spans)
        )
        if self.last == "floor":
            return (*middles, (spans[-1][1] + 1.4, 0.0, self.floor))
        return (*middles, (self._end()[0] + 1.2, 0.0, 0.0))

    def build(self, builder: SceneBuilder) -> None:
        """Build the platforms; the ground lies at z = 0."""
        half = _START_WIDTH / 2
        self._platform(builder, (-_START, self.edge), (-half, half), 0)
        for index, span in enumerate(self.spans()):
            y = self._shift(index)
            self._platform(builder, span, (y - self.width / 2, y + self.width / 2), index + 1)
        if self.last == "platform":
            self._platform(builder, self._end(), (-half, half), len(self.gaps))

    def _platform(
        self, builder: SceneBuilder, x: tuple[float, float], y: tuple[float, float], index: int
    ) -> None:
        texture = (1.7 * index, 0.31 * index)
        thick = DEPTH if self.thickness is None else self.thickness
        builder.box(
            x,
            y,
            (DEPTH - thick, DEPTH),
            self.material,
            top=self.top,
            kind="obstacle",
            faces=SIDES_AND_TOP,
            fine=0.7,
            texture=texture,
        )
        if self.thickness is None:
            return
        inset = 0.08
        for leg_x in (x[0] + inset, x[1] - inset - _LEG):
            for leg_y in (y[0] + inset, y[1] - inset - _LEG):
                builder.box(
                    (leg_x, leg_x + _LEG),
                    (leg_y, leg_y + _LEG),
                    (0.0, DEPTH - thick),
                    self.material,
                    kind="structure",
                    faces=SIDES,
                    fine=0.8,
                )

    def _end(self) -> tuple[float, float]:
        spans = self.spans()
        start = (spans[-1][1] if spans else self.edge) + self.gaps[-1]
        return (start, start + 2.6)

    def _shift(self, index: int) -> float:
        return self.shift[index] if index < len(self.shift) else 0.0


GAPS: tuple[Entry, ...] = (
    Entry(
        name="gaps/two_12in_carpet",
        title="two plywood platforms over gaps of 30 cm in a sunny seminar room",
        setting=Room(floor="carpet/blue", walls="plaster/cream", height=3.0),
        course=Gaps(gaps=(0.305, 0.305, 0.305), material="plywood"),
        light="indoor",
    ),
    Entry(
        name="gaps/three_15in_office",
        title="three felt-topped platforms over gaps of 38 cm in an open office",
        setting=Room(
            floor="carpet_tiles/green",
            walls="plaster/white",
            accent="plaster/sage",
            width=5.6,
            height=3.0,
        ),
        course=Gaps(
            gaps=(0.38, 0.36, 0.38, 0.37),
            shift=(0.0, 0.06, -0.04),
            material="veneer/birch",
            top="carpet/grey",
        ),
        light="indoor",
    ),
    Entry(
        name="gaps/two_14in_corridor",
        title="two rubber-topped platforms over gaps of 35 cm in a school corridor",
        setting=Corridor(floor="linoleum/sand", dado="plaster/teal", height=3.0),
        course=Gaps(gaps=(0.35, 0.34, 0.36), width=0.95, material="plywood", top="rubber/black"),
        light="indoor",
    ),
    Entry(
        name="gaps/three_pallets_warehouse",
        title="three pallet decks over gaps of 36 to 40 cm in the aisle of a warehouse",
        setting=Warehouse(),
        course=Gaps(
            gaps=(0.36, 0.38, 0.40, 0.36),
            length=1.10,
            shift=(0.05, -0.05, 0.0),
            thickness=0.22,
            material="planks/pallet",
        ),
        light="indoor",
    ),
    Entry(
        name="gaps/two_16in_workshop",
        title="two steel platforms over gaps of 41 cm in a workshop",
        setting=Workshop(),
        course=Gaps(
            gaps=(0.406, 0.406, 0.40),
            length=1.15,
            width=1.1,
            thickness=0.16,
            material="metal/blue",
            top="grating/steel",
        ),
        light="indoor",
    ),
    Entry(
        name="gaps/three_16in_hall",
        title="three blue foam blocks over gaps of 41 cm in a gymnasium at evening",
        setting=Room(
            floor="parquet/oak",
            walls="plaster/white",
            accent="plaster/ochre",
            width=7.0,
            height=3.6,
            hall=True,
        ),
        course=Gaps(gaps=(0.406, 0.40, 0.406, 0.40), material="foam/blue"),
        light="indoor_evening",
    ),
    Entry(
        name="gaps/two_14in_underpass",
        title="two concrete blocks over gaps of 34 cm in a painted underpass",
        setting=Underpass(height=3.2),
        course=Gaps(
            gaps=(0.34, 0.34, 0.35), length=1.0, shift=(0.04, -0.04), material="concrete/light"
        ),
        light="indoor",
    ),
    Entry(
        name="gaps/three_20in_lobby",
        title="three stone blocks over gaps of 48 to 50 cm in an entrance hall",
        setting=Lobby(floor="tiles/slate", accent="plaster/teal", beyond=3.0),
        course=Gaps(gaps=(0.48, 0.50, 0.49, 0.50), length=1.10, material="granite/grey"),
        light="indoor",
    ),
    Entry(
        name="gaps/three_12in_courtyard",
        title="three planked platforms over gaps of 31 to 33 cm in the grass of a courtyard",
        setting=Courtyard(ground="grass/green", walls="brick/brown", path=False),
        course=Gaps(gaps=(0.31, 0.33, 0.32, 0.31), shift=(-0.05, 0.05), material="planks/pine"),
        light="noon",
    ),
    Entry(
        name="gaps/three_decks_garden",
        title="three teak decks over gaps of 33 to 37 cm in a back garden",
        setting=Garden(walls="brick/yellow"),
        course=Gaps(
            gaps=(0.33, 0.37, 0.35, 0.34), length=1.0, thickness=0.22, material="planks/teak"
        ),
        light="afternoon",
    ),
    Entry(
        name="gaps/four_stones_park",
        title="four sandstone blocks over gaps of 30 to 35 cm in an autumn park",
        setting=Park(leaves=("leaves/autumn", "leaves/oak")),
        course=Gaps(
            gaps=(0.30, 0.34, 0.32, 0.35, 0.33),
            length=0.95,
            shift=(0.05, -0.06, 0.04),
            material="slabs/sand",
        ),
        light="morning",
    ),
    Entry(
        name="gaps/three_concrete_car_park",
        title="three concrete blocks over gaps of 38 to 42 cm in a car park",
        setting=CarPark(),
        course=Gaps(gaps=(0.38, 0.42, 0.40, 0.39), material="concrete/light"),
        light="overcast",
    ),
    Entry(
        name="gaps/two_down_plaza",
        title="two granite blocks over gaps of 40 cm on a plaza, then down to the ground",
        setting=Plaza(building="panels/grey"),
        course=Gaps(gaps=(0.40, 0.40), length=1.15, last="floor", material="granite/pink"),
        light="afternoon",
    ),
    Entry(
        name="gaps/three_crates_yard",
        title="three timber crates over gaps of 42 to 45 cm in a container yard",
        setting=Yard(shift=1),
        course=Gaps(gaps=(0.42, 0.45, 0.43, 0.44), length=1.10, material="planks/worn"),
        light="overcast",
    ),
    Entry(
        name="gaps/three_14in_alley_night",
        title="three concrete slabs over gaps of 36 cm in an alley at night",
        setting=Alley(left="brick/red", right="stucco/rose", lit=True),
        course=Gaps(gaps=(0.36, 0.35, 0.37, 0.36), width=1.05, material="concrete/grey"),
        light="night",
    ),
    Entry(
        name="gaps/three_stone_cloister_dusk",
        title="three stone blocks over gaps of 40 to 44 cm in a cloister at dusk",
        setting=Cloister(walls="stucco/ochre", lit=True),
        course=Gaps(gaps=(0.40, 0.44, 0.42, 0.41), shift=(0.04, -0.04), material="slabs/light"),
        light="dusk",
    ),
)
