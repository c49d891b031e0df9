"""Heading, accelerometer and earlier outputs: what they read, and that a restore keeps it."""

import mujoco
import numpy as np
import pytest

from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_policies.cards.terms import EARLIER_OUTPUTS
from nw_scenes.robots import get_robot
from nw_sim.physics import World
from nw_sim.physics import model as sim_model
from nw_sim.sensors import StepContext, build_sensors
from nw_sim.tasks import Course

AT = (-0.01592, -0.06659, 0.17)


@pytest.fixture
def read(card_of, moment_of):
    """A function: what a term reads in a world."""

    def read(world, term, moment=None):
        observation = {"sensor": "proprio", "terms": [term]}
        sensor = build_sensors(card_of({"o": observation}), world)["o"]
        sensor.reset(0)
        return sensor.read(moment or moment_of(world))

    return read


def test_yaw_is_the_angle_of_the_nose_on_the_ground(world, read):
    # Walk-these-ways: atan2 of the forward axis, whatever roll and pitch are.
    world._data.qpos[3:7] = np.array([0.6, 0.3, -0.2, 0.7]) / np.linalg.norm([0.6, 0.3, -0.2, 0.7])
    mujoco.mj_forward(world._model, world._data)
    forward = world.trunk_rotation[:, 0]
    yaw = np.arctan2(forward[1], forward[0])
    assert yaw == pytest.approx(1.5, abs=0.2)
    assert read(world, "yaw") == pytest.approx([yaw], abs=1e-6)
    both = read(world, {"term": "yaw", "values": "sine_cosine"})
    assert both == pytest.approx([np.sin(yaw), np.cos(yaw)], abs=1e-6)


def test_the_orientation_turns_the_trunks_axes_into_the_worlds(world, read):
    # Isaac Lab's projected gravity from x, y, z, w (its export_annotator.py).
    x, y, z, w = read(world, {"term": "orientation", "order": "xyzw"})
    assert read(world, "orientation") == pytest.approx([w, x, y, z], abs=0)
    down, axis = np.array([0.0, 0.0, -1.0]), np.array([x, y, z])
    twice = 2.0 * np.cross(axis, down)
    projected = down - w * twice + np.cross(axis, twice)
    assert projected == pytest.approx(read(world, "gravity"), abs=1e-6)
    assert abs(x) + abs(y) > 0.01, "it leans"


@pytest.mark.parametrize(("start", "now", "expected"), [(0.4, 0.1, -0.3), (3.0, -3.0, 0.2831853)])
def test_yaw_can_count_from_the_start_and_stays_within_half_a_turn(
    world, read, start, now, expected
):
    world.reset(position=(0.0, 0.0, 0.4), yaw=start)
    relative = {"term": "yaw", "relative_to": "start"}
    assert read(world, relative) == pytest.approx([0.0], abs=1e-6)
    world._data.qpos[3:7] = [np.cos(now / 2), 0.0, 0.0, np.sin(now / 2)]
    mujoco.mj_forward(world._model, world._data)
    assert read(world, relative) == pytest.approx([expected], abs=1e-6)


@pytest.fixture
def instrumented(place, monkeypatch):
    """A Go1 on a plane with MuJoCo's own accelerometer at a point of its trunk."""
    plain = sim_model.add_geometry

    def with_sensor(spec, scene, *, friction):
        spec.body("trunk").add_site(name="imu", pos=list(AT))
        spec.add_sensor(
            name="accelerometer",
            type=mujoco.mjtSensor.mjSENS_ACCELEROMETER,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="imu",
        )
        plain(spec, scene, friction=friction)

    monkeypatch.setattr(sim_model, "add_geometry", with_sensor)
    with World(get_robot("go1"), place()) as world:
        yield world


def test_acceleration_is_what_mujocos_accelerometer_reads_on_a_moving_trunk(instrumented, read):
    world = instrumented
    world.reset(position=(0.3, -0.2, 0.33), yaw=0.4)
    pose, largest = np.array(world.robot.default_pose), 0.0
    for step in range(60):
        world.step(pose + 0.3 * np.sin(0.5 * step + np.arange(12)))
        found = read(world, {"term": "acceleration", "at": AT})
        expected = world._data.sensor("accelerometer").data
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-5)
        largest = max(largest, np.abs(expected - read(world, "acceleration")).max())
    assert largest > 1.0  # The place on the trunk counts.


def test_acceleration_is_nothing_in_free_fall(world, read):
    world.reset(position=(0.0, 0.0, 3.0), yaw=0.0)
    for _ in range(5):
        world.step(world.robot.default_pose)
    assert world.trunk_linear_velocity[2] < -0.5
    # What is left is what the legs do as they go on holding their pose.
    assert read(world, "acceleration") == pytest.approx([0.0, 0.0, 0.0], abs=0.05)


def test_acceleration_is_gravity_at_rest_along_the_trunks_axes(world, read):
    world.reset(position=(0.0, 0.0, world.robot.spawn_height), yaw=1.0)
    for _ in range(150):
        world.step(world.robot.default_pose)
    up = world.trunk_rotation.T @ [0.0, 0.0, 9.806]
    assert read(world, "acceleration") == pytest.approx(up, abs=0.02)


@pytest.mark.parametrize("protocol", [STRICT, NEVERWHERE_2026])
def test_a_restored_world_reads_the_same_to_the_last_bit(place, read, protocol):
    with World(get_robot("go1"), place(), protocol=protocol) as world:
        world.reset(position=(0.3, -0.2, 0.33), yaw=0.4)
        for step in range(15):
            world.step(np.array(world.robot.default_pose) + 0.2 * np.sin(step))
        terms = [{"term": "acceleration", "at": AT}, {"term": "yaw", "relative_to": "start"}]
        before = [read(world, term) for term in terms]
        state = world.state()
        world.reset(position=(0.0, 0.0, 1.0), yaw=-2.0)
        assert not any(
            np.array_equal(read(world, t), b) for t, b in zip(terms, before, strict=True)
        )
        world.restore(state)
        for term, expected in zip(terms, before, strict=True):
            np.testing.assert_array_equal(read(world, term), expected)
        if protocol is STRICT:
            assert np.abs(before[0]).max() > 5.0


def test_outputs_before_the_last_one_can_be_read(world, read):
    moment = StepContext(
        world=world,
        task=Course.along(world.scene.trail),
        step=3,
        applied_action=np.zeros(12),
        last_output=np.full(12, 3.0),
        earlier_outputs=(np.full(12, 2.0), np.full(12, 1.0)),
    )
    found = [read(world, {"term": "last_output", "ago": n}, moment)[0] for n in range(4)]
    assert found == [3.0, 2.0, 1.0, 0.0]
    assert EARLIER_OUTPUTS >= 2
