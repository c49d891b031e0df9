"""Waypoints: when they are credited and in which order."""

import json

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_sim.tasks.course import CourseProgress

PROTOCOLS = (STRICT, NEVERWHERE_2026)
NEAR, FAR = (0.0, 0.0), (5.0, 5.0)


def trail(*points, protocol=STRICT):
    return CourseProgress(np.array(points, dtype=float), protocol)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_entering_at_step_n_and_staying_gives_credit_at_n_plus_6(protocol):
    # Published: in range at steps n to n + 5, credited at n + 6.
    progress = trail((0, 0, 0), protocol=protocol)
    entered = 4
    credited = [progress.update(NEAR if step >= entered else FAR) for step in range(1, 15)]
    assert credited.index(True) + 1 == entered + 6
    assert sum(credited) == 1
    assert progress.fraction == 1.0
    assert progress.times == pytest.approx((0.02 * (entered + 6),))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_sixth_step_counts_even_if_the_robot_is_gone_at_the_seventh(protocol):
    progress = trail((0, 0, 0), protocol=protocol)
    for _ in range(6):
        assert not progress.update(NEAR)
    assert progress.update(FAR)


def test_five_steps_are_not_enough():
    for protocol in PROTOCOLS:
        progress = trail((0, 0, 0), protocol=protocol)
        for _ in range(5):
            progress.update(NEAR)
        for _ in range(50):
            assert not progress.update(FAR)
        assert progress.reached == 0


def test_leaving_starts_the_count_again_only_under_strict():
    for protocol, expected in ((STRICT, 0), (NEVERWHERE_2026, 1)):
        progress = trail((0, 0, 0), protocol=protocol)
        for _ in range(20):
            for place in (NEAR, NEAR, NEAR, FAR):
                progress.update(place)
        assert progress.reached == expected


def test_waypoints_count_in_order():
    progress = trail((1, 0, 0), (2, 0, 0), (3, 0, 0))
    for _ in range(20):  # Standing on the second is worth nothing before the first.
        progress.update((2.0, 0.0))
    assert (progress.reached, progress.index) == (0, 0)
    for x in (1.0, 2.0, 3.0):
        np.testing.assert_array_equal(progress.target, (x, 0, 0))
        for _ in range(7):
            progress.update((x, 0.0))
    assert progress.fraction == 1.0
    assert list(progress.times) == sorted(progress.times)
    assert len(progress.times) == 3


def test_distance_is_measured_on_the_ground_and_the_border_is_outside():
    inside, border = trail((0, 0, 7)), trail((0, 0, 0))
    for _ in range(10):
        inside.update((0.2999, 0.0, -3.0))
        border.update((0.3, 0.0))
    assert inside.fraction == 1.0
    assert border.fraction == 0.0


def test_close_waypoints_take_one_count_each():
    # Published: steps 0.19 m apart can be credited one after the other while standing still.
    # The credit of one and the first step for the next fall together: every 6 steps.
    progress = trail((0, 0, 0), (0.19, 0, 0), (0.25, 0, 0))
    credited = [step for step in range(1, 40) if progress.update((0.1, 0.0))]
    assert credited == [7, 13, 19]


def test_after_the_last_one_nothing_changes():
    progress = trail((0, 0, 0))
    credited = sum(progress.update(NEAR) for _ in range(100))
    assert credited == 1
    assert (progress.index, progress.reached, progress.total) == (0, 1, 1)


def test_a_restored_trail_goes_on_where_it_was():
    progress = trail((0, 0, 0), (0.1, 0, 0))
    for _ in range(9):
        progress.update(NEAR)
    middle = progress.state()
    expected = [progress.update(NEAR) for _ in range(10)]
    assert progress.times
    assert progress.state() == json.dumps(json.loads(progress.state())).encode()
    other = trail((0, 0, 0), (0.1, 0, 0))
    other.restore(middle)
    assert [other.update(NEAR) for _ in range(10)] == expected
    assert other.times == progress.times


def test_a_trail_needs_a_waypoint():
    with pytest.raises(SceneError, match="the course has no waypoints"):
        CourseProgress(np.zeros((0, 3)))
