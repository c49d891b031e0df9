"""Where a robot can walk: doors join rooms, stairs join levels; tables and roofs are apart."""

import numpy as np
import pytest
from twin_parts import grid, joined, terrain

from nw_twin.walkable import walkable

X, Y, Z = np.eye(3)


def block(low, high):
    """A closed box."""
    (x, y, z), low = np.diag(np.subtract(high, low)), np.array(low, dtype=float)
    sides = (
        (low + z, x, y),
        (low, y, x),
        (low, x, z),
        (low + y, z, x),
        (low, z, y),
        (low + x, y, z),
    )
    return joined(*(grid(*side, (2, 2)) for side in sides))


def floor(wide=6.0, deep=4.0, z=0.0):
    return grid((0, 0, z), wide * X, deep * Y, (30, 20))


def cameras(*points):
    return np.array(points, dtype=float)


@pytest.mark.parametrize(("door", "rooms"), [(0.9, 1), (0.3, 2)])
def test_two_rooms_are_one_region_through_a_door_that_is_wide_enough(door, rooms):
    walls = [block((2.9, 0, 0), (3.1, 1.5, 2.5)), block((2.9, 1.5 + door, 0), (3.1, 4, 2.5))]
    ground = walkable(terrain(*joined(floor(), *walls)))
    large = ground.areas[ground.areas > 3.0]
    assert len(large) == rooms
    # Beside the walls half a robot's width is lost, and some at the rim of the floor.
    assert large.sum() == pytest.approx(20.5, abs=1.0)


def test_a_wall_without_thickness_parts_two_rooms_as_well():
    sheet = grid((3, 0, 0), 4 * Y, 2.5 * Z, (8, 8))
    parted = walkable(terrain(*joined(floor(), sheet)))
    assert (parted.areas > 3.0).sum() == 2
    low = walkable(terrain(*joined(floor(), grid((3, 0, 0), 4 * Y, 0.2 * Z, (8, 8)))))
    assert (low.areas > 3.0).sum() == 1  # It is stepped over.


def test_a_table_is_no_floor_and_the_floor_goes_on_below_it_where_there_is_headroom():
    table, cupboard = block((1, 1, 0.7), (3, 3, 0.75)), block((4, 1, 0.0), (5.5, 3, 0.9))
    ground = walkable(terrain(*joined(floor(), table, cupboard)))
    region = ground.walked(cameras((0.5, 0.5, 1.5), (2, 2, 1.6), (3.5, 3.5, 1.5)))
    assert region == 0
    assert ground.height(region) == pytest.approx(0.0, abs=1e-6)
    below = ground.under(region, np.array([[2.0, 2.0], [4.75, 2.0]]))
    assert below[0] == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(below[1])
    heights = {round(ground.height(i), 2) for i in range(len(ground.areas))}
    assert heights == {0.0, 0.75, 0.9}


def test_of_two_storeys_it_is_the_one_that_the_cameras_walked_on():
    ground = walkable(terrain(*joined(floor(), block((0, 0, 2.5), (5, 4, 2.7)))))
    below, above = (cameras((1, 1, z), (2, 2, z), (4, 2, z)) for z in (1.5, 4.2))
    assert ground.height(ground.walked(below)) == pytest.approx(0.0, abs=1e-6)
    assert ground.height(ground.walked(above)) == pytest.approx(2.7, abs=1e-6)
    assert ground.height(ground.largest(2.7)) == pytest.approx(2.7, abs=1e-6)
    assert ground.largest() == 0


@pytest.mark.parametrize(("rise", "joins"), [(0.16, True), (0.4, False)])
def test_stairs_join_two_levels_if_a_robot_can_step_so_high(rise, joins):
    steps = [block((2 + 0.3 * i, 1, 0), (2 + 0.3 * (i + 1), 3, rise * (i + 1))) for i in range(5)]
    top = block((3.5, 0, 0), (6, 4, 5 * rise))
    ground = walkable(terrain(*joined(floor(), *steps, top)))
    region = ground.points[ground.region == 0]
    assert (np.ptp(region[:, 2]) > 4.5 * rise) == joins


def test_a_ceiling_seen_from_above_and_a_steep_slope_are_no_ground():
    ceiling = grid((0, 0, 2.5), 4 * Y, 6 * X, (20, 20))
    ground = walkable(terrain(*joined(floor(), ceiling)))
    assert np.abs(ground.points[:, 2]).max() < 1e-6
    steep = grid((0, 0, 0), (3, 0, 4), 4 * Y, (20, 20))
    assert not len(walkable(terrain(*steep)).areas)
    assert walkable(terrain(*steep)).walked(cameras((0, 0, 2))) is None
    assert walkable(terrain(*steep)).largest(0.0) is None
