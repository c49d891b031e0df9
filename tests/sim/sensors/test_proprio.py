from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from nw_base.errors import PolicyError
from nw_sim.sensors import build_sensors

NOW = {"sensor": "proprio", "layout": "parkour53"}


@pytest.fixture
def read(card_of, moment_of):
    """A function: what one observation of a card reads in a world."""

    def read(world, observation, *, moment=None, **fields):
        sensor = build_sensors(card_of({"obs": observation}, **fields), world)["obs"]
        sensor.reset(0)
        return sensor.read(moment or moment_of(world))

    return read


def terms(*names, **options):
    return {"sensor": "proprio", "terms": list(names)} | options


def quaternion_angles(world):
    """Roll, pitch, yaw by the formulas of the published evaluation."""
    w, x, y, z = world._data.qpos[3:7]
    return (
        np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        np.arcsin(2 * (w * y - z * x)),
        np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def test_parkour53_is_laid_out_as_published(world, read, moment_of):
    # Indices, order and scales: Neverwhere's published evaluation, section 4.1 of its description.
    frame = read(world, NOW, moment=moment_of(world, applied=0.7))
    roll, pitch, yaw = quaternion_angles(world)
    goal = world.scene.trail[0, :2] - world._data.qpos[:2]
    delta = np.arctan2(goal[1], goal[0]) - yaw
    default = [-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5]
    contact = world.foot_contacts | world.previous_foot_contacts
    expected = np.concatenate(
        [
            world._data.qvel[3:6] * 0.25,
            [roll, pitch, 0.0],
            [delta, delta],
            [0.0, 0.0, 0.8],
            [1.0, 0.0],
            world._data.qpos[7:] - default,
            world._data.qvel[6:] * 0.05,
            np.full(12, 0.7),
            contact - 0.5,
        ]
    )
    assert frame.dtype == np.float32
    np.testing.assert_allclose(frame, expected, atol=1e-6)
    assert abs(roll) + abs(pitch) > 1e-3
    assert contact.any()


def test_delta_yaw_stays_within_half_a_turn(world, read):
    world.reset(position=(3.0, 0.0, 0.3), yaw=3.0)
    # The waypoint is behind at bearing pi: 0.14 rad to the left, not nearly a full turn to it.
    assert read(world, terms("delta_yaw")) == pytest.approx([np.pi - 3.0], abs=1e-6)


def test_gravity_points_down_the_trunk_when_level(world, read):
    world.reset(position=(0.0, 0.0, 0.4), yaw=1.0)
    assert read(world, terms("gravity")) == pytest.approx([0.0, 0.0, -1.0], abs=1e-7)


def test_gravity_is_a_unit_vector_turned_with_the_trunk(world, read):
    roll, pitch, _ = quaternion_angles(world)
    expected = [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)]
    assert read(world, terms("gravity")) == pytest.approx(expected, abs=1e-6)


def test_linear_velocity_at_a_point_is_what_that_point_does(world, read):
    point = [0.2, -0.1, 0.05]
    velocity = read(world, terms({"term": "lin_vel", "frame": "world", "at": point}))
    before = world.trunk_position + world.trunk_rotation @ point
    small = 1e-6
    turn = world.trunk_rotation @ world.trunk_angular_velocity * small
    turned = world.trunk_rotation @ point + np.cross(turn, world.trunk_rotation @ point)
    after = world.trunk_position + world.trunk_linear_velocity * small + turned
    assert velocity == pytest.approx((after - before) / small, abs=1e-4)


def test_the_yaw_frame_turns_with_the_heading_only(world, read):
    in_world = read(world, terms({"term": "lin_vel", "frame": "world"}))
    in_yaw = read(world, terms({"term": "lin_vel", "frame": "yaw"}))
    yaw = quaternion_angles(world)[2]
    forward = np.cos(yaw) * in_world[0] + np.sin(yaw) * in_world[1]
    assert in_yaw[0] == pytest.approx(forward, abs=1e-6)
    assert in_yaw[2] == pytest.approx(in_world[2])


