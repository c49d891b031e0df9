"""Where trials begin."""

import dataclasses

import numpy as np
import pytest

from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_base.trials import Trial
from nw_sim.tasks.course import draw_start

# Measured on the published evaluation (MuJoCo 3.1.6), seeds 10000 and 10001: the spawn offsets of
# scenes with one to four waypoints.
PUBLISHED = {
    (0, 1): (-0.063955318, 0.017740010, -0.075845020),
    (0, 2): (-0.075845020, 0.010939750, -0.083594764),
    (0, 3): (-0.083594764, 0.098541035, -0.049456148),
    (0, 4): (-0.049456148, 0.006592003, 0.078427819),
    (1, 1): (0.004707770, -0.068459998, 0.078446371),
    (1, 2): (0.078446371, 0.038801258, 0.080090814),
    (1, 3): (0.080090814, 0.016881237, -0.038980608),
    (1, 4): (-0.038980608, -0.031723137, -0.045573228),
}


def start(*, protocol, index=0, waypoints=3, seed=5, noise=(0.1, 0.3)):
    trail = np.column_stack(
        [np.arange(1.0, waypoints + 1), np.zeros(waypoints), np.ones(waypoints)]
    )
    trial = Trial(
        suite="s",
        suite_digest="d",
        suite_seed=seed,
        scene="hurdles/x",
        scene_digest="e",
        task="hurdles",
        index=index,
    )
    drawn = draw_start(
        trial,
        protocol=protocol,
        spawn=(0.0, 0.0, 0.0),
        jitter=(0.1, 0.1, 0.1),
        trail=trail,
        waypoint_noise=noise,
    )
    return drawn, trail


@pytest.mark.parametrize(("index", "waypoints"), PUBLISHED)
def test_the_published_protocol_spawns_where_the_published_evaluation_does(index, waypoints):
    drawn, _ = start(protocol=NEVERWHERE_2026, index=index, waypoints=waypoints)
    expected = PUBLISHED[index, waypoints]
    np.testing.assert_allclose((drawn.x, drawn.y, drawn.yaw), expected, atol=5e-10)


def test_the_published_protocol_moves_no_waypoint():
    drawn, trail = start(protocol=NEVERWHERE_2026)
    np.testing.assert_array_equal(drawn.waypoints, trail)


def test_its_noise_moves_waypoints_and_no_start_where_it_acts():
    acting = dataclasses.replace(NEVERWHERE_2026, waypoint_noise_acts=True)
    drawn, trail = start(protocol=acting, waypoints=200)
    still, _ = start(protocol=NEVERWHERE_2026, waypoints=200)
    assert (drawn.x, drawn.y, drawn.yaw) == (still.x, still.y, still.yaw)
    shift = np.abs(drawn.waypoints - trail).max(axis=0)
    assert 0.08 < shift[0] <= 0.1
    assert 0.25 < shift[1] <= 0.3
    assert shift[2] == 0.0


def test_the_strict_protocol_moves_waypoints_within_their_noise_and_never_up():
    drawn, trail = start(protocol=STRICT, waypoints=200)
    shift = drawn.waypoints - trail
    assert np.abs(shift[:, 0]).max() <= 0.1
    assert 0.25 < np.abs(shift[:, 1]).max() <= 0.3
    assert not shift[:, 2].any()


def test_the_spawn_does_not_depend_on_the_number_of_waypoints():
    few, _ = start(protocol=STRICT, waypoints=2)
    many, _ = start(protocol=STRICT, waypoints=9)
    assert (few.x, few.y, few.yaw) == (many.x, many.y, many.yaw)


def test_two_seeds_start_differently():
    one, _ = start(protocol=STRICT, seed=1)
    two, _ = start(protocol=STRICT, seed=2)
    assert one.x != two.x
