"""What tasks ask for beside a velocity: when, of which joints, and what a policy is shown of it."""

import numpy as np
import pytest
from pydantic import ValidationError

from nw_base.errors import PolicyError
from nw_base.trials import Trial
from nw_eval.suite.model import new_suite
from nw_policies.cards.card import Card
from nw_scenes.robots import get_robot
from nw_sim.catalogue import get_scene
from nw_sim.rollout.asked_for import own_targets
from nw_sim.tasks import TaskRules, fault_of, open_task

GO1 = get_robot("go1")
CARD = {
    "nw-policy": 1,
    "name": "held",
    "robot": "go1",
    "adapter": "zero",
    "control": {
        "action": "joint_position_offset",
        "scale": 0.25,
        "held": {"RR_hip": 0.1, "RL_hip": -0.1},
        "default_pose": {"hip": 0.0, "thigh": 0.9, "calf": -1.8},
    },
    "observations": {
        "body": {
            "sensor": "proprio",
            "terms": [{"term": "target", "of": {"height": 0.3, "RR_hip": 0.1}}, "gravity"],
        }
    },
}
TASK = {
    "kind": "velocity",
    "command": {"constant": {"vx": 0.5}},
    "targets": {"of": {"height": [0.2, 0.3], "*_hip": 0.3}, "every": 2.0, "over": 1.0},
}


def card(**control):
    return Card.model_validate({**CARD, "control": {**CARD["control"], **control}})


def own(**control):
    return own_targets(card(**control), GO1)


def settings_of(task):
    suite = {"nw-eval": 1, "name": "told", "robot": "go1", "policy": "stand", "trials": 1}
    return new_suite({**suite, "seed": 1, "scenes": ["open/field"], "task": task}).task


def begun(task=TASK, *, seed=7, duration=10.0):
    opened = open_task(settings_of(task), TaskRules(duration=duration, own=own()))
    drawn = Trial(
        suite="told",
        suite_digest="0" * 64,
        suite_seed=seed,
        scene="open/field",
        scene_digest="0" * 64,
        task="open",
        index=0,
    )
    opened.reset(drawn, get_scene("open/field"), GO1)
    return opened


def asked(task, step):
    task.step = step
    return dict(task.targets)


def test_a_task_may_ask_for_joints_that_are_held_and_for_what_a_term_reads():
    assert own() == {
        "RR_hip": (0.1, *GO1.joint_ranges[GO1.joints.index("RR_hip_joint")], 6, True),
        "RL_hip": (-0.1, *GO1.joint_ranges[GO1.joints.index("RL_hip_joint")], 9, True),
        "height": (0.3, -np.inf, np.inf, None, False),
    }


def test_joints_that_are_driven_can_be_asked_for_where_the_card_says_so():
    assert set(own(held=None, commanded=["F*_thigh"])) == {
        "FR_thigh",
        "FL_thigh",
        "height",
        "RR_hip",
    }
    assert own(held=None, commanded=["F*_thigh"])["FR_thigh"].value == 0.9


def test_a_joint_that_is_told_no_position_cannot_be_asked_for():
    with pytest.raises(PolicyError, match="FR_calf is told joint_torque, no position"):
        own(action={"*": "joint_position", "FR_calf": "joint_torque"}, commanded=["FR_calf"])


def test_values_begin_at_the_card_s_own_and_change_linearly():
    task = begun()
    assert asked(task, 0) == pytest.approx({"RR_hip": 0.1, "RL_hip": -0.1, "height": 0.3})
    assert asked(task, 25)["RL_hip"] == pytest.approx(0.1)  # Half way from -0.1 to 0.3.
    assert asked(task, 50)["RL_hip"] == asked(task, 99)["RL_hip"] == 0.3
    first, second = asked(task, 75)["height"], asked(task, 175)["height"]
    assert 0.2 <= first <= 0.3
    assert 0.2 <= second <= 0.3
    assert first != second
    assert asked(task, 125)["height"] == pytest.approx((first + second) / 2)


def test_values_are_those_of_the_trial_s_own_seed_whatever_its_length():
    long, short, other = begun(duration=20.0), begun(duration=3.0), begun(seed=8)
    assert asked(long, 140) == asked(short, 140) != asked(other, 140)


def test_an_angle_that_a_policy_reads_and_follows_is_measured_and_moves_nothing():
    reads = own(held=None)
    assert (reads["RR_hip"].joint, reads["RR_hip"].is_moved) == (6, False)
    suite = settings_of({**TASK, "targets": {"of": {"RR_hip": 1.5}}})
    fault = fault_of(suite, hears=frozenset({"command"}), rules=TaskRules(own=reads))
    assert fault is not None
    assert "RR_hip turns from" in fault.message


