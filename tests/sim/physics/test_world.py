"""Stepping, frames, forces and perturbations of the world."""

import dataclasses
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from nw_base.errors import TrialError, UsageError
from nw_base.protocol import NEVERWHERE_2026, STRICT
from nw_scenes.robots.spec import VISUAL_GROUP
from nw_sim.physics import Actuators, World
from nw_sim.physics.forces import ContactForces

WEIGHT = 12.985904 * 9.806


def test_solver_options_are_the_published_ones(go1, flat):
    with World(go1, flat) as world:
        option = world._model.opt
        assert option.timestep == 0.005
        np.testing.assert_array_equal(option.gravity, (0, 0, -9.806))
        assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
        assert option.integrator == mujoco.mjtIntegrator.mjINT_EULER
        assert option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
        assert (option.iterations, option.tolerance, option.impratio) == (50, 1e-8, 1.0)
        assert world.control_period == pytest.approx(0.02)


@pytest.mark.parametrize("protocol", [STRICT, NEVERWHERE_2026])
def test_a_control_step_is_four_plain_physics_steps_bit_for_bit(go1, flat, swing, protocol):
    with World(go1, flat, protocol=protocol) as world:
        data = mujoco.MjData(world._model)
        data.qpos[:] = world._data.qpos
        for step in range(60):
            world.step(swing(step))
            data.ctrl[:] = swing(step)
            for _ in range(4):
                mujoco.mj_step(world._model, data)
            assert data.qpos.tobytes() == world._data.qpos.tobytes()
            assert data.qvel.tobytes() == world._data.qvel.tobytes()
        assert world.time == pytest.approx(1.2)


def test_two_worlds_agree_bit_for_bit(go1, place, swing):
    scene = place(((0.6, 0.0, 0.05), (0.1, 0.5, 0.05)))
    with World(go1, scene) as one, World(go1, scene) as two:
        for step in range(100):
            one.step(swing(step))
            two.step(swing(step))
        assert one.state() == two.state()


def test_a_reset_leaves_nothing_of_the_past(go1, flat, swing):
    with World(go1, flat) as used, World(go1, flat) as fresh:
        for step in range(80):
            used.step(swing(step))
        for world in (used, fresh):
            world.reset(position=(0.5, -0.2, 0.4), yaw=0.3)
        assert used.state() == fresh.state()
        used.step(swing(0))
        fresh.step(swing(0))
        assert used.state() == fresh.state()


def undressed(mjcf):
    """Return a robot without what is only seen of it."""
    root = ET.fromstring(mjcf)
    for body in root.iter("body"):
        for geom in body.findall(f"geom[@group='{VISUAL_GROUP}']"):
            body.remove(geom)
    bare = ET.tostring(root, encoding="unicode")
    assert len(bare) < 0.7 * len(mjcf)
    return bare


def test_looks_do_not_change_the_physics(go1, place, swing):
    scene = place(((0.5, 0.0, 0.05), (0.1, 0.5, 0.05)))
    bare = dataclasses.replace(go1, mjcf=undressed(go1.mjcf))
    with World(go1, scene) as dressed, World(bare, scene) as naked:
        for step in range(150):
            dressed.step(swing(step))
            naked.step(swing(step))
        assert dressed._data.qpos.tobytes() == naked._data.qpos.tobytes()


