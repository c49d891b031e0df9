"""Stairs: flights of steps, closed or open, straight or curved, up to a landing.

Rises are 10 to 20 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from nw_places.entry import Entry
from nw_places.places.builder import ALL_FACES, SIDES, SIDES_AND_TOP, SceneBuilder, about
from nw_places.places.gardens import Cloister, Courtyard, Garden, Park
from nw_places.places.halls import Underpass, Warehouse, Workshop
from nw_places.places.rooms import Corridor, Lobby, Room
from nw_places.places.streets import Alley, Plaza
from nw_scenes.scene import Vector

# Thickness of a tread without a riser, metres.
_TREAD = 0.05
# From the last step's edge to the last waypoint, metres.
_ARRIVAL = 0.9


@dataclass(frozen=True, kw_only=True)
class _Tread:
    """One tread: its middle, the direction one walks over it, its depth and its height."""

    x: float
    y: float
    yaw: float
    depth: float
    height: float


@dataclass(frozen=True, kw_only=True)
class Stairs:
    """A flight of steps, a waypoint on every other one, and a landing above.

    Attributes:
        rises: of the steps in metres, lowest first.
        depth: of a tread along the way, metres.
        landings: depth of single treads, by index, where they differ from `depth`.
        first: where the first step begins, metres along x.
        width: metres.
        turn: radians to the left from one step to the next; each is then a turned box, and
            neighbours overlap on the inner side like wedges.
        material: of risers and sides.
        top: of the treads, where that differs.
        open_risers: treads on stringers, with nothing between them.
        sides: `none`, low walls that climb with the steps, or hand `rails`.
        beyond: metres of landing past the last waypoint.
        landing_width: metres; the flight's width where not given.
        parapet: height of a wall at the landing's far end, metres; 0 for none.
    """

    rises: tuple[float, ...]
    depth: float = 0.30
    landings: tuple[tuple[int, float], ...] = ()
    first: float = 1.5
    width: float = 1.8
    turn: float = 0.0
    material: str = "concrete/light"
    top: str | None = None
    open_risers: bool = False
    sides: Literal["none", "walls", "rails"] = "none"
    beyond: float = 1.6
    landing_width: float | None = None
    parapet: float = 0.0

    @property
    def floor(self) -> float:
        """Height of the ground, metres."""
        return 0.0

    @property
    def height(self) -> float:
        """Of the landing above the ground, metres."""
        return sum(self.rises)

    def trail(self) -> tuple[Vector, ...]:
        """Return the waypoints: on every other step, then on the landing."""
        steps = self._steps()
        on_steps = tuple((step.x, step.y, step.height) for step in steps[:-1:2])
        return (*on_steps, self._past_edge(_ARRIVAL))

    def build(self, builder: SceneBuilder) -> None:
        """Build steps and landing."""
        steps = self._steps()
        for index, step in enumerate(steps[:-1]):
            self._tread(builder, step, index)
        edge = self._past_edge(0.0)
        length = _ARRIVAL + self.beyond
        middle = self._past_edge(length / 2)
        width = self.landing_width or self.width
        builder.box(
            about(middle[0], length / 2),
            about(middle[1], width / 2),
            (0.0, edge[2]),
            self.material,
            top=self.top,
            yaw=steps[-1].yaw,
            kind="obstacle",
            fine=0.8,
            texture=(0.13, 0.0),
        )
        if self.parapet > 0.0:
            wall = self._past_edge(length - 0.08)
            builder.box(
                about(wall[0], 0.08),
                about(wall[1], width / 2),
                (edge[2], edge[2] + self.parapet),
                self.material,
                yaw=steps[-1].yaw,
                kind="structure",
            )
        if self.sides != "none" or self.open_risers:
            for side in (-1, 1):
                self._side(builder, side)

    def _tread(self, builder: SceneBuilder, step: _Tread, index: int) -> None:
        # Wedges: a turned tread reaches a little under the next one, so that no crack opens on
        # the outer side.
        spare = 0.5 * self.width * math.tan(abs(self.turn))
        thick = _TREAD if self.open_risers else step.height
        front = -step.depth / 2
        back = step.depth / 2 + (0.02 if self.open_risers else spare)
        along = (front + back) / 2
        middle = (step.x + along * math.cos(step.yaw), step.y + along * math.sin(step.yaw))
        half = (back - front) / 2
        builder.box(
            about(middle[0], half),
            about(middle[1], self.width / 2),
            (step.height - thick, step.height),
            self.material,
            top=self.top,
            yaw=step.yaw,
            kind="obstacle",
            faces=ALL_FACES if self.open_risers else SIDES_AND_TOP,
            fine=0.75,
            texture=(0.41 * index, 0.17 * index),
        )

    def _side(self, builder: SceneBuilder, side: int) -> None:
        """Build what runs along one side: stringer, stepped wall, or posts with a rail."""
        for index, step in enumerate(self._steps()[:-1]):
            out = side * (self.width / 2 + 0.06)
            x = step.x - out * math.sin(step.yaw)
            y = step.y + out * math.cos(step.yaw)
            low, high = step.height - 0.22, step.height + 0.02
            if self.sides == "walls":
                low, high = 0.0, step.height + 0.30
            if self.sides != "rails" or self.open_risers:
                builder.box(
                    about(x, step.depth / 2),
                    about(y, 0.06),
                    (max(low, 0.0), high),
                    self.material if self.sides == "walls" else "metal/dark",
                    yaw=step.yaw,
                    kind="structure",
                    fine=0.9,
                )
            if self.sides == "rails" and index % 2 == 0:
                builder.box(
                    about(x, 0.02),
                    about(y, 0.02),
                    (0.0, step.height + 0.85),
                    "metal/dark",
                    kind="structure",
                    faces=SIDES,
                    fine=0.9,
                )
        if self.sides == "rails":
            self._rail(builder, side)

    def _rail(self, builder: SceneBuilder, side: int) -> None:
        """Lay a hand rail on the posts of one side of a straight flight."""
        first, last = self._steps()[0], self._steps()[-1]
        run, rise = last.x - first.x, last.height - first.height
        length, slope = math.hypot(run, rise), math.atan2(rise, run)
        x, z = (first.x + last.x) / 2, (first.height + last.height) / 2 + 0.86
        y = side * (self.width / 2 + 0.06)
        builder.box(
            about(x, length / 2),
            about(y, 0.025),
            about(z, 0.02),
            "metal/dark",
            pitch=-slope,
            kind="overhead",
            solid=False,
            faces=ALL_FACES,
            fine=0.9,
        )

    def _past_edge(self, away: float) -> Vector:
        """Return a point on the landing, metres past its edge."""
        last = self._steps()[-1]
        along = away - last.depth / 2
        return (
            last.x + along * math.cos(last.yaw),
            last.y + along * math.sin(last.yaw),
            last.height,
        )

    def _steps(self) -> tuple[_Tread, ...]:
        """Return all steps; the last is the beginning of the landing."""
        steps: list[_Tread] = []
        depths = dict(self.landings)
        x, y, yaw, height = self.first, 0.0, 0.0, 0.0
        for index, rise in enumerate(self.rises):
            height += rise
            depth = depths.get(index, self.depth)
            steps.append(
                _Tread(
                    x=x + depth / 2 * math.cos(yaw),
                    y=y + depth / 2 * math.sin(yaw),
                    yaw=yaw,
                    depth=depth,
                    height=height,
                )
            )
            x, y = x + depth * math.cos(yaw), y + depth * math.sin(yaw)
            yaw += self.turn
        return tuple(steps)


STAIRS: tuple[Entry, ...] = (
    Entry(
        name="stairs/five_low_podium",
        title="five low plywood steps, 10 cm, up to a podium in a seminar room",
        setting=Room(floor="carpet/red", walls="plaster/cream"),
        course=Stairs(rises=(0.1,) * 5, depth=0.32, width=2.0, beyond=1.2, material="plywood"),
        light="indoor",
    ),
    Entry(
        name="stairs/six_wood_hall",
        title="six planked steps, 17 cm, up to a stage in a gymnasium at evening",
        setting=Room(
            floor="parquet/oak",
            walls="plaster/white",
            accent="plaster/teal",
            width=7.0,
            height=3.8,
            hall=True,
        ),
        course=Stairs(rises=(0.17,) * 6, depth=0.30, width=2.2, beyond=1.3, material="planks/pine"),
        light="indoor_evening",
    ),
    Entry(
        name="stairs/eight_stone_lobby",
        title="eight stone steps, 15 cm, up to the gallery of an entrance hall",
        setting=Lobby(gallery=1.2, floor="tiles/white", flight=2.4),
        course=Stairs(
            rises=(0.15,) * 8, depth=0.31, width=2.4, material="granite/grey", top="granite/pink"
        ),
        light="indoor",
        exposure=0.8,
    ),
    Entry(
        name="stairs/eight_open_wood_lobby",
        title="eight open oak treads, 16 cm, up to the gallery of an entrance hall",
        setting=Lobby(
            gallery=1.28,
            floor="tiles/terracotta",
            walls="plaster/cream",
            accent="plaster/sage",
            deck="veneer/beech",
            flight=1.8,
        ),
        course=Stairs(
            rises=(0.16,) * 8, depth=0.30, open_risers=True, sides="rails", material="veneer/beech"
        ),
        light="indoor_night",
    ),
    Entry(
        name="stairs/seven_steel_warehouse",
        title="seven open steel treads, 17 cm, up to a platform in a warehouse",
        setting=Warehouse(rack="metal/green"),
        course=Stairs(
            rises=(0.17,) * 7,
            depth=0.30,
            open_risers=True,
            sides="rails",
            material="metal/grey",
            top="grating/steel",
        ),
        light="indoor",
    ),
    Entry(
        name="stairs/six_steel_workshop",
        title="six open steel treads, 14 cm, up to a platform in a workshop",
        setting=Workshop(),
        course=Stairs(
            rises=(0.14,) * 6,
            depth=0.32,
            open_risers=True,
            width=1.6,
            material="metal/yellow",
            top="grating/steel",
        ),
        light="indoor",
    ),
    Entry(
        name="stairs/landing_tiles_underpass",
        title="four and four tiled steps, 12 cm, with a landing between them, in an underpass",
        setting=Underpass(height=3.3),
        course=Stairs(
            rises=(0.12,) * 8,
            depth=0.30,
            landings=((3, 1.0),),
            width=2.4,
            material="tiles/white",
            top="tiles/slate",
        ),
        light="indoor",
    ),
    Entry(
        name="stairs/five_low_corridor",
        title="five linoleum steps, 13 cm, in a long corridor",
        setting=Corridor(floor="linoleum/sea", height=3.2),
        course=Stairs(
            rises=(0.13,) * 5,
            depth=0.34,
            width=2.6,
            beyond=6.1,
            material="concrete/light",
            top="linoleum/sand",
        ),
        light="indoor",
    ),
    Entry(
        name="stairs/seven_concrete_plaza",
        title="seven concrete steps, 14 cm, up to a terrace on a campus plaza",
        setting=Plaza(),
        course=Stairs(
            rises=(0.14,) * 7,
            depth=0.32,
            width=2.4,
            landing_width=4.0,
            parapet=0.5,
            material="concrete/light",
        ),
        light="afternoon",
        exposure=0.85,
    ),
    Entry(
        name="stairs/curved_granite_plaza",
        title="eight granite steps, 13 cm, that curve to the left, on a campus plaza",
        setting=Plaza(ground="slabs/sand", building="panels/grey"),
        course=Stairs(
            rises=(0.13,) * 8,
            depth=0.32,
            turn=0.10,
            width=2.0,
            parapet=0.5,
            material="granite/grey",
        ),
        light="noon",
        exposure=0.7,
    ),
    Entry(
        name="stairs/seven_brick_courtyard",
        title="seven brick steps, 16 cm, between low walls, in a courtyard",
        setting=Courtyard(ground="slabs/grey", walls="brick/red"),
        course=Stairs(
            rises=(0.16,) * 7,
            depth=0.31,
            width=2.0,
            sides="walls",
            parapet=0.45,
            material="brick/red",
            top="slabs/sand",
        ),
        light="morning",
    ),
    Entry(
        name="stairs/eight_timber_park",
        title="eight timber steps, 12 cm, deep treads, on a park path",
        setting=Park(path="gravel/sand"),
        course=Stairs(
            rises=(0.12,) * 8,
            depth=0.36,
            width=2.2,
            parapet=0.4,
            material="timber/brown",
            top="gravel/sand",
        ),
        light="afternoon",
        exposure=0.62,
    ),
    Entry(
        name="stairs/seven_stone_alley_night",
        title="seven stone steps, 15 cm, with hand rails, in an alley at night",
        setting=Alley(left="stucco/ochre", right="brick/brown", ground="slabs/grey", lit=True),
        course=Stairs(
            rises=(0.15,) * 7,
            depth=0.30,
            width=2.4,
            sides="rails",
            beyond=1.2,
            material="slabs/grey",
        ),
        light="night",
    ),
    Entry(
        name="stairs/six_slabs_garden_dusk",
        title="six slab steps, 13 cm, up to a raised bed of a garden at dusk",
        setting=Garden(lit=True),
        course=Stairs(
            rises=(0.13,) * 6,
            depth=0.34,
            width=1.9,
            parapet=0.4,
            material="brick/yellow",
            top="slabs/sand",
        ),
        light="dusk",
    ),
    Entry(
        name="stairs/varied_stone_cloister",
        title="eight worn stone steps, 11 to 17 cm high and 28 to 45 cm deep, in a cloister",
        setting=Cloister(),
        course=Stairs(
            rises=(0.13, 0.15, 0.11, 0.17, 0.14, 0.16, 0.12, 0.15),
            depth=0.32,
            landings=((1, 0.28), (2, 0.40), (4, 0.45), (6, 0.30)),
            width=2.2,
            beyond=1.3,
            material="slabs/light",
        ),
        light="overcast",
        exposure=0.6,
    ),
    Entry(
        name="stairs/seven_high_courtyard",
        title="seven high concrete steps, 20 cm, in a courtyard",
        setting=Courtyard(ground="pavers/grey", walls="stucco/cream"),
        course=Stairs(
            rises=(0.2,) * 7, depth=0.31, width=2.2, parapet=0.45, material="concrete/grey"
        ),
        light="noon",
        exposure=0.85,
    ),
)
