import numpy as np
import pytest

from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.sensors import build_sensors
from nw_sim.sensors.heights import grid

DOTS = {"dots": {"sensor": "scandots"}}


@pytest.fixture
def scan(card_of, moment_of):
    """A function: the scan of a scene with the robot's trunk at a position, (12, 11)."""

    def scan(scene, position, yaw=0.0, protocol=STRICT):
        with World(get_robot("go1"), scene, protocol=protocol) as world:
            world.reset(position=position, yaw=yaw)
            sensor = build_sensors(card_of(DOTS), world)["dots"]
            sensor.reset(0)
            return sensor.read(moment_of(world)).reshape(12, 11)

    return scan


def test_flat_ground_reads_as_the_height_of_the_trunk(scan, place):
    # trunk_z + 0.0143 - 0.3, the published constants of a Go1.
    np.testing.assert_allclose(scan(place(), (0.0, 0.0, 0.3)), 0.0143, atol=1e-6)


def test_a_box_ahead_to_the_left_is_seen_there_and_nowhere_else(scan, place):
    # Points stand at x = -0.45 + 0.15 i and y = -0.75 + 0.15 j: i = 8, 9, j = 6..8 are inside.
    box = ((0.8, 0.3, 0.1), (0.1, 0.2, 0.1))
    seen = scan(place(box), (0.0, 0.0, 0.3))
    inside = np.zeros((12, 11), dtype=bool)
    inside[8:10, 6:9] = True
    np.testing.assert_allclose(seen[inside], 0.0143 - 0.2, atol=1e-6)
    np.testing.assert_allclose(seen[~inside], 0.0143, atol=1e-6)


def test_the_grid_turns_with_the_robot(scan, place):
    # Turned left by a quarter, what was ahead and left lies at x = -left, y = ahead.
    box = ((-0.3, 0.8, 0.1), (0.2, 0.1, 0.1))
    turned = scan(place(box), (0.0, 0.0, 0.3), yaw=np.pi / 2)
    straight = scan(place(((0.8, 0.3, 0.1), (0.1, 0.2, 0.1))), (0.0, 0.0, 0.3))
    np.testing.assert_allclose(turned, straight, atol=1e-6)


def test_heights_are_limited_to_a_metre(scan, place):
    assert scan(place(), (0.0, 0.0, 3.0)).max() == 1.0
    tall = ((0.5, 0.0, 2.0), (0.2, 0.2, 2.0))
    assert scan(place(tall), (0.0, 0.0, 0.3)).min() == -1.0


def test_no_ground_reads_as_far_below(scan, place):
    assert scan(place(), (39.5, 0.0, 0.3)).max() == 1.0


@pytest.mark.parametrize(("count", "shape"), [(5, 15), (1, 3)])
def test_the_grid_is_the_cards(count, shape, place, card_of):
    card = card_of({"dots": {"sensor": "scandots", "x": [0.0, 1.0, count], "y": [-0.1, 0.1, 3]}})
    with World(get_robot("go1"), place()) as world:
        assert build_sensors(card, world)["dots"].shape == (shape,)


# Two columns of three points, in the two orders, written out by hand: (ahead, left) in m.
GRID = ((0.0, 2.0, 3), (-0.5, 0.5, 2))
Y_FASTEST = [(0.0, -0.5), (0.0, 0.5), (1.0, -0.5), (1.0, 0.5), (2.0, -0.5), (2.0, 0.5)]
X_FASTEST = [(0.0, -0.5), (1.0, -0.5), (2.0, -0.5), (0.0, 0.5), (1.0, 0.5), (2.0, 0.5)]


def test_points_are_counted_in_the_order_of_the_card():
    assert [tuple(point) for point in grid(*GRID, "y_fastest").tolist()] == Y_FASTEST
    assert [tuple(point) for point in grid(*GRID, "x_fastest").tolist()] == X_FASTEST
    np.testing.assert_array_equal(grid(*GRID), grid(*GRID, "y_fastest"))


@pytest.mark.parametrize("protocol", [STRICT, NEVERWHERE_2026])
@pytest.mark.parametrize(("order", "seen"), [("y_fastest", Y_FASTEST), ("x_fastest", X_FASTEST)])
def test_a_box_is_seen_at_its_number_in_either_order(
    order, seen, protocol, place, card_of, moment_of
):
    # The box stands under the point 1 m ahead and 0.5 m to the left alone. The published scan reads
    # its farther points at 1.31 m, which is beyond the box too.
    dots = {"sensor": "scandots", "x": GRID[0], "y": GRID[1], "order": order}
    box = ((1.0, 0.5, 0.1), (0.2, 0.2, 0.1))
    with World(get_robot("go1"), place(box), protocol=protocol) as world:
        world.reset(position=(0.0, 0.0, 0.3), yaw=0.0)
        sensor = build_sensors(card_of({"dots": dots}), world)["dots"]
        sensor.reset(0)
        numbers = sensor.read(moment_of(world))
    low = 0.0143 - 0.2
    wanted = [low if point == (1.0, 0.5) else 0.0143 for point in seen]
    np.testing.assert_allclose(numbers, wanted, atol=2e-3)


def test_a_card_that_leaves_the_order_out_is_the_card_that_it_was(card_of):
    # The digest of a policy is made of these fields: a new key must not change it.
    said, unsaid = ({"sensor": "scandots"} | more for more in ({"order": "y_fastest"}, {}))
    fields = [
        card_of({"dots": dots}).model_dump()["observations"]["dots"] for dots in (said, unsaid)
    ]
    assert fields[0] == fields[1]
    assert "order" not in fields[1]
    turned = card_of({"dots": {"sensor": "scandots", "order": "x_fastest"}})
    assert turned.model_dump(mode="json")["observations"]["dots"]["order"] == "x_fastest"


def test_the_published_scan_equals_the_exact_one_in_the_default_stance(scan, place):
    # Its constants were measured there: 1.43 cm above 25 m over the trunk.
    published = scan(place(), (0.0, 0.0, 0.3), protocol=NEVERWHERE_2026)
    np.testing.assert_allclose(published, 0.0143, atol=1e-3)


def test_the_published_scan_reads_pixels(scan, place):
    # The point at x = 0.75 falls on the pixel int(0.75 * 183.1789) = 137, read at 136.5 / 183.1789
    # = 0.7452 at 25 m, in the image of a camera that stands 2.443 cm behind the centre of mass and
    # 25.3143 m above this ground.
    def ahead(edge):
        box = ((edge + 0.2, 0.0, 0.0005), (0.2, 2.0, 0.0005))
        seen = scan(place(box), (0.0, 0.0, 0.3), protocol=NEVERWHERE_2026)
        return seen[8, 5] < seen[0, 5] - 0.0005

    with World(get_robot("go1"), place()) as world:
        world.reset(position=(0.0, 0.0, 0.3), yaw=0.0)
        where = world.center_of_mass[0] - 0.02443 + 136.5 / 183.1789 * (25.3143 / 25.0)
    assert ahead(where - 0.001)
    assert not ahead(where + 0.001)


def test_the_published_scan_ends_at_the_border_of_its_image(scan, place):
    # Half the image is 1.31 m; turned by 30 degrees, the farthest corner lies 1.41 m away.
    box = ((1.6, 0.0, 0.1), (0.265, 3.0, 0.1))  # From 1.335 m on.
    exact = scan(place(box), (0.0, 0.0, 0.3), yaw=0.5)
    published = scan(place(box), (0.0, 0.0, 0.3), yaw=0.5, protocol=NEVERWHERE_2026)
    assert (exact < -0.1).any()
    assert not (published < -0.1).any()
