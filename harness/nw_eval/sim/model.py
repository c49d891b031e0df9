"""Compiles robot and scene into one MuJoCo model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nw_eval.errors import UsageError
from nw_eval.sim.binding import MjModel, MjSpec, mujoco
from nw_eval.sim.geometry import add_geometry

if TYPE_CHECKING:
    from nw_eval.protocol import EvaluationProtocol
    from nw_eval.robots import RobotSpec
    from nw_eval.scenes.scene import Scene
    from nw_eval.sim.actuators import Actuators

GRAVITY = 9.806
SOLVER_ITERATIONS = 50

# A payload is a cube of this edge on the back of the robot: where, in the trunk frame.
_PAYLOAD_EDGE = 0.1
_PAYLOAD_POSITION = (0.0, 0.0, 0.107)


def compile_model(
    robot: RobotSpec,
    scene: Scene,
    *,
    protocol: EvaluationProtocol,
    actuators: Actuators,
    friction: float | None,
    payload: float,
    timestep: float,
) -> MjModel:
    """Return the model of `robot` in `scene`, with the published solver options.

    Args:
        robot: its MJCF is the root of the model.
        scene: gives the static collision geometry.
        protocol: whether its `joint_defaults_act_on_trunk`.
        actuators: servo figures, in robot order.
        friction: tangential friction of all scene geometry, or None for each solid's own.
        payload: kg on the back; 0 adds no body.
        timestep: seconds.

    Raises:
        UsageError: a perturbation is out of range.
    """
    if friction is not None and not 0.0 < friction < np.inf:
        raise UsageError(f"friction is {friction:g}", fix="give a positive coefficient")
    if not 0.0 <= payload < np.inf:
        raise UsageError(f"payload is {payload:g} kg", fix="give 0 kg or more")
    spec = mujoco.MjSpec.from_string(robot.mjcf)
    _set_options(spec, timestep)
    _set_joints(spec, robot, actuators, protocol)
    if payload > 0.0:
        _add_payload(spec, payload)
    add_geometry(spec, scene, friction=friction)
    return spec.compile()


def _set_options(spec: MjSpec, timestep: float) -> None:
    option = spec.option
    option.timestep = timestep
    option.gravity = [0.0, 0.0, -GRAVITY]
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations = SOLVER_ITERATIONS
    option.tolerance = 1e-8
    option.impratio = 1.0
    # A diverged state must end the trial, not silently start it again.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _set_joints(
    spec: MjSpec, robot: RobotSpec, actuators: Actuators, protocol: EvaluationProtocol
) -> None:
    for index, name in enumerate(robot.joints):
        joint = spec.joint(name)
        joint.damping[0] = actuators.kd[index]
        joint.armature = actuators.armature[index]
        joint.frictionloss = actuators.friction_loss[index]
        servo = spec.actuator(name)
        follows_position = actuators.follow == "position"
        gain = actuators.strength * (actuators.kp[index] if follows_position else 1.0)
        servo.gainprm[0] = gain
        servo.biasprm[1] = -gain if follows_position else 0.0
        limit = actuators.strength * actuators.torque_limits[index]
        servo.forcerange = [-limit, limit]
    if protocol.joint_defaults_act_on_trunk:
        root = spec.joint("root")
        root.damping[0] = robot.joint_damping
        root.armature = robot.armature
        root.frictionloss = robot.friction_loss


def _add_payload(spec: MjSpec, mass: float) -> None:
    inertia = mass * _PAYLOAD_EDGE**2 / 6.0
    spec.body("trunk").add_body(
        name="payload",
        pos=list(_PAYLOAD_POSITION),
        mass=mass,
        inertia=[inertia] * 3,
        explicitinertial=True,
    )