def test_the_most_exact_key_counts_and_patterns_mean_joints_alone():
    of = {"RR_hip": 0.3, "R*": 0.2, "hip": 0.1, "height": 0.25, "*": 0.0}
    task = begun({**TASK, "targets": {"of": of}})
    assert asked(task, 60) == pytest.approx({"RR_hip": 0.3, "RL_hip": 0.0, "height": 0.25})
    held = {name: one for name, one in own().items() if name != "height"}
    named = {**held, "trunk_height": own()["height"]}
    suite = settings_of({**TASK, "targets": {"of": {"height": 0.25}}})
    fault = fault_of(suite, hears=frozenset({"command"}), rules=TaskRules(own=named))
    assert fault is not None
    assert fault.location == ("targets", "of", "height")


def test_angles_are_not_compared_where_no_target_is_a_joint():
    numbers = {"FR_calf_load": own()["height"]}
    suite = settings_of(
        {**TASK, "targets": {"of": {"FR_calf_load": 1.0}}, "within": {"joints": 0.1}}
    )
    fault = fault_of(suite, hears=frozenset({"command"}), rules=TaskRules(own=numbers))
    assert fault is not None
    assert fault.location == ("within", "joints")


def test_what_else_a_policy_can_be_asked_for_changes_no_value():
    task, fewer = begun(), begun({**TASK, "targets": {**TASK["targets"], "of": {"*_hip": 0.3}}})
    assert "height" not in asked(fewer, 75)
    alone = begun({**TASK, "targets": {**TASK["targets"], "of": {"height": [0.2, 0.3]}}})
    assert asked(alone, 75)["height"] == asked(task, 75)["height"]


def test_joints_move_by_the_difference_from_the_card_s_own_angle():
    task = begun()
    task.step = 60
    offsets = task.joint_offsets
    assert offsets[[6, 9]] == pytest.approx([0.2, 0.4])
    assert np.count_nonzero(offsets) == 2


@pytest.mark.parametrize(
    ("targets", "said"),
    [
        ({"of": {"height": [0.3, 0.2]}}, "write the smaller one first"),
        ({"of": {"height": 0.3}, "every": 1.0, "over": 2.0}, "over, 2 s, is more than every, 1 s"),
        ({"of": {}}, "at least 1 item"),
    ],
)
def test_targets_that_mean_nothing_are_refused(targets, said):
    with pytest.raises(ValidationError, match=said):
        settings_of({**TASK, "targets": targets})


@pytest.mark.parametrize(
    ("within", "said"),
    [
        ({"height": 0.05}, "within.height: the targets ask for no `height`"),
        ({"joints": 0.1}, "within.joints: the targets ask for no joint"),
    ],
)
def test_a_tolerance_of_what_is_not_asked_for_is_refused(within, said):
    of = {"hip": 0.1} if "height" in within else {"height": 0.3}
    with pytest.raises(ValidationError, match=said):
        settings_of({**TASK, "targets": {"of": of}, "within": within})


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("FR_calf", -1.5, "the policy holds no joint 'FR_calf'"),
        ("speed", 1.0, "no term `target` of its card reads it"),
        ("RR_hip", [0.0, 1.5], "RR_hip turns from -0.803 to 0.803 rad"),
    ],
)
def test_what_a_policy_cannot_be_asked_for_is_a_fault_of_its_key(name, value, said):
    settings = settings_of({**TASK, "targets": {"of": {name: value}}})
    fault = fault_of(settings, hears=frozenset({"command"}), rules=TaskRules(own=own()))
    assert fault is not None
    assert fault.location == ("targets", "of", name)
    assert said in fault.message


def test_height_and_joints_count_where_the_suite_says_so():
    from types import SimpleNamespace

    def tracked(over, off):
        within = {"height": 0.05, "joints": 0.1}
        task = begun({**TASK, "within": within}, duration=4.0)
        for step in range(task.steps):
            values = asked(task, step)
            positions = np.zeros(12)
            positions[[6, 9]] = values["RR_hip"] + off, values["RL_hip"] - off
            task.update(
                SimpleNamespace(
                    trunk_position=np.array((0.0, 0.0, 0.3)),
                    trunk_linear_velocity=np.array((0.5, 0.0, 0.0)),
                    trunk_angular_velocity=np.zeros(3),
                    roll_pitch_yaw=np.zeros(3),
                    uprightness=1.0,
                    joint_positions=positions,
                    monitored_force=lambda: 0.0,
                    monitored_forces=dict,
                    height_over_ground=lambda h=values["height"]: h + over,
                    scene=SimpleNamespace(ground=SimpleNamespace(z=0.0)),
                )
            )
        return task.tracked

    assert tracked(0.04, 0.09) == 1.0
    assert tracked(0.06, 0.0) == 0.0
    assert tracked(0.0, 0.11) == 0.0


def test_a_suite_without_targets_has_the_fields_that_it_had():
    dumped = settings_of({"kind": "velocity", "command": {"constant": {"vx": 0.5}}}).model_dump()
    assert "targets" not in dumped
    assert dumped["within"] == {"linear": 0.2, "angular": 0.3}