def test_frames_are_what_they_say(go1, flat, swing):
    with World(go1, flat) as world:
        world.reset(position=(1.0, 2.0, 0.4), yaw=0.5)
        np.testing.assert_allclose(world.roll_pitch_yaw, (0, 0, 0.5), atol=1e-12)
        np.testing.assert_allclose(world.trunk_rotation[:, 0], (np.cos(0.5), np.sin(0.5), 0))
        for step in range(40):
            world.step(swing(step))
        # MuJoCo's own answer for the body's velocity, in the world and in the trunk frame.
        velocity, trunk = np.zeros(6), world._model.body("trunk").id
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(world._model, world._data, kind, trunk, velocity, 1)
        np.testing.assert_allclose(world.trunk_angular_velocity, velocity[:3], atol=1e-12)
        mujoco.mj_objectVelocity(world._model, world._data, kind, trunk, velocity, 0)
        np.testing.assert_allclose(world.trunk_linear_velocity, velocity[3:], atol=1e-12)
        # Poses belong to the newest instant, not to the one before the last physics step.
        np.testing.assert_allclose(world.trunk_position, world._data.qpos[:3], atol=0)
        positions, quats, *_ = world.moving()
        trunk, *_ = world.bodies
        np.testing.assert_array_equal(positions[trunk], world.trunk_position)
        np.testing.assert_array_equal(quats[trunk], world.trunk_quat)


def test_roll_and_pitch_have_the_published_signs(go1, flat):
    with World(go1, flat) as world:
        for axis, index in (((1, 0, 0), 0), ((0, 1, 0), 1), ((0, 0, 1), 2)):
            mujoco.mju_axisAngle2Quat(world._data.qpos[3:7], np.array(axis, dtype=float), 0.3)
            mujoco.mj_forward(world._model, world._data)
            expected = np.zeros(3)
            expected[index] = 0.3
            np.testing.assert_allclose(world.roll_pitch_yaw, expected, atol=1e-12)


def test_the_ego_camera_goes_along_with_the_trunk(go1, flat):
    with World(go1, flat) as world:
        world.reset(position=(1.0, 2.0, 0.4), yaw=np.pi / 2)
        pose = world.camera_pose("ego")
        # A quarter turn to the left: 0.27 m ahead is now along y, and so is the view.
        np.testing.assert_allclose(pose[:3, 3], (1.0, 2.27, 0.415), atol=1e-12)
        np.testing.assert_allclose(pose[:3, 2], (0, 1, 0), atol=1e-12)
        np.testing.assert_allclose(pose[:3, 1], (0, 0, -1), atol=1e-12)
        with pytest.raises(UsageError, match=r"go1 has no camera 'egoo'; did you mean 'ego'\?"):
            world.camera_pose("egoo")


