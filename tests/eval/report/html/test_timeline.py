"""One trial over time: the numbers of its chart, against walks whose speed is known."""

import re

import numpy as np
import pytest

from nw_eval.reporting.html.drawn import BOTTOM, LEFT, RIGHT, TOP, timeline
from nw_eval.reporting.html.evidence import WalkedPath


def walked(speeds, period=0.1, **facts):
    """A walk ahead at some speeds, m/s, one for each period."""
    x = np.concatenate([[0.0], np.cumsum(np.asarray(speeds) * period)])
    points = np.stack([x, np.zeros_like(x)], axis=1)
    return WalkedPath(trial_id="hurdles-high-000", points=points, period=period, **facts)


def speeds_of(chart):
    """Read m/s back from the drawn line."""
    points = [tuple(map(float, each.split())) for each in re.split("[ML]", chart.line)[1:]]
    return [chart.top_speed * (BOTTOM - y) / (BOTTOM - TOP) for _, y in points]


def test_the_line_is_the_speed_of_the_walk(make_row):
    row = make_row("hurdles/high", 0, 2)
    speeds = [0.4, 0.8, 1.2, 0.6]
    chart = timeline(row, walked(speeds))
    assert chart.top_speed == pytest.approx(1.2)
    assert speeds_of(chart) == pytest.approx(speeds, abs=0.02)
    slow = timeline(row, walked(speeds, period=0.096))
    assert speeds_of(slow) == pytest.approx(speeds, abs=0.02)


def test_waypoints_contacts_and_the_end_stand_at_their_times(make_row):
    row = make_row("hurdles/high", 0, 2)
    rival = make_row("hurdles/high", 0, 4, waypoint_times=(1.0, 2.0, 3.0, 6.0), sim_s=6.0)
    chart = timeline(row, walked([1.0] * int(10 * row.sim_s), contacts=(1.0,)), rival)
    span = rival.waypoint_times[-1]

    def at(time):
        return pytest.approx(LEFT + (RIGHT - LEFT) * time / span, abs=0.06)

    assert [x for x, _ in chart.waypoints] == [at(time) for time in row.waypoint_times]
    assert [number for _, number in chart.baseline_waypoints] == [1, 2, 3, 4]
    assert [x for x, _ in chart.baseline_waypoints] == [at(time) for time in rival.waypoint_times]
    assert chart.contacts == (at(1.0),)
    assert chart.end[0] == at(row.sim_s)
    assert chart.words.startswith(f"Speed over {row.sim_s:.1f} s, 1.00 m/s on average, waypoint 1 ")
    assert chart.words.endswith(f"contact at 1.0 s, {row.outcome} at {row.sim_s:.1f} s.")


def test_an_hour_is_drawn_with_few_points_and_the_same_mean(make_row):
    speeds = np.random.Generator(np.random.PCG64(3)).uniform(0.2, 1.4, 36_000)
    chart = timeline(make_row("hurdles/high", 0, 4, sim_s=3600.0), walked(speeds))
    drawn = speeds_of(chart)
    assert len(drawn) <= 150
    assert len(chart.line) < 2500
    assert np.mean(drawn) == pytest.approx(speeds.mean(), abs=0.02)


@pytest.mark.parametrize("points", [np.zeros((1, 2)), np.zeros((0, 2)), np.full((9, 2), np.nan)])
def test_a_walk_without_a_speed_has_no_chart(make_row, points):
    path = WalkedPath(trial_id="hurdles-high-000", points=points)
    assert timeline(make_row("hurdles/high", 0, 0), path) is None


def test_a_last_point_just_behind_the_one_before_is_no_sprint(make_row):
    """The trial ended 3 ms after a sample: 5 mm in that time would read as 50 m/s over a step."""
    path = walked([0.5] * 40)
    points = np.concatenate([path.points, path.points[-1:] + np.array([0.005, 0.0])])
    row = make_row("hurdles/high", 0, 4)
    assert row.sim_s == pytest.approx(4.0)
    chart = timeline(row, WalkedPath(trial_id=path.trial_id, points=points))
    assert max(speeds_of(chart)) < 0.52
