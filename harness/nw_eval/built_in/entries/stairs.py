"""Stairs: 10 to 20 cm of rise, closed and open, with landings, straight and curved."""

from __future__ import annotations

from nw_eval.built_in.courses.stairs import Stairs
from nw_eval.built_in.entry import Entry
from nw_eval.built_in.places.indoors.corridor import Corridor
from nw_eval.built_in.places.indoors.lobby import Lobby
from nw_eval.built_in.places.indoors.room import Room
from nw_eval.built_in.places.indoors.underpass import Underpass
from nw_eval.built_in.places.indoors.warehouse import Warehouse
from nw_eval.built_in.places.indoors.workshop import Workshop
from nw_eval.built_in.places.outdoors.alley import Alley
from nw_eval.built_in.places.outdoors.cloister import Cloister
from nw_eval.built_in.places.outdoors.courtyard import Courtyard
from nw_eval.built_in.places.outdoors.garden import Garden
from nw_eval.built_in.places.outdoors.park import Park
from nw_eval.built_in.places.outdoors.plaza import Plaza

STAIRS: tuple[Entry, ...] = (
    Entry(
        name="stairs/five_low_podium",
        title="five low plywood steps, 10 cm, up to a podium in a seminar room",
        task="stairs",
        setting=Room(floor="carpet/red", walls="plaster/cream"),
        course=Stairs(rises=(0.1,) * 5, depth=0.32, width=2.0, beyond=1.2, material="plywood"),
        light="indoor",
    ),
    Entry(
        name="stairs/six_wood_hall",
        title="six planked steps, 17 cm, up to a stage in a gymnasium at evening",
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
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
        task="stairs",
        setting=Courtyard(ground="pavers/grey", walls="stucco/cream"),
        course=Stairs(
            rises=(0.2,) * 7, depth=0.31, width=2.2, parapet=0.45, material="concrete/grey"
        ),
        light="noon",
        exposure=0.85,
    ),
)