def fresh_forces(world):
    """Solve the present state again, apart from the world, and read all forces."""
    other = mujoco.MjData(world._model)
    size = mujoco.mj_stateSize(world._model, mujoco.mjtState.mjSTATE_INTEGRATION)
    state = np.zeros(size)
    mujoco.mj_getState(world._model, world._data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_setState(world._model, other, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_forward(world._model, other)
    reader = ContactForces(
        world._model,
        world.robot,
        world.robot.feet,
        in_contact_frames=world.protocol is NEVERWHERE_2026,
    )
    return reader.read(other)


def test_strict_forces_are_those_of_the_present_state(go1, flat, swing):
    with World(go1, flat) as world:
        for step in range(40):
            world.step(swing(step))
            np.testing.assert_array_equal(world.foot_forces(), fresh_forces(world))


def test_published_forces_are_stale_while_things_move(go1, flat, swing):
    with World(go1, flat, protocol=NEVERWHERE_2026) as world:
        differences = []
        for step in range(40):
            world.step(swing(step))
            differences.append(np.abs(world.foot_forces() - fresh_forces(world)).max())
        # The reference saw up to 26 N at touch-down.
        assert max(differences) > 5.0
        for _ in range(100):
            world.step(go1.default_pose)
        # Standing, it makes no difference to the flags.
        np.testing.assert_array_equal(world.foot_contacts, fresh_forces(world) > 2.0)


def test_previous_contacts_are_those_of_the_step_before(go1, flat, swing):
    with World(go1, flat) as world:
        assert not world.foot_contacts.any()
        before = world.foot_contacts
        touched = 0
        for step in range(60):
            world.step(swing(step))
            np.testing.assert_array_equal(world.previous_foot_contacts, before)
            before = world.foot_contacts
            touched += int(before.sum())
        assert touched > 0


def test_joint_defaults_drag_the_free_joint_only_in_the_published_protocol(go1, flat):
    def speed_after_flight(protocol):
        with World(go1, flat, protocol=protocol) as world:
            world.reset(position=(0, 0, 3.0), yaw=0.0)
            world._data.qvel[0] = 1.0
            mujoco.mj_forward(world._model, world._data)
            start = world.center_of_mass
            for _ in range(10):
                world.step(go1.default_pose)
            # The centre of mass is blind to what the legs do meanwhile.
            return (world.center_of_mass[0] - start[0]) / world.time

    # In the air nothing else acts along x, so the mean speed stays 1 m/s.
    assert speed_after_flight(STRICT) == pytest.approx(1.0, abs=1e-6)
    # 0.5 N s/m x 1 m/s + 0.2 N of friction on 13 kg: 0.054 m/s^2, half of it in the mean of 0.2 s.
    lost = 0.5 * (0.5 * 1.0 + 0.2) / 12.995904 * 0.2
    assert speed_after_flight(NEVERWHERE_2026) == pytest.approx(1.0 - lost, abs=5e-4)


def test_a_contact_has_the_published_margin_and_the_larger_friction(go1, flat):
    with World(go1, flat) as world:
        for _ in range(50):
            world.step(go1.default_pose)
        contact = world._data.contact
        assert len(contact.geom) == 4
        np.testing.assert_allclose(contact.includemargin, 0.001, rtol=1e-12)
        np.testing.assert_array_equal(contact.friction, [[1.25, 1.25, 0.3, 0.3, 0.3]] * 4)


def test_a_friction_override_holds_even_below_that_of_the_feet(go1, place):
    scene = place(((0.2, 0.0, 0.01), (0.1, 0.5, 0.01)))
    with World(go1, scene, friction=0.4) as world:
        for _ in range(50):
            world.step(go1.default_pose)
        friction = world._data.contact.friction
        assert len(friction) >= 4
        np.testing.assert_array_equal(friction[:, :2], 0.4)
        np.testing.assert_array_equal(friction[:, 2:], 0.3)


def test_a_payload_is_carried(go1, flat):
    with World(go1, flat, payload=2.0) as world:
        assert world._model.body_mass.sum() == pytest.approx(12.985904 + 2.0)
        for _ in range(1000):
            world.step(go1.default_pose)
        assert world.foot_forces().sum() == pytest.approx(WEIGHT + 2.0 * 9.806, rel=0.02)


@pytest.mark.parametrize(
    ("option", "words"),
    [({"friction": 0.0}, "friction is 0"), ({"payload": -1.0}, "payload is -1")],
)
def test_impossible_perturbations_are_refused(go1, flat, option, words):
    with pytest.raises(UsageError, match=words):
        World(go1, flat, **option)


def test_servo_overrides_reach_every_joint(go1, flat):
    rows = np.arange(12, dtype=float)
    actuators = Actuators(
        kp=30 + rows,
        kd=0.1 + rows,
        torque_limits=10 + rows,
        armature=0.001 * (1 + rows),
        friction_loss=0.01 * rows,
    )
    with World(go1, flat, actuators=actuators) as world:
        model = world._model
        np.testing.assert_array_equal(model.actuator_gainprm[:, 0], 30 + rows)
        np.testing.assert_array_equal(model.actuator_biasprm[:, 1], -30 - rows)
        np.testing.assert_array_equal(model.actuator_forcerange[:, 1], 10 + rows)
        np.testing.assert_array_equal(model.actuator_forcerange[:, 0], -10 - rows)
        np.testing.assert_array_equal(model.dof_damping[6:], 0.1 + rows)
        np.testing.assert_array_equal(model.dof_armature[6:], 0.001 * (1 + rows))
        np.testing.assert_array_equal(model.dof_frictionloss[6:], 0.01 * rows)
        np.testing.assert_array_equal(model.dof_damping[:6], 0.0)


def test_torques_are_servo_stiffness_times_error_up_to_the_limit(go1, flat):
    with World(go1, flat) as world:
        world.step(go1.default_pose)
        targets = np.array(go1.default_pose)
        targets[1] += 0.1
        targets[2] += 5.0
        before = world.joint_positions
        world.step(targets)
        # Strict torques belong to the present joint angles.
        error = targets - world.joint_positions
        np.testing.assert_allclose(world.torques, np.clip(20 * error, -23.7, 23.7), atol=1e-9)
        assert world.torques[2] == 23.7
        assert not np.array_equal(before, world.joint_positions)


def test_legs_collide_with_each_other(go1, flat):
    # Hips turned inwards cross the front legs; with self collision they meet.
    pose = np.array(go1.default_pose)
    pose[[0, 3]] = (0.8, -0.8)
    with World(go1, flat) as world:
        world.reset(position=(0, 0, 1.5), yaw=0.0)
        met = set()
        for _ in range(20):
            world.step(pose)
            names = [world._model.geom(g).name for g in world._data.contact.geom.ravel()]
            met |= {tuple(sorted(pair)) for pair in zip(names[::2], names[1::2], strict=True)}
        assert any({a[:2], b[:2]} == {"FR", "FL"} for a, b in met)


def test_targets_that_are_not_numbers_are_refused(go1, flat):
    with World(go1, flat) as world:
        targets = np.array(go1.default_pose)
        targets[3] = np.nan
        with pytest.raises(TrialError, match=r"joint targets are not finite at 0\.000 s"):
            world.step(targets)


def test_diverged_physics_is_an_error_and_leaves_no_file(go1, flat, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with World(go1, flat) as world:
        world.step(go1.default_pose)
        world._data.qvel[0] = 1e12
        with pytest.raises(
            TrialError, match=r"physics failed at .* s: .* is NaN, infinite or huge"
        ):
            world.step(go1.default_pose)
    assert list(tmp_path.iterdir()) == []


def test_a_closed_world_says_so(go1, flat):
    world = World(go1, flat)
    world.close()
    world.close()
    with pytest.raises(TrialError, match="this World was closed"):
        world.step(go1.default_pose)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.8, 0.0)])
