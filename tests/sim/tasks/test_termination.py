"""How trials end."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.tasks.course import CourseProgress, Termination, distance_to_polyline

PROTOCOLS = (STRICT, NEVERWHERE_2026)
TRAIL = np.array([(2.0, 0.0, 0.3), (4.0, 0.0, 0.0)])


def robot_at(x=0.0, y=0.0, z=0.3, *, roll=0.0, pitch=0.0, force=0.0):
    return SimpleNamespace(
        roll_pitch_yaw=np.array((roll, pitch, 0.0)),
        uprightness=float(np.cos(roll) * np.cos(pitch)),
        monitored_force=lambda: force,
        trunk_position=np.array((x, y, z)),
        scene=SimpleNamespace(ground=SimpleNamespace(z=0.0)),
    )


def outcome(world, *, protocol=STRICT, step=1, progress=None, trail=TRAIL):
    progress = CourseProgress(trail, protocol) if progress is None else progress
    return Termination(trail, (0.0, 0.0), protocol=protocol).check(world, progress, step)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_tilting_beyond_1_2_rad_is_a_fall(protocol):
    for angle in (1.21, -1.21):
        assert outcome(robot_at(roll=angle), protocol=protocol) == "fell"
        assert outcome(robot_at(pitch=angle), protocol=protocol) == "fell"
    assert outcome(robot_at(roll=1.19, pitch=-1.19), protocol=protocol) is None


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_more_than_10_newtons_on_a_monitored_geom_is_a_collision(protocol):
    assert outcome(robot_at(force=10.1), protocol=protocol) == "collided"
    assert outcome(robot_at(force=9.9), protocol=protocol) is None


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_without_contact_termination_collisions_are_only_counted(protocol):
    ending = Termination(TRAIL, (0.0, 0.0), protocol=protocol, contact_termination=False)
    progress = CourseProgress(TRAIL, protocol)
    for step, force in enumerate((0.0, 500.0, 9.9, 10.1), start=1):
        assert ending.check(robot_at(force=force), progress, step) is None
    assert ending.contact_seconds == pytest.approx(2 * 0.02)
    other = Termination(TRAIL, (0.0, 0.0), protocol=protocol, contact_termination=False)
    state = ending.state()
    assert state == json.dumps(json.loads(state)).encode()
    other.restore(state)
    assert other.check(robot_at(force=20.0), progress, 5) is None
    assert other.contact_seconds == pytest.approx(3 * 0.02)
    assert other.check(robot_at(force=500.0, roll=2.0), progress, 6) == "fell"


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_clock_ends_a_trial_at_step_600(protocol):
    trail = np.array([(60.0, 0.0, 0.0)])
    ending = Termination(trail, (0.0, 0.0), protocol=protocol)
    progress = CourseProgress(trail, protocol)
    ends = [ending.check(robot_at(x=0.02 * step), progress, step) for step in range(1, 601)]
    assert ends[:-1] == [None] * 599
    assert ends[-1] == "timeout"


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_completing_the_trail_counts_before_anything_else(protocol):
    progress = CourseProgress(TRAIL[:1], protocol)
    for _ in range(7):
        progress.update(TRAIL[0])
    fallen = robot_at(roll=2.0, force=500.0)
    ending = Termination(TRAIL[:1], (0.0, 0.0), protocol=protocol)
    assert ending.check(fallen, progress, 600) == "completed"


def test_leaving_the_trail_ends_a_strict_trial_only():
    away, below = robot_at(x=3.0, y=2.1), robot_at(z=-1.1)
    assert outcome(away) == "off_course"
    assert outcome(below) == "off_course"
    assert outcome(robot_at(x=3.0, y=1.9)) is None
    assert outcome(away, protocol=NEVERWHERE_2026) is None
    assert outcome(below, protocol=NEVERWHERE_2026) is None


def test_going_nowhere_for_4_s_ends_a_strict_trial():
    ending, progress = Termination(TRAIL, (0.0, 0.0)), CourseProgress(TRAIL)
    # 0.2 m nearer to the end at 1 s, then swaying by 0.1 m.
    for step in range(1, 251):
        x = 0.0 if step < 50 else 0.2 + 0.05 * np.sin(step)
        end = ending.check(robot_at(x=x), progress, step)
        if end is not None:
            break
    assert end == "stuck"
    assert step == pytest.approx(250, abs=1)


def test_slow_progress_is_progress():
    # 5 cm/s, which is 0.2 m in 4 s.
    ending, progress = Termination(TRAIL, (0.0, 0.0)), CourseProgress(TRAIL)
    for step in range(1, 600):
        assert ending.check(robot_at(x=0.001 * step), progress, step) is None


def test_walking_the_wrong_way_is_no_progress():
    ending, progress = Termination(TRAIL, (0.0, 0.0)), CourseProgress(TRAIL)
    ends = [ending.check(robot_at(x=-0.005 * step), progress, step) for step in range(1, 201)]
    assert ends[-1] == "stuck"
    assert not any(ends[:-1])


def test_a_restored_judge_remembers_how_long_it_has_waited():
    ending, progress = Termination(TRAIL, (0.0, 0.0)), CourseProgress(TRAIL)
    for step in range(1, 150):
        ending.check(robot_at(), progress, step)
    other = Termination(TRAIL, (0.0, 0.0))
    state = ending.state()
    assert state == json.dumps(json.loads(state)).encode()
    other.restore(state)
    assert other.check(robot_at(), progress, 199) is None
    assert other.check(robot_at(), progress, 200) == "stuck"


def test_distance_to_the_trail_is_that_to_the_nearest_segment():
    corners = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0)])
    for point, expected in (
        ((1.0, 0.5), 0.5),  # beside the first segment
        ((3.0, 1.0), 1.0),  # beside the second
        ((-3.0, 4.0), 5.0),  # before the start: 3-4-5
        ((2.0, 2.0), 0.0),
    ):
        assert distance_to_polyline(np.array(point), corners) == pytest.approx(expected)
    doubled = np.array([(1.0, 1.0), (1.0, 1.0)])
    assert distance_to_polyline(np.array((1.0, 3.0)), doubled) == pytest.approx(2.0)


def play(world, targets, protocol):
    progress = CourseProgress(world.scene.trail, protocol)
    ending = Termination(world.scene.trail, world.scene.spawn.position, protocol=protocol)
    while True:
        world.step(targets)
        progress.update(world.trunk_position)
        end = ending.check(world, progress, world.steps)
        if end is not None:
            return end, progress.fraction, world.time


@pytest.mark.parametrize(("protocol", "how"), [(STRICT, "stuck"), (NEVERWHERE_2026, "timeout")])
def test_doing_nothing_scores_nothing(go1, protocol, how):
    with World(go1, get_scene("hurdles/one_low_carpet"), protocol=protocol) as world:
        end, fraction, time = play(world, go1.default_pose, protocol)
    assert (end, fraction) == (how, 0.0)
    assert time == pytest.approx(4.0 if how == "stuck" else 12.0)


def test_a_head_in_a_wall_is_a_collision_in_both_protocols(go1, place):
    # The head's cube ends 0.32 m ahead of the trunk; the wall begins 1 cm before that.
    scene = place(((0.41, 0.0, 0.5), (0.1, 1.0, 0.5)))
    for protocol in PROTOCOLS:
        with World(go1, scene, protocol=protocol) as world:
            end, _, time = play(world, go1.default_pose, protocol)
            assert end == "collided"
            assert time < 0.1
            assert world.monitored_forces()["face"] > 10.0


def test_a_belly_on_a_bar_is_a_collision_under_strict_only(go1, place):
    # A bar under the trunk, too high to stand over: the robot drops onto it.
    scene = place(((0.0, 0.0, 0.15), (0.05, 0.04, 0.15)))
    ends = {}
    for protocol in PROTOCOLS:
        with World(go1, scene, protocol=protocol) as world:
            world.reset(position=(0, 0, 0.42), yaw=0.0)
            ends[protocol.name], _, _ = play(world, go1.default_pose, protocol)
    assert ends == {"strict": "collided", "neverwhere-2026": "timeout"}
