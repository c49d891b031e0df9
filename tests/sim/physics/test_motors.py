"""Motors of the physics step, against formulas of their sources and torch's own networks.

The truths are computed here, from the configuration's numbers and what joints did.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from nw_base.errors import TrialError
from nw_policies.cards.motors import DcMotor, FirstOrder, NetworkMotor, PdMotor, SecondOrder
from nw_policies.motor_network import motor_program
from nw_sim.physics import Actuators, World
from nw_sim.physics.motors import Drive, Motors, discretised

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
STEP = 0.005
EVERY = np.arange(12)


def drive(motor, joints=EVERY, program=None):
    return Drive(motor=motor, joints=np.array(joints, dtype=np.intp), program=program)


def actuators(robot, *drives, **changes):
    return replace(Actuators.of(robot), drives=drives, **changes)


def pd(**keys):
    return PdMotor(kind="pd", **keys)


def dc(stall=40.0, speed=20.0, **keys):
    return DcMotor(kind="dc", saturation_torque=stall, no_load_speed=speed, **keys)


def isaac_lab(effort, velocity, limit, stall, speed):
    """Return the clipped effort as `DCMotor._clip_effort` of Isaac Lab does, for one joint."""
    fastest = speed * (1 + limit / stall)
    velocity = min(max(velocity, -fastest), fastest)
    top = min(stall * (1.0 - velocity / speed), limit)
    bottom = max(stall * (-1.0 - velocity / speed), -limit)
    return min(max(effort, bottom), top)


@pytest.mark.parametrize("limit", [23.7, 40.0])
@pytest.mark.parametrize("velocity", [-60.0, -21.0, -20.0, -8.0, 0.0, 3.0, 19.0, 20.0, 31.0, 90.0])
def test_a_dc_motor_has_isaac_labs_torque_speed_curve(go1, limit, velocity):
    motors = Motors(actuators(go1, drive(dc()), torque_limits=np.full(12, limit)), STEP)
    motors.reset(np.zeros(12))
    targets = np.linspace(-3.0, 3.0, 12)
    out = np.zeros(12)
    motors.drive(targets, np.zeros(12), np.full(12, velocity), out)
    kp, kd = Actuators.of(go1).kp, Actuators.of(go1).kd
    wanted = [
        isaac_lab(kp[j] * targets[j] - kd[j] * velocity, velocity, limit, 40.0, 20.0) for j in EVERY
    ]
    np.testing.assert_allclose(out, wanted, rtol=1e-12, atol=1e-12)


def test_far_from_its_curve_a_dc_motor_is_a_pd_motor_to_the_bit(go1, flat, swing):
    strong = dc(stall=1e5, speed=1e4)
    with (
        World(go1, flat, actuators=actuators(go1, drive(pd()))) as plain,
        World(go1, flat, actuators=actuators(go1, drive(strong))) as curved,
    ):
        for step in range(50):
            plain.step(swing(step))
            curved.step(swing(step))
        np.testing.assert_array_equal(curved.joint_positions, plain.joint_positions)


def test_a_pd_motor_gives_kp_error_minus_kd_velocity_within_its_limit(go1, flat, swing):
    motors = actuators(go1, drive(pd()), torque_limits=np.full(12, 5.0))
    with World(go1, flat, actuators=motors, substeps=1) as world:
        clipped = 0
        for step in range(80):
            q, v = world.joint_positions, world.joint_velocities
            world.step(swing(step))
            wanted = motors.kp * (swing(step) - q) - motors.kd * v
            clipped += int((np.abs(wanted) > 5.0).sum())
            np.testing.assert_allclose(
                world.torques, np.clip(wanted, -5.0, 5.0), rtol=1e-12, atol=1e-12
            )
        assert clipped > 10


def test_joints_of_no_group_stay_servos(go1, flat):
    motors = actuators(go1, drive(pd(), joints=[0, 3, 6, 9]))
    with World(go1, flat, actuators=motors) as world:
        model = world._model
        kept = [1, 2, 4, 5, 7, 8, 10, 11]
        np.testing.assert_array_equal(model.actuator_gainprm[kept, 0], motors.kp[kept])
        np.testing.assert_array_equal(model.actuator_gainprm[[0, 3, 6, 9], 0], 1.0)
        np.testing.assert_array_equal(model.actuator_biasprm[[0, 3, 6, 9], 1], 0.0)
        damping = model.dof_damping[6:]
        np.testing.assert_array_equal(damping[kept], motors.kd[kept])
        np.testing.assert_array_equal(damping[[0, 3, 6, 9]], 0.0)


@pytest.mark.parametrize("late", [1, 3, 10])
def test_a_delay_is_of_physics_steps(go1, late):
    motors = Motors(actuators(go1, drive(pd(delay=late))), STEP)
    held, told = np.full(12, 0.1), np.random.default_rng(0).normal(size=(30, 12))
    motors.reset(held)
    kp, out = Actuators.of(go1).kp, np.zeros(12)
    for step, target in enumerate(told):
        motors.drive(target, np.zeros(12), np.zeros(12), out)
        wanted = held if step < late else told[step - late]
        np.testing.assert_allclose(out, kp * wanted, rtol=1e-12)


def response_of(response, steps, robot):
    """Return the target that a motor follows after a step from 0 to 1, at each physics step."""
    motors = Motors(actuators(robot, drive(pd(response=response)), kp=np.ones(12)), STEP)
    motors.reset(np.zeros(12))
    out, followed = np.zeros(12), []
    for _ in range(steps):
        motors.drive(np.ones(12), np.zeros(12), np.zeros(12), out)
        followed.append(out[5])
    return np.array(followed)


@pytest.mark.parametrize("time_constant", [0.0005, 0.02, 0.3])
def test_a_first_order_response_is_its_exponential(go1, time_constant):
    t = STEP * np.arange(1, 101)
    found = response_of(FirstOrder(time_constant=time_constant), 100, go1)
    np.testing.assert_allclose(found, 1.0 - np.exp(-t / time_constant), atol=1e-12)


@pytest.mark.parametrize("damping", [0.2, 0.7, 1.5])
@pytest.mark.parametrize("frequency", [1.0, 8.0, 60.0])
def test_a_second_order_response_is_its_closed_form(go1, frequency, damping):
    t, w = STEP * np.arange(1, 101), 2 * math.pi * frequency
    root = np.sqrt(complex(damping**2 - 1.0))
    one, other = w * (-damping + root), w * (-damping - root)
    closed = 1.0 + (other * np.exp(one * t) - one * np.exp(other * t)) / (one - other)
    response = SecondOrder(frequency=frequency, damping=damping)
    np.testing.assert_allclose(response_of(response, 100, go1), closed.real, atol=1e-9)


def test_the_step_of_a_stiff_response_is_exact():
    A, b = discretised(*FirstOrder(time_constant=1e-4).continuous(), 0.01)
    assert A[0, 0] == pytest.approx(math.exp(-100.0), abs=1e-12)
    assert b[0] == pytest.approx(1.0 - math.exp(-100.0), rel=1e-12)


@pytest.fixture(scope="module")
def networked(tmp_path_factory):
    """A network of walk-these-ways' layout: its group of motors, and the module of torch."""
    torch.manual_seed(3)
    module = nn.Sequential(nn.Linear(6, 8), nn.Softsign(), nn.Linear(8, 1)).eval()
    path = tmp_path_factory.mktemp("motor") / "motor.pt"
    torch.jit.script(module).save(str(path))
    motor = NetworkMotor(
        kind="network", file="motor.pt", history=[0, 1, 2], pos_scale=-1.0, torque_scale=8.0
    )
    program = motor_program(path.read_bytes(), "motor.pt", joints=12, inputs=6)
    return drive(motor, program=program), module