def test_joints_come_in_the_order_and_around_the_pose_of_the_card(world, read):
    order = ["FL", "FR", "RL", "RR"]
    joints = [f"{leg}_{part}" for leg in order for part in ("hip", "thigh", "calf")]
    control = {"joints": joints, "default_pose": {"hip": 0.0, "thigh": 0.9, "calf": -1.8}}
    position = read(world, terms("joint_pos"), control=control)
    robots = world.joint_positions.reshape(4, 3)[[1, 0, 3, 2]]
    np.testing.assert_allclose(position.reshape(4, 3), robots - [0.0, 0.9, -1.8], atol=1e-6)


def test_feet_come_in_the_order_of_the_card(world, read):
    world.reset(position=(0.0, 0.0, 0.26), yaw=0.0)
    for _ in range(3):
        world.step(world.robot.default_pose)
    world._forces.contacts[:] = [True, False, False, True]
    world._forces.previous_contacts[:] = [False, False, True, False]
    now = {"term": "foot_contacts", "filter": "none", "feet": ["FL", "FR", "RL", "RR"]}
    assert read(world, terms(now)).tolist() == [0.0, 1.0, 1.0, 0.0]
    assert read(world, terms("foot_contacts")).tolist() == [1.0, 0.0, 1.0, 1.0]


def test_a_term_is_clipped_then_scaled_then_shifted(world, read):
    world._data.qvel[3:6] = [10.0, -10.0, 0.5]
    term = {"term": "ang_vel", "clip": 2, "scale": [1.0, 10.0, 1.0], "offset": 0.5}
    assert read(world, terms(term)).tolist() == [2.5, -19.5, 1.0]


@pytest.mark.parametrize("word", ["last_output", "applied_action"])
def test_an_action_is_fed_back_as_it_was_said_or_within_the_limits_of_actions(
    word, world, read, moment_of
):
    moment, control = moment_of(world, applied=130.0, output=-130.0), {"clip": [-3, 100]}
    said, kept = {"last_output": (-130.0, -3.0), "applied_action": (130.0, 100.0)}[word]
    raw = read(world, terms(word), moment=moment, control=control)
    clipped = read(world, terms({"term": word, "clipped": True}), moment=moment, control=control)
    assert set(raw) == {said}
    assert set(clipped) == {kept}


def test_an_observation_is_clipped_after_scaling(world, read):
    world._data.qvel[3:6] = [10.0, -10.0, 0.5]
    term = {"term": "ang_vel", "scale": 20.0}
    assert read(world, terms(term, clip=100)).tolist() == [100.0, -100.0, 10.0]


def test_select_keeps_the_numbers_it_names(world, read):
    whole = read(world, NOW)
    part = read(world, NOW | {"select": ["0:5", "13:53"]})
    np.testing.assert_array_equal(part, np.r_[whole[:5], whole[13:]])


def test_select_outside_the_frame_is_an_error(world, read):
    with pytest.raises(PolicyError, match="'50:60' is outside the 53 numbers"):
        read(world, NOW | {"select": ["50:60"]})


def test_a_list_of_scales_must_fit_its_term(world, read):
    with pytest.raises(PolicyError, match="term ang_vel has 3 numbers but 2 scales"):
        read(world, terms({"term": "ang_vel", "scale": [1.0, 2.0]}))


@pytest.fixture
def stacks(world, card_of, moment_of):
    """A function: four readings of two terms that are 1, 2, 3, 4 and ten times that."""

    def stacks(history):
        twice = terms("ang_vel", {"term": "ang_vel", "scale": 10.0}, history=history)
        sensor = build_sensors(card_of({"obs": twice}), world)["obs"]
        sensor.reset(0)
        found = []
        for step in range(4):
            world._data.qvel[3:6] = [step + 1.0, 0.0, 0.0]
            found.append(sensor.read(moment_of(world, step=step))[::3].tolist())
        return found

    return stacks


def test_history_is_oldest_first_and_repeats_the_first_frame(stacks):
    assert stacks(3) == [
        [1, 10, 1, 10, 1, 10],
        [1, 10, 1, 10, 2, 20],
        [1, 10, 2, 20, 3, 30],
        [2, 20, 3, 30, 4, 40],
    ]


def test_history_can_be_newest_first(stacks):
    newest = stacks({"steps": 3, "order": "newest_first"})
    assert newest[3] == [4, 40, 3, 30, 2, 20]


def test_history_can_be_grouped_by_term(stacks):
    assert stacks({"steps": 3, "by": "term"})[3] == [2, 3, 4, 20, 30, 40]


