import numpy as np
import pytest

from nw_base.errors import PolicyError
from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_policies import ActionDelay
from nw_policies.cards import Card, JointControl, actuator_values, physics_steps
from nw_policies.cards.joints import joint_values
from nw_scenes.robots import get_robot

GO1 = get_robot("go1")
# Isaac Gym's order; the permutation to the robot's order is its own inverse (reference:
# neverwhere, section 3.2).
ISAAC = [f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")]
ISAAC_TO_ROBOT = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]


def card(**control):
    fields = {"action": "joint_position_offset", "scale": 0.25} | control
    return Card.model_validate(
        {"nw-policy": 1, "name": "c", "robot": "go1", "adapter": "zero", "control": fields}
    )


def test_action_zero_is_the_default_pose():
    targets = JointControl.from_card(card(), GO1).targets(np.zeros(12))
    assert targets.tolist() == list(GO1.default_pose)


def test_actions_are_clipped_before_they_are_scaled():
    targets = JointControl.from_card(card(clip=4.8), GO1).targets(np.full(12, 100.0))
    np.testing.assert_allclose(targets - GO1.default_pose, 1.2)


def test_absolute_actions_forget_the_default_pose():
    control = JointControl.from_card(card(action="joint_position", scale=1.0), GO1)
    np.testing.assert_array_equal(control.targets(np.arange(12.0)), np.arange(12.0))


def test_another_joint_order_ends_in_the_robots_order():
    control = JointControl.from_card(card(joints=ISAAC, scale=1.0, default_pose=0.0), GO1)
    np.testing.assert_array_equal(control.targets(np.arange(12.0)), ISAAC_TO_ROBOT)


def test_scales_by_joint_type_follow_the_policys_order():
    scale = {"hip": 0.125, "thigh": 0.25, "calf": 0.5}
    control = JointControl.from_card(card(joints=ISAAC, scale=scale, default_pose=0.0), GO1)
    np.testing.assert_allclose(control.targets(np.ones(12)), [0.125, 0.25, 0.5] * 4)


def test_patterns_name_groups_of_joints_and_the_last_one_counts():
    values = joint_values({"thigh": 0.8, "R?_thigh": 1.0, "hip": 0, "calf": -1.5}, GO1.joints)
    np.testing.assert_allclose(values[1::3], [0.8, 0.8, 1.0, 1.0])


def test_motors_keep_the_robots_figures_where_the_card_says_nothing():
    values = actuator_values(card(kp=35, torque_limits={"calf": 35.55}), GO1)
    assert values is not None
    np.testing.assert_allclose(values["kp"], 35.0)
    np.testing.assert_allclose(values["torque_limits"], [23.7, 23.7, 35.55] * 4)
    np.testing.assert_allclose(values["kd"], GO1.joint_damping)


def test_motors_of_a_card_without_overrides_are_the_robots():
    assert actuator_values(card(), GO1) is None


@pytest.mark.parametrize(
    ("control", "said"),
    [
        ({"joints": ["FR_hip"]}, "control.joints: 1 joints are named"),
        ({"joints": [*ISAAC[:-1], "RR_cafl"]}, "did you mean 'RR_calf'"),
        ({"joints": [*ISAAC[:-1], "FL_hip"]}, "named twice"),
        ({"scale": [0.25, 0.25]}, "control.scale: 2 values for 12 joints"),
        ({"scale": {"hip": 0.25}}, "no value for"),
        ({"scale": {"hp": 0.25}}, "did you mean 'hip'"),
    ],
)
def test_joints_that_do_not_fit_the_robot_are_said_in_the_cards_terms(control, said):
    with pytest.raises(PolicyError) as caught:
        JointControl.from_card(card(**control), GO1)
    assert said in str(caught.value)


def test_a_negative_gain_is_refused():
    with pytest.raises(PolicyError, match="negative"):
        actuator_values(card(kp=-1), GO1)


def test_a_delayed_action_is_applied_that_many_steps_later():
    delay = ActionDelay(2)
    applied = [delay.push(np.full(12, float(k)))[0] for k in range(1, 6)]
    assert applied == [0.0, 0.0, 1.0, 2.0, 3.0]


def test_a_delay_queue_goes_back_to_its_state():
    delay = ActionDelay(1)
    delay.push(np.full(12, 7.0))
    state = delay.state()
    delay.push(np.full(12, 8.0))
    delay.restore(state)
    assert delay.push(np.zeros(12))[0] == 7.0


def test_a_queued_action_does_not_change_with_the_callers_array():
    delay = ActionDelay(1)
    action = np.ones(12)
    delay.push(action)
    action[:] = 5.0
    assert delay.push(action)[0] == 1.0


def test_torques_need_no_gain_and_bring_no_damping():
    torque = card(action="joint_torque", scale=20.0, torque_limits=15.0)
    np.testing.assert_array_equal(
        JointControl.from_card(torque, GO1).targets(np.ones(12)), np.full(12, 20.0)
    )
    motors = actuator_values(torque, GO1)
    assert motors["kd"].tolist() == [0.0] * 12
    assert motors["torque_limits"].tolist() == [15.0] * 12


def test_a_physics_rate_is_steps_of_a_control_step():
    assert physics_steps(card(physics_rate=250), STRICT) == (0.004, 5)
    assert physics_steps(card(), NEVERWHERE_2026) == (0.005, 4)
    with pytest.raises(PolicyError, match=r"physics_rate is 250, the protocol 'neverwhere-2026'"):
        physics_steps(card(physics_rate=250), NEVERWHERE_2026)


def test_targets_of_another_order_with_limits_are_those_of_numpy():
    control = JointControl.from_card(card(joints=ISAAC, clip=0.5), GO1)
    action = np.random.default_rng(0).normal(size=12)
    expected = np.empty(12)
    expected[ISAAC_TO_ROBOT] = action.clip(-0.5, 0.5)
    expected = np.array(GO1.default_pose) + 0.25 * expected
    np.testing.assert_array_equal(control.targets(action), expected)
