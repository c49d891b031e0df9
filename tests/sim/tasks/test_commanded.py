"""Tasks that command a velocity: what they command and when, and how their trials end."""

import math
from itertools import groupby
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.trials import Trial
from nw_eval.suite.model import new_suite
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.tasks import TaskRules, fault_of, open_task

SETTINGS = {
    "nw-eval": 1,
    "name": "told",
    "robot": "go1",
    "policy": "stand",
    "trials": 1,
    "seed": 1,
    "scenes": ["open/field"],
}


def trial(index=0, seed=7):
    return Trial(
        suite="told",
        suite_digest="0" * 64,
        suite_seed=seed,
        scene="open/field",
        scene_digest="0" * 64,
        task="open",
        index=index,
    )


def settings_of(task):
    return new_suite({**SETTINGS, "task": task}).task


def begun(task, *, index=0, seed=7, duration=10.0, **rules):
    opened = open_task(settings_of(task), TaskRules(duration=duration, **rules))
    opened.reset(trial(index, seed), get_scene("open/field"), get_robot("go1"))
    return opened


def commands(task):
    return [task.commanded(step) for step in range(task.steps)]


def robot(x=0.0, y=0.0, z=0.3, *, v=(0.0, 0.0), rate=0.0, yaw=0.0, roll=0.0, force=0.0, over=0.3):
    """What a task reads of a robot; `v` is in the yaw frame."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return SimpleNamespace(
        trunk_position=np.array((x, y, z)),
        trunk_linear_velocity=np.array(
            (cosine * v[0] - sine * v[1], sine * v[0] + cosine * v[1], 0.0)
        ),
        trunk_angular_velocity=np.array((0.0, 0.0, rate)),
        roll_pitch_yaw=np.array((roll, 0.0, yaw)),
        uprightness=math.cos(roll),
        monitored_force=lambda: force,
        monitored_forces=lambda: {"face": force},
        height_over_ground=lambda: over,
        scene=SimpleNamespace(ground=SimpleNamespace(z=0.0)),
    )


def run(task, read):
    """Run a task to its end with the readings of each step; return outcome, reason and steps."""
    for step in range(task.steps):
        task.update(read(step))
        if (outcome := task.end()) is not None:
            return outcome, task.end_reason, step + 1
    raise AssertionError("a trial ends")


VELOCITY = {"kind": "velocity", "command": {"constant": {"vx": 0.5}}}
DRAWN = {
    "kind": "velocity",
    "command": {"draw": {"vx": [0.2, 1.0], "vy": [-0.3, 0.3], "yaw": [-1.0, 1.0], "every": 2.5}},
}


# What is commanded.


def test_a_constant_command_is_the_same_in_every_step():
    task = begun({"kind": "velocity", "command": {"constant": {"vx": 0.5, "yaw": -0.2}}})
    assert set(commands(task)) == {(0.5, 0.0, -0.2)}
    assert len(commands(task)) == 500


def test_steps_hold_from_their_time_on_and_zero_before_the_first():
    steps = [{"at": 2.0, "vx": 0.4}, {"at": 4.02, "vx": 0.4, "vy": 0.1, "yaw": 0.3}]
    told = commands(begun({"kind": "velocity", "command": {"steps": steps}}))
    assert told[99] == (0.0, 0.0, 0.0)
    assert told[100] == told[200] == (0.4, 0.0, 0.0)
    assert told[201] == told[499] == (0.4, 0.1, 0.3)


def test_a_sweep_is_linear_and_then_stays():
    sweep = {"vx": [0.2, 1.0], "yaw": [1.0, -1.0], "over": 8.0}
    told = commands(begun({"kind": "velocity", "command": {"sweep": sweep}}))
    assert told[0] == (0.2, 0.0, 1.0)
    assert told[200] == pytest.approx((0.6, 0.0, 0.0))
    assert told[100] == pytest.approx((0.4, 0.0, 0.5))
    assert told[400] == told[499] == pytest.approx((1.0, 0.0, -1.0))


def test_drawn_commands_change_when_they_are_to_and_lie_within_their_ranges():
    told = commands(begun(DRAWN))
    assert [len([*same]) for _, same in groupby(told)] == [125, 125, 125, 125]
    for index in range(20):
        vx, vy, yaw = np.array(commands(begun(DRAWN, index=index))).T
        assert (vx.min() >= 0.2, vx.max() <= 1.0) == (True, True)
        assert (np.abs(vy).max() <= 0.3, np.abs(yaw).max() <= 1.0) == (True, True)


def test_drawn_commands_are_those_of_the_trials_own_seed():
    assert commands(begun(DRAWN)) == commands(begun(DRAWN))
    assert commands(begun(DRAWN)) != commands(begun(DRAWN, index=1))
    assert commands(begun(DRAWN)) != commands(begun(DRAWN, seed=8))
    # A longer trial begins as a shorter one.
    assert commands(begun(DRAWN, duration=20.0))[:500] == commands(begun(DRAWN))


def test_as_many_draws_command_zero_as_asked_for():
    still = {"draw": {"vx": [0.5, 1.0], "every": 0.1, "still": 0.25}}
    told = np.array(commands(begun({"kind": "velocity", "command": still}, duration=200.0)))
    assert np.mean(told[:, 0] == 0.0) == pytest.approx(0.25, abs=0.03)


# How `velocity` is judged.


def test_who_follows_completes_and_who_stands_does_not():
    followed = begun(VELOCITY)
    assert run(followed, lambda _: robot(v=(0.5, 0.0))) == ("completed", "time", 500)
    assert (followed.success, followed.scores()) == (1.0, {"tracked_time": 1.0})
    stood = begun(VELOCITY)
    assert run(stood, lambda _: robot()) == ("timeout", "tracking", 500)
    assert (stood.success, stood.scores()) == (0.0, {"tracked_time": 0.0})


def test_velocity_counts_in_the_frame_of_the_heading():
    assert run(begun(VELOCITY), lambda _: robot(v=(0.5, 0.0), yaw=2.0))[0] == "completed"
    assert run(begun(VELOCITY), lambda _: robot(v=(0.0, 0.5), yaw=2.0))[0] == "timeout"


def test_a_trunk_that_sways_within_its_stride_follows():
    def sway(step):
        return robot(v=(0.5 + 0.5 * math.sin(2.0 * math.pi * step / 12.5), 0.0), rate=0.9)

    told = {"kind": "velocity", "command": {"constant": {"vx": 0.5, "yaw": 0.9}}}
    task = begun(told)
    assert run(task, sway)[0] == "completed"
    assert task.tracked == 1.0


@pytest.mark.parametrize(
    ("v", "rate"), [((0.29, 0.0), 0.0), ((0.5, 0.21), 0.0), ((0.5, 0.0), 0.31)]
)
def test_each_part_of_the_velocity_may_be_off_by_its_tolerance(v, rate):
    assert run(begun(VELOCITY), lambda _: robot(v=v, rate=rate))[0] == "timeout"
    wide = {**VELOCITY, "within": {"linear": 0.22, "angular": 0.32}}
    assert run(begun(wide), lambda _: robot(v=v, rate=rate))[0] == "completed"


def test_the_share_of_the_time_decides():
    def half(step):
        return robot(v=(0.5, 0.0) if step < 250 else (0.0, 0.0))

    task = begun(VELOCITY)
    assert run(task, half)[1] == "tracking"
    # 226 of 476 means over 25 steps are all good; ten more have enough good ones.
    assert task.tracked == pytest.approx(236 / 476)
    assert run(begun({**VELOCITY, "share": 0.49}), half)[0] == "completed"


def test_time_after_a_fall_is_not_tracked():
    task = begun(VELOCITY)
    read = lambda step: robot(v=(0.5, 0.0), roll=1.3 if step == 249 else 0.0)  # noqa: E731
    assert run(task, read) == ("fell", "roll", 250)
    assert task.scores()["tracked_time"] == pytest.approx(226 / 476)
    assert task.success == 0.0


def test_a_collision_ends_a_trial_or_counts_only():
    read = lambda step: robot(v=(0.5, 0.0), force=12.0 if step in {10, 11} else 0.0)  # noqa: E731
    assert run(begun(VELOCITY), read) == ("collided", "contact face", 11)
    counted = begun(VELOCITY, contact_termination=False)
    assert run(counted, read)[0] == "completed"
    assert counted.contact_seconds == pytest.approx(0.04)


def test_leaving_the_ground_or_the_area_ends_a_trial_as_off_course():
    walk = lambda step: robot(x=0.01 * step, v=(0.5, 0.0))  # noqa: E731
    assert run(begun(VELOCITY), walk)[0] == "completed"
    outcome, reason, steps = run(begun({**VELOCITY, "area": 2.0}), walk)
    assert (outcome, reason) == ("off_course", "out of the area")
    assert 180 < steps < 220, "2 m from a start within 0.1 m of the origin"
    below = lambda _: robot(z=-1.1)  # noqa: E731
    assert run(begun(VELOCITY), below) == ("off_course", "below the ground", 1)
    assert run(begun(VELOCITY), lambda _: robot(over=math.inf))[1] == "no ground"


# How `stand` is judged.


def test_who_keeps_still_completes_and_says_how_far_it_drifted():
    task = begun({"kind": "stand"})
    read = lambda step: robot(y=0.0002 * step, yaw=0.0001 * step)  # noqa: E731
    assert run(task, read) == ("completed", "time", 500)
    drifts = {"position_drift": 0.0002 * 450, "yaw_drift": 0.0001 * 450}
    assert task.scores() == pytest.approx(drifts)


def test_place_and_heading_count_from_where_it_settled():
    still = begun({"kind": "stand", "settle": 1.0})
    assert run(still, lambda step: robot(x=5.0 if step < 49 else 0.0))[0] == "completed"
    assert still.scores() == {"position_drift": 0.0, "yaw_drift": 0.0}
    moved = begun({"kind": "stand", "drift": 0.1})
    assert run(moved, lambda step: robot(x=0.0 if step < 200 else 0.11)) == (
        "timeout",
        "position drift",
        500,
    )
    assert moved.scores()["position_drift"] == pytest.approx(0.11)
    turned = begun({"kind": "stand"})
    # Across the turn from pi to -pi the heading changes by 0.3 rad.
    read = lambda step: robot(yaw=math.pi - 0.1 if step < 200 else -math.pi + 0.2)  # noqa: E731
    assert run(turned, read)[1] == "yaw drift"
    assert turned.scores()["yaw_drift"] == pytest.approx(0.3)


def test_a_robot_that_fell_has_no_drift():
    task = begun({"kind": "stand"})
    assert run(task, lambda step: robot(roll=1.3 if step == 100 else 0.0))[0] == "fell"
    assert task.scores() == {}


# How `push` is judged.

PUSH = {"kind": "push", "impulses": [{"at": 2.0, "size": 12.0, "direction": 0.5}]}


def test_a_push_is_a_force_for_its_time_into_its_direction():
    task = begun(PUSH)
    forces = []
    for _ in range(200):
        forces.append(task.force)
        task.update(robot(yaw=1.0))
    pushed = [step for step, force in enumerate(forces) if force is not None]
    assert pushed == [100, 101, 102, 103, 104]
    total = 0.02 * np.sum([forces[step] for step in pushed], axis=0)
    assert total == pytest.approx((12.0 * math.cos(1.5), 12.0 * math.sin(1.5), 0.0))


def test_a_push_at_the_start_goes_by_the_heading_of_the_start():
    task = begun({"kind": "push", "impulses": [{"at": 0.0, "size": 1.0}], "lasts": 0.02})
    turned = task.goal.yaw
    assert task.force == pytest.approx((50.0 * math.cos(turned), 50.0 * math.sin(turned), 0.0))
    task.update(robot())
    assert task.force is None


def test_pushes_are_drawn_from_the_trials_own_seed():
    drawn = {"kind": "push", "draw": {"size": [10.0, 20.0], "at": [1.0, 2.0], "count": 2}}

    def begins(**which):
        task = begun(drawn, **which)
        found = []
        for step in range(400):
            if (force := task.force) is not None:
                found.append((step, *force.tolist()))
            task.update(robot())
        return found

    assert begins() == begins()
    assert begins() != begins(index=1)
    first, sixth = begins()[0], begins()[5]
    assert 50 <= first[0] <= 100
    assert sixth[0] - first[0] == 200
    for index in range(10):
        sizes = [0.1 * math.hypot(x, y) for _, x, y, _ in begins(index=index)]
        assert min(sizes) >= 10.0 - 1e-9
        assert max(sizes) <= 20.0 + 1e-9


def test_recovery_is_counted_from_the_beginning_of_a_push_to_that_of_steadiness():
    task = begun(PUSH)
    # Too fast for 30 steps; the mean over ten is down to 0.3 m/s six steps later.
    read = lambda step: robot(v=(1.0, 0.0) if 100 <= step < 130 else (0.0, 0.0))  # noqa: E731
    assert run(task, read) == ("completed", "recovered", 500)
    assert task.recovery_times == pytest.approx([0.02 * 36])
    assert task.scores()["recovery_time"] == pytest.approx(0.72)


def test_a_tilted_robot_has_not_recovered():
    task = begun(PUSH)
    assert run(task, lambda step: robot(roll=0.35 if step > 100 else 0.0)) == (
        "timeout",
        "not recovered",
        500,
    )
    assert (task.scores(), task.success) == ({}, 0.0)


def test_every_push_must_be_recovered_from_before_the_next():
    two = {"kind": "push", "impulses": [{"at": at, "size": 5.0} for at in (2.0, 3.0)]}
    read = lambda step: robot(v=(1.0, 0.0) if 100 <= step < 140 else (0.0, 0.0))  # noqa: E731
    assert run(begun(two), read)[1] == "not recovered"
    apart = {"kind": "push", "impulses": [{"at": at, "size": 5.0} for at in (2.0, 4.0)]}
    task = begun(apart)
    assert run(task, read)[1] == "recovered"
    assert task.scores()["recovery_time"] == pytest.approx((0.02 * 46 + 0.0) / 2)


def test_a_push_and_its_recovery_are_events():
    task = begun(PUSH)
    said = [event.text for step in range(300) for event in task.update(robot())]
    assert said == ["push 1 of 1: 12.0 N s, +29 degrees from the heading", "recovered after 0.00 s"]


# Continued, written down, refused.


@pytest.mark.parametrize("settings", [DRAWN, PUSH, {"kind": "stand"}])
@pytest.mark.parametrize("at", [3, 101, 130, 480])
def test_a_task_that_is_restored_continues_as_it_would_have(settings, at):
    def read(step):
        wild = math.sin(0.9 * step)
        return robot(x=0.001 * step, v=(0.4 + 0.3 * wild, 0.1), rate=0.2, yaw=0.002 * step)

    through, stopped, resumed = begun(settings), begun(settings), begun(settings)
    ended = run(through, read)
    for step in range(at):
        stopped.update(read(step))
    resumed.restore(stopped.state())
    assert (resumed.command, resumed.standing) == (stopped.command, stopped.standing)
    assert str(resumed.force) == str(stopped.force) if settings is PUSH else True
    for step in range(at, ended[2]):
        resumed.update(read(step))
    assert (resumed.end(), resumed.end_reason) == ended[:2]
    assert resumed.scores() == through.scores()
    assert resumed.state() == through.state()


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ({"kind": "velocity"}, "Field required"),
        ({"kind": "velocity", "command": {}}, "it is empty; give constant, steps, sweep or draw"),
        (
            {"kind": "velocity", "command": {"constant": {}, "sweep": {"over": 1.0}}},
            "constant and sweep exclude each other",
        ),
        (
            {"kind": "velocity", "command": {"draw": {"vx": [1.0, 0.5]}}},
            "vx 1 to 0.5 is not a range; write the smaller one first",
        ),
        (
            {"kind": "velocity", "command": {"steps": [{"at": 2.0}, {"at": 1.0}]}},
            "steps are not in the order of their times",
        ),
        ({"kind": "velocity", "command": {"constant": {"vx": 50.0}}}, "less than or equal to 5"),
        ({"kind": "push"}, "nothing pushes; give impulses or draw"),
        ({**PUSH, "draw": {"size": [1.0, 2.0]}}, "impulses and draw exclude each other"),
        (
            {"kind": "push", "impulses": [{"at": 2.0, "size": 1.0}, {"at": 2.05, "size": 1.0}]},
            "an impulse begins less than the 0.1 s that each lasts after the one before",
        ),
        ({"kind": "push", "draw": {"size": [0.0, 5.0]}}, "greater than 0"),
        ({"kind": "stand", "drift": -1.0}, "greater than 0"),
        ({"kind": "stand", "command": {"constant": {}}}, "Extra inputs are not permitted"),
    ],
)
def test_settings_that_mean_nothing_are_refused(task, said):
    with pytest.raises(ValidationError) as caught:
        new_suite({**SETTINGS, "task": task})
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("task", "hears", "location", "said"),
    [
        (
            VELOCITY,
            {"way"},
            ("command",),
            "does not observe vx: its card has no term `command`, it ",
        ),
        (
            DRAWN,
            {"way", "speed"},
            ("command",),
            "does not observe vy and yaw: its card has no term",
        ),
        (
            {**PUSH, "command": {"constant": {"vy": 0.1}}},
            {"speed"},
            ("command",),
            "does not observe vy: ",
        ),
        ({"kind": "stand"}, {"way"}, ("kind",), "nothing tells the policy to stand still"),
        (PUSH, {"way"}, ("kind",), "nothing tells the policy to stand still"),
        (
            {"kind": "velocity", "command": {"steps": [{"at": 0.0}, {"at": 10.0, "vx": 0.1}]}},
            {"command"},
            ("command", "steps", 1, "at"),
            "a step at 10 s is not within the trial of 10 s",
        ),
        (
            {"kind": "push", "impulses": [{"at": 9.5, "size": 1.0}]},
            {"command"},
            ("impulses", 0, "at"),
            "the last push may begin at 9.5 s, and recovery from it would end at 10.1 s",
        ),
        (
            {"kind": "push", "draw": {"size": [1.0, 2.0], "count": 3}},
            {"command"},
            ("draw",),
            "the last push may begin at 11 s",
        ),
    ],
)
def test_a_policy_or_a_trial_that_does_not_fit_is_reported_with_its_place(
    task, hears, location, said
):
    fault = fault_of(settings_of(task), hears=frozenset(hears), rules=TaskRules(duration=10.0))
    assert fault is not None
    assert fault.location == location
    assert said in fault.message
    assert fault.fix


@pytest.mark.parametrize(
    ("task", "hears"),
    [
        (DRAWN, {"command"}),
        (DRAWN, {"command", "way"}),
        (VELOCITY, {"speed", "way"}),
        ({"kind": "stand"}, set()),
        ({"kind": "stand"}, {"speed", "way"}),
        (PUSH, set()),
        ({"kind": "course"}, {"way"}),
    ],
)
def test_a_policy_that_can_be_told_what_is_asked_for_is_not_refused(task, hears):
    rules = TaskRules(duration=10.0)
    assert fault_of(settings_of(task), hears=frozenset(hears), rules=rules) is None