def test_history_can_leave_out_the_present_frame(stacks):
    earlier = stacks({"steps": 2, "current": False, "order": "newest_first"})
    assert earlier == [[1, 10, 1, 10], [1, 10, 1, 10], [2, 20, 1, 10], [3, 30, 2, 20]]


def test_history_can_start_from_zeros(stacks):
    assert stacks({"steps": 3, "start": "zeros"})[0] == [0, 0, 0, 0, 1, 10]


def test_a_reset_forgets_the_history(world, card_of, moment_of):
    sensor = build_sensors(card_of({"obs": terms("ang_vel", history=2)}), world)["obs"]
    sensor.reset(0)
    sensor.read(moment_of(world))
    world._data.qvel[3:6] = 9.0
    sensor.reset(0)
    assert sensor.read(moment_of(world)).tolist() == [9.0] * 6


@pytest.mark.parametrize(
    ("yaw", "expected"),
    [
        # vx = 0.8 cos, yaw rate = clip(1.5 angle, +-1), by hand.
        (0.0, [0.8, 0.0, 0.0]),
        (-0.5, [0.8 * np.cos(0.5), 0.0, 0.75]),
        (1.2, [0.8 * np.cos(1.2), 0.0, -1.0]),
        (np.pi * 0.9, [0.0, 0.0, -1.0]),
    ],
)
def test_the_trail_follower_steers_to_the_next_waypoint(world, yaw, expected, read):
    world.reset(position=(0.0, 0.0, 0.4), yaw=yaw)
    command = {"source": "trail_follower", "speed": 0.8, "yaw_gain": 1.5, "yaw_limit": 1.0}
    assert read(world, terms("command"), command=command) == pytest.approx(expected, abs=1e-6)


def test_the_trail_follower_keeps_a_least_speed_in_turns(world, read):
    command = {"source": "trail_follower", "speed": 0.8, "least_speed": 0.3}
    world.reset(position=(0.0, 0.0, 0.4), yaw=np.pi / 2)  # The waypoint is to the right.
    assert read(world, terms("command"), command=command)[0] == pytest.approx(0.3)
    world.reset(position=(0.0, 0.0, 0.4), yaw=0.0)
    assert read(world, terms("command"), command=command)[0] == pytest.approx(0.8)


def test_a_constant_command_is_constant(world, read):
    command = {"source": "constant", "velocity": [0.5, -0.1, 0.2]}
    assert read(world, terms("command"), command=command) == pytest.approx([0.5, -0.1, 0.2])


def test_parts_of_a_command_stand_in_the_order_of_the_card(world, read):
    command = {"source": "constant", "velocity": [0.5, -0.1, 0.2]}
    yaw = {"term": "command", "parts": ["yaw"], "scale": 2.0}
    rest = {"term": "command", "parts": ["vy", "vx"]}
    assert read(world, terms(yaw, rest), command=command) == pytest.approx([0.4, -0.1, 0.5])


@pytest.mark.parametrize(
    ("velocity", "expected"), [([0.0, 0.0, 0.05], 0.0), ([0.1, 0.0, 0.05], 1.0)]
)
def test_a_command_to_stand_is_one_below_a_norm(world, read, velocity, expected):
    command = {"source": "constant", "velocity": velocity}
    assert read(world, terms("moving"), command=command) == expected


def test_targets_are_the_task_s_and_else_the_card_s(world, read, moment_of):
    seen = terms({"term": "target", "of": {"height": 0.3, "FR_hip_joint": 0.1}, "scale": 2.0})
    assert read(world, seen) == pytest.approx([0.6, 0.2])
    moment = moment_of(world)
    asking = SimpleNamespace(targets={"FR_hip": 0.4})
    assert read(world, seen, moment=replace(moment, task=asking)) == pytest.approx([0.6, 0.8])


@pytest.mark.parametrize("steps", [2, 5])
def test_a_history_does_not_take_the_frames_of_another_one(world, card_of, moment_of, steps):
    sensors = [
        build_sensors(card_of({"o": terms("joint_pos", history={"steps": n})}), world)["o"]
        for n in (3, steps)
    ]
    for sensor in sensors:
        sensor.reset(0)
    sensors[0].read(moment_of(world))
    with pytest.raises(ValueError, match=r"a history of \(3, 12\) float32"):
        sensors[1].restore(sensors[0].state())
