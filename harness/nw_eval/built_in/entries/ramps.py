"""Ramps: staggered boards that lean, and slopes up and down."""

from __future__ import annotations

from nw_eval.built_in.courses.ramps import Boards, Humps
from nw_eval.built_in.entry import Entry
from nw_eval.built_in.places.indoors.corridor import Corridor
from nw_eval.built_in.places.indoors.room import Room
from nw_eval.built_in.places.indoors.underpass import Underpass
from nw_eval.built_in.places.indoors.warehouse import Warehouse
from nw_eval.built_in.places.indoors.workshop import Workshop
from nw_eval.built_in.places.outdoors.car_park import CarPark
from nw_eval.built_in.places.outdoors.cloister import Cloister
from nw_eval.built_in.places.outdoors.courtyard import Courtyard
from nw_eval.built_in.places.outdoors.garden import Garden
from nw_eval.built_in.places.outdoors.park import Park
from nw_eval.built_in.places.outdoors.plaza import Plaza

RAMPS: tuple[Entry, ...] = (
    Entry(
        name="ramps/aligned_boards_carpet",
        title="four plywood boards in line, 12 to 14 degrees, in a sunny seminar room",
        task="ramps",
        setting=Room(floor="carpet/blue", walls="plaster/white", accent="plaster/teal"),
        course=Boards(angles=(12.0, 14.0, 12.0, 14.0), offset=0.10),
        light="indoor",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/offset_boards_office",
        title="four birch boards by turns left and right, 14 to 16 degrees, in an office",
        task="ramps",
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
        task="ramps",
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
        task="ramps",
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
        task="ramps",
        setting=Courtyard(ground="pavers/red", walls="brick/yellow"),
        course=Boards(angles=(14.0, 16.0, 15.0, 14.0), offset=0.10, material="planks/worn"),
        light="noon",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/offset_boards_bricks_dusk",
        title="four planked boards by turns left and right, 15 degrees, on grey paving at dusk",
        task="ramps",
        setting=Courtyard(ground="pavers/grey", walls="brick/brown", lit=True),
        course=Boards(angles=(15.0, 15.0, 15.0, 15.0), side=-1, material="planks/pine"),
        light="dusk",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/spread_boards_grass",
        title="four planked boards far apart, 12 to 15 degrees, in the grass of a courtyard",
        task="ramps",
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
        task="ramps",
        setting=Park(path="grass/dry"),
        course=Boards(angles=(13.0, 16.0, 14.0, 16.0), offset=0.10, side=-1),
        light="afternoon",
        waypoint_noise=(0.0, 0.05),
    ),
    Entry(
        name="ramps/steep_boards_cloister",
        title="four timber boards, 17 to 19 degrees, in the walk of a cloister",
        task="ramps",
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
        task="ramps",
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
        task="ramps",
        setting=Park(path="gravel/grey", leaves=("leaves/oak", "leaves/dark")),
        course=Humps(
            angles=(12.0, 15.0), lengths=(1.0, 0.9), decks=(0.6, 0.6), material="planks/teak"
        ),
        light="overcast",
    ),
    Entry(
        name="ramps/two_ramps_garden",
        title="two pine ramps, 14 and 16 degrees, on the path of a back garden",
        task="ramps",
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
        task="ramps",
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
        task="ramps",
        setting=Underpass(mural=("mural/green", "mural/teal"), dado="block_wall/grey"),
        course=Humps(angles=(18.0,), lengths=(1.1,), decks=(0.6,)),
        light="indoor",
    ),
    Entry(
        name="ramps/two_ramps_car_park_night",
        title="two concrete ramps, 15 and 17 degrees, under the lamps of a car park at night",
        task="ramps",
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
        task="ramps",
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