@pytest.mark.parametrize("order", ["pos_vel", "vel_pos"])
def test_a_network_gets_errors_and_velocities_of_the_last_physics_steps(
    go1, flat, swing, networked, order
):
    group, module = networked
    group = replace(group, motor=group.motor.model_copy(update={"order": order}))
    errors, speeds = np.zeros((3, 12)), np.zeros((3, 12))
    with World(go1, flat, actuators=actuators(go1, group), substeps=1) as world:
        for step in range(60):
            errors = np.vstack([-(swing(step) - world.joint_positions), errors[:2]])
            speeds = np.vstack([world.joint_velocities, speeds[:2]])
            rows = [errors, speeds] if order == "pos_vel" else [speeds, errors]
            world.step(swing(step))
            with torch.inference_mode():
                given = torch.from_numpy(np.vstack(rows).T.astype(np.float32))
                wanted = 8.0 * module(given).numpy().ravel()
            limits = Actuators.of(go1).torque_limits
            wanted = np.clip(wanted, -limits, limits)
            np.testing.assert_allclose(world.torques, wanted, atol=1e-4)
        assert np.abs(wanted).max() > 0.5


def groups(networked):
    return {
        "delay": [drive(pd(delay=7))],
        "response": [drive(dc(response=SecondOrder(frequency=8.0, damping=0.7)))],
        "network": [networked[0]],
        "mixed": [
            drive(dc(delay=3), joints=range(6)),
            drive(pd(response=FirstOrder(time_constant=0.02)), joints=range(6, 10)),
        ],
    }


