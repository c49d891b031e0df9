"""Stereo depth against the figures that Intel publishes for the D400 series."""

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.errors import PolicyError
from nw_policies.cards.joint_control import mounted_robot
from nw_policies.cards.observations import DepthObservation
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.sensors import build_sensors
from nw_sim.sensors.build import check_card

FOCAL = 424.0  # D435: 848 columns over 90 degrees
VIEW = {"width": 848, "height": 24, "fx": FOCAL, "fy": FOCAL, "cx": 424.0, "cy": 12.0}
EYE = (0.27, 1.0)  # x and z of a Go1's camera when its trunk is at (0, 0, 0.985)


@pytest.fixture
def seen(place, card_of, moment_of):
    def see(*boxes, seed=1, step=0, **stereo):
        stereo = {"subpixel": 0.0} | stereo
        size = {"width": 848, "height": 24}
        card = card_of(
            {"d": {"sensor": "depth", **size, "stereo": stereo}},
            cameras={"ego": {"intrinsics": VIEW}},
        )
        with World(mounted_robot(get_robot("go1"), card), place(*boxes)) as world:
            world.reset(position=(0.0, 0.0, EYE[1] - 0.015), yaw=0.0)
            (sensor,) = build_sensors(card, world).values()
            sensor.reset(seed)
            return sensor.read(moment_of(world, step))

    return see


def wall(depth, left=-30.0, right=30.0):
    """A wall across, so far before the camera; `left` and `right` in m, to the camera's right."""
    y = -0.5 * (left + right)
    return (EYE[0] + depth + 0.05, y, EYE[1]), (0.05, 0.5 * (right - left), 0.9)


def test_the_left_border_has_no_depth_in_a_band_of_b_f_over_z(seen):
    """Data sheet 337029, "Invalid Depth Band": B F / Z pixels, 21.2 at 1 m for a D435."""
    for depth, band in ((1.0, 21), (0.5, 42), (2.0, 11)):
        valid = seen(wall(depth)) > 0.0
        assert not valid[:, : band - 1].any()
        assert valid[:, band + 1 :].all()


def test_the_error_grows_with_the_square_of_the_distance(seen):
    """ "Tuning depth cameras": RMS error = Z^2 subpixel / (f B); data sheet: below 2 % at 2 m."""
    for depth, millimetres in ((1.0, 3.77), (2.0, 15.1)):
        metres = seen(wall(depth), subpixel=0.08)[:, 60:]
        error = metres - depth
        assert np.sqrt((error**2).mean()) == pytest.approx(millimetres / 1e3, rel=0.05)
        assert abs(np.median(error)) < 0.3e-2 * depth
    assert np.sqrt((error**2).mean()) < 0.02 * 2.0


def test_disparity_comes_in_steps_of_a_thirty_second_pixel(seen):
    """ "Subpixel linearity": 1/32 pixel, which is Z^2 / (32 f B) = 6 mm at 2 m."""
    metres = np.unique(seen(wall(2.0), subpixel=0.08)[:, 60:])
    near = metres[np.abs(metres - 2.0) < 0.02]
    assert np.diff(near) == pytest.approx(4.0 / (32 * FOCAL * 0.05), abs=0.0012)
    np.testing.assert_allclose(metres * 1000, np.rint(metres * 1000), atol=1e-3)


@pytest.mark.parametrize(
    ("degrees", "width", "baseline", "millimetres"),
    [(87, 848, 0.018, 70), (87, 1280, 0.018, 100), (87, 640, 0.018, 55), (90, 848, 0.05, 195)],
)
def test_nearer_than_the_data_sheets_minimum_there_is_no_depth(
    degrees, width, baseline, millimetres
):
    """Minimum Z of a D405 and a D435; Intel's tables are 4 to 16 % above its own f B / 126."""
    focal = width / 2 / np.tan(np.radians(degrees / 2))
    least = 1e3 * focal * baseline / 126
    assert 0.84 * millimetres < least < millimetres


def test_what_is_too_near_or_too_far_reads_zero_or_what_the_card_says(seen):
    least = FOCAL * 0.05 / 126
    assert (seen(wall(0.97 * least))[:, 140:] == 0.0).all()
    assert (seen(wall(1.03 * least))[:, 140:] > 0.0).all()
    assert (seen(wall(12.0)) == 0.0).all()
    assert (seen(wall(12.0), max_range=15.0)[:, 30:] > 0.0).all()
    assert (seen(wall(12.0), invalid=9.0) == 9.0).all()


def test_a_shadow_lies_left_of_a_near_edge_as_wide_as_the_disparities_differ(seen):
    """The left imager sees past the left edge of a near box what the right one does not."""
    image = seen(wall(1.0, -0.1, 0.1), wall(3.0))
    row = image[12]
    first = int(424 - 0.1 * FOCAL)  # of the box
    width = FOCAL * 0.05 * (1 / 1.0 - 1 / 3.0)  # 14 pixels
    assert row[first + 3] == pytest.approx(1.0, abs=0.01)
    assert row[first - 3] == row[int(first - width + 3)] == 0.0
    assert row[int(first - width - 3)] == pytest.approx(3.0, abs=0.02)
    assert row[int(424 + 0.1 * FOCAL) + 3] == pytest.approx(3.0, abs=0.02), "none at its right"


def test_errors_are_the_trials_own(seen):
    one, again, other, later = (
        seen(wall(2.0), subpixel=0.08, **which) for which in ({}, {}, {"seed": 2}, {"step": 5})
    )
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)
    assert not np.array_equal(one, later)


def test_cards_without_it_keep_their_digest_and_what_contradicts_it_is_refused(card_of):
    assert "stereo" not in DepthObservation(sensor="depth").model_dump()
    with pytest.raises(ValidationError, match="`supersample` averages rays"):
        DepthObservation(sensor="depth", supersample=2, stereo={})
    bent = {"model": "fisheye", "coefficients": [0.0] * 4}
    card = card_of(
        {"d": {"sensor": "depth", "stereo": {}}},
        cameras={"ego": {"intrinsics": VIEW | {"distortion": bent}}},
    )
    with pytest.raises(PolicyError, match="'ego' has distortion; give the intrinsics of the rect"):
        check_card(card)