def test_an_impulse_changes_the_velocity_of_the_robots_mass_by_their_quotient(go1, flat, direction):
    impulse, steps = 20.0, 5
    with World(go1, flat) as world:

        def velocity():
            mujoco.mj_subtreeVel(world._model, world._data)
            return world._data.subtree_linvel[world._trunk].copy()

        world.reset(position=(0.0, 0.0, 5.0), yaw=0.4)  # In the air, where nothing else pushes.
        before = velocity()
        for _ in range(steps):
            world.pull(impulse / (steps * world.control_period) * np.array(direction))
            world.step(go1.default_pose)
        changed = velocity() - before
        expected = impulse / world.mass * np.array(direction)
        expected[2] -= 9.806 * steps * world.control_period
        np.testing.assert_allclose(changed, expected, atol=1e-3)
        world.step(go1.default_pose)  # And no longer than that.
        np.testing.assert_allclose(velocity() - before - changed, (0, 0, -9.806 * 0.02), atol=1e-3)


def test_a_force_acts_in_the_next_step_only_and_is_no_part_of_what_is_saved(go1, flat):
    with World(go1, flat) as world, World(go1, flat) as other:
        world.pull((30.0, 0.0, 0.0))
        world.step(go1.default_pose)
        other.restore(world.state())
        for each in (world, other):
            each.step(go1.default_pose)
        assert world.state() == other.state()


def test_trials_in_a_scene_share_a_model_of_equal_figures(go1, flat):
    with World(go1, flat) as one, World(go1, flat) as two, World(go1, flat, payload=1.0) as loaded:
        assert one._model is two._model
        assert loaded._model is not one._model
        assert loaded.mass == pytest.approx(one.mass + 1.0)