@pytest.mark.parametrize("kind", ["delay", "response", "network", "mixed"])
def test_a_world_goes_on_from_a_state_to_the_bit(go1, flat, swing, networked, kind):
    motors = actuators(go1, *groups(networked)[kind])
    with World(go1, flat, actuators=motors) as one, World(go1, flat, actuators=motors) as other:
        for step in range(30):
            one.step(swing(step))
        state = one.state()
        for step in range(5):  # What it remembers of these is forgotten.
            other.step(-swing(step))
        other.restore(state)
        assert other.state() == state
        for step in range(30, 60):
            one.step(swing(step))
            other.step(swing(step))
        assert one.state() == other.state()


def test_a_reset_forgets_what_motors_remember(go1, flat, swing, networked):
    motors = actuators(go1, *groups(networked)["network"])
    with World(go1, flat, actuators=motors) as used, World(go1, flat, actuators=motors) as fresh:
        for step in range(20):
            used.step(swing(step))
        for world in (used, fresh):
            world.reset(position=(0.0, 0.0, 0.4), yaw=0.0)
            world.step(swing(0))
        assert used.state() == fresh.state()


def test_a_state_of_other_motors_is_refused(go1, flat):
    with (
        World(go1, flat, actuators=actuators(go1, drive(dc(stall=40.0)))) as one,
        World(go1, flat, actuators=actuators(go1, drive(dc(stall=41.0)))) as other,
        pytest.raises(TrialError, match="another model"),
    ):
        other.restore(one.state())


@pytest.mark.parametrize("kinds", [("delay", None), (None, "delay"), ("delay", "network")])
def test_a_world_takes_over_from_one_with_other_motors(go1, flat, swing, networked, kinds):
    """Targets of a servo are angles and those of a group's motor torques: neither is the other."""
    first, second = (
        actuators(go1, *([] if kind is None else groups(networked)[kind])) for kind in kinds
    )
    with World(go1, flat, actuators=first) as one, World(go1, flat, actuators=second) as other:
        for step in range(40):
            one.step(swing(step))
        other.adopt(one)
        np.testing.assert_array_equal(other.joint_positions, one.joint_positions)
        other.step(swing(40))
        assert np.abs(other.joint_velocities).max() < 30.0


def test_a_share_of_strength_is_one_of_gain_and_stall_torque(go1):
    motors = Motors(actuators(go1, drive(dc(stall=10.0, speed=5.0)), strength=0.5), STEP)
    motors.reset(np.zeros(12))
    out = np.zeros(12)
    motors.drive(np.full(12, 0.01), np.zeros(12), np.zeros(12), out)
    np.testing.assert_allclose(out, 0.5 * Actuators.of(go1).kp * 0.01)
    motors.drive(np.full(12, 9.0), np.zeros(12), np.zeros(12), out)
    np.testing.assert_allclose(out, 5.0)


def test_viscous_friction_is_damping_of_the_joint_beside_kd(go1, flat):
    rough = np.linspace(0.1, 0.5, 12)
    for drives in ((), (drive(pd()),)):
        motors = actuators(go1, *drives, viscous_friction=rough)
        with World(go1, flat, actuators=motors) as world:
            damping = world._model.dof_damping[6:]
        own = 0.0 if drives else motors.kd
        np.testing.assert_allclose(damping, own + rough)
