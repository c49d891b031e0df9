import numpy as np
import pytest

from nw_eval.robots import get_robot
from nw_eval.sensors import build_sensors
from nw_eval.sim import World

DOTS = {"dots": {"sensor": "scandots"}}


@pytest.fixture
def scan(card_of, moment_of):
    """A function: the scan of a scene with the robot's trunk at a position, (12, 11)."""

    def scan(scene, position, yaw=0.0, protocol="strict"):
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


def test_the_published_scan_equals_the_exact_one_in_the_default_stance(scan, place):
    # Its constants were measured there: 1.43 cm above 25 m over the trunk.
    published = scan(place(), (0.0, 0.0, 0.3), protocol="neverwhere-2026")
    np.testing.assert_allclose(published, 0.0143, atol=1e-3)


def test_the_published_scan_reads_pixels(scan, place):
    # The point at x = 0.75 falls on the pixel int(0.75 * 183.1789) = 137, read at 136.5 / 183.1789
    # = 0.7452 at 25 m, in the image of a camera that stands 2.443 cm behind the centre of mass and
    # 25.3143 m above this ground.
    def ahead(edge):
        box = ((edge + 0.2, 0.0, 0.0005), (0.2, 2.0, 0.0005))
        seen = scan(place(box), (0.0, 0.0, 0.3), protocol="neverwhere-2026")
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
    published = scan(place(box), (0.0, 0.0, 0.3), yaw=0.5, protocol="neverwhere-2026")
    assert (exact < -0.1).any()
    assert not (published < -0.1).any()
