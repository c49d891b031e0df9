"""Compiles robot and scene into one MuJoCo model.

Servo figures of the joints (`Actuators`) are the robot's own where a policy card overrides none. A
scene offers `ground` (a plane) and `solids`: boxes here; height fields, triangles and round
primitives by `nw_scenes.attach`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Self, assert_never
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from nw_base.errors import UsageError
from nw_scenes.attach import add_height_field, add_primitive, add_triangles
from nw_scenes.prop import Prop, prop_body
from nw_scenes.scene import Box, HeightField, Primitive, Scene, Triangles
from nw_sim.physics.binding import MjBody, MjModel, MjSpec, mujoco

if TYPE_CHECKING:
    from nw_base.protocol import EvaluationProtocol
    from nw_scenes.robots import RobotSpec
    from nw_scenes.robots.spec import Follow
    from nw_sim.physics.motors import Drive


Array = npt.NDArray[np.float64]
Model = MjModel
"""A compiled model as others hold it, who pass it on to this package and do not look into it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Actuators:
    """Motors, one row a joint in robot order. All arrays are (J,) float64."""

    kp: Array  # N m / rad
    # N m s / rad; acts as joint damping, which MuJoCo integrates implicitly. Of a motor that
    # follows velocities it is the gain, and what it gives is limited.
    kd: Array
    torque_limits: Array  # N m, symmetric
    armature: Array  # kg m^2
    friction_loss: Array  # N m
    viscous_friction: Array | float = 0.0  # N m s / rad, of the joints beside kd
    strength: float = 1.0  # of gain and largest torque, the share that is left
    # What they are told, all of them or (J,) each; only positions have a kp.
    follow: Follow | tuple[Follow, ...] = "position"
    # Groups of motors whose torque is computed at every physics step; others are MuJoCo's servos.
    drives: tuple[Drive, ...] = ()

    @property
    def driven(self) -> npt.NDArray[np.bool_]:
        """(J,) which of them are in one of `drives`."""
        driven = np.zeros(len(self.kp), dtype=np.bool_)
        for drive in self.drives:
            driven[drive.joints] = True
        return driven

    @property
    def follows(self) -> tuple[Follow, ...]:
        """(J,) what each is told."""
        return (self.follow,) * len(self.kp) if isinstance(self.follow, str) else self.follow

    @classmethod
    def of(cls, robot: RobotSpec) -> Self:
        """Return the robot's own figures, the start of any override by `dataclasses.replace`."""
        return cls(
            kp=np.array(robot.kp, dtype=np.float64),
            kd=np.array(robot.joint_damping, dtype=np.float64),
            torque_limits=np.array(robot.torque_limits, dtype=np.float64),
            armature=np.array(robot.armature, dtype=np.float64),
            friction_loss=np.array(robot.friction_loss, dtype=np.float64),
            follow=robot.follows or "position",
        )


GRAVITY = 9.806
SOLVER_ITERATIONS = 50


# A payload is a cube of this edge on the back of the robot: where, in the trunk frame.
_PAYLOAD_EDGE = 0.1
_PAYLOAD_POSITION = (0.0, 0.0, 0.107)


_shared: WeakKeyDictionary[Scene, tuple[tuple[Any, ...], MjModel]] = WeakKeyDictionary()


def shared_model(
    robot: RobotSpec,
    scene: Scene,
    *,
    protocol: EvaluationProtocol,
    actuators: Actuators,
    friction: float | None,
    payload: float,
    timestep: float,
) -> MjModel:
    """Return what `compile_model` does, to be read only: trials in a scene share it.

    Of each scene the newest is kept, as long as the scene is.
    """
    figures = [getattr(actuators, field.name) for field in fields(actuators)]
    figures[-1] = actuators.driven  # All that the model has of the `drives`.
    wanted = (
        *(robot.mjcf, robot.joints, robot.root, robot.root_joint, robot.root_defaults),
        *(one.tobytes() if isinstance(one, np.ndarray) else one for one in figures),
        *(protocol.joint_defaults_act_on_trunk, friction, payload, timestep),
    )
    kept = _shared.get(scene)
    if kept is not None and kept[0] == wanted:
        return kept[1]
    model = compile_model(
        robot,
        scene,
        protocol=protocol,
        actuators=actuators,
        friction=friction,
        payload=payload,
        timestep=timestep,
    )
    _shared[scene] = wanted, model
    return model


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
    if "velocity" in np.array(actuators.follows)[~actuators.driven]:
        # Their gain acts on the velocity and is limited, so it is no damping of a joint: with the
        # Euler integrator a light wheel would swing up.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    _set_joints(spec, robot, actuators, protocol)
    if payload > 0.0:
        _add_payload(spec, robot.root, payload)
    if any(isinstance(solid, HeightField | Triangles) for solid in scene.solids):
        _box_up(spec)
    add_geometry(spec, scene, friction=friction)
    for prop in scene.props:  # Behind the robot, whose numbers stay those of a scene without.
        _add_prop(spec, prop, friction=friction)
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
    driven = actuators.driven
    viscous = np.broadcast_to(actuators.viscous_friction, len(robot.joints))
    for index, name in enumerate(robot.joints):
        joint = spec.joint(name)
        follow = actuators.follows[index]
        is_damped = follow != "velocity" and not driven[index]
        joint.damping[0] = (actuators.kd[index] if is_damped else 0.0) + viscous[index]
        joint.armature = actuators.armature[index]
        joint.frictionloss = actuators.friction_loss[index]
        servo = spec.actuator(name)
        gains = {"position": actuators.kp[index], "velocity": actuators.kd[index], "torque": 1.0}
        gain = actuators.strength * gains[follow]
        if driven[index]:  # It is told its torque.
            follow, gain = "torque", 1.0
        servo.gainprm[0] = gain
        servo.biasprm[1] = -gain if follow == "position" else 0.0
        servo.biasprm[2] = -gain if follow == "velocity" else 0.0
        limit = actuators.strength * actuators.torque_limits[index]
        servo.forcerange = [-limit, limit]
    if protocol.joint_defaults_act_on_trunk:
        root = spec.joint(robot.root_joint)
        root.damping[0], root.armature, root.frictionloss = robot.root_defaults


def _box_up(spec: MjSpec) -> None:
    """Let boxes collide in place of what cannot meet a scanned surface: hulls and ellipsoids.

    A mesh gets the box round it, along the axes of its own inertia.
    """
    spec.compiler.fitaabb = True
    for geom in (geom for body in spec.bodies for geom in body.geoms):
        collides = geom.conaffinity & 1 or geom.contype & 1
        if collides and geom.type in {
            mujoco.mjtGeom.mjGEOM_MESH,
            mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        }:
            geom.type = mujoco.mjtGeom.mjGEOM_BOX


def _add_payload(spec: MjSpec, root: str, mass: float) -> None:
    inertia = mass * _PAYLOAD_EDGE**2 / 6.0
    spec.body(root).add_body(
        name="payload",
        pos=list(_PAYLOAD_POSITION),
        mass=mass,
        inertia=[inertia] * 3,
        explicitinertial=True,
    )


# With an override, scene geometry outranks the robot's, so that its friction alone counts.
_OVERRIDING_PRIORITY = 1


def add_geometry(spec: MjSpec, scene: Scene, *, friction: float | None) -> None:
    """Add ground and solids to the world body.

    Between two geoms MuJoCo takes the larger friction, element by element, so a foot (1.0) on the
    published ground (1.25) slides at 1.25. `friction` replaces the tangential coefficient of all
    scene geometry and then holds for every contact with it, also below the foot's own 1.0.
    """
    priority = 0 if friction is None else _OVERRIDING_PRIORITY
    world = spec.worldbody
    world.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        pos=[0, 0, scene.ground.z],
        friction=_with_tangential(scene.ground.friction, friction),
        priority=priority,
    )
    for index, solid in enumerate(scene.solids):
        name = f"solid_{index}"
        rough = _with_tangential(solid.friction, friction)
        match solid:
            case HeightField():
                add_height_field(spec, name, solid, friction=rough, priority=priority)
            case Triangles():
                add_triangles(spec, name, solid, friction=rough, priority=priority)
            case Primitive():
                add_primitive(spec, name, solid, friction=rough, priority=priority)
            case Box():
                _add_box(world, name, solid, friction=friction, priority=priority)
            case _:
                assert_never(solid)


def _add_box(world: MjBody, name: str, box: Box, *, friction: float | None, priority: int) -> None:
    world.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=list(box.half_size),
        pos=list(box.center),
        quat=list(box.quat),
        friction=_with_tangential(box.friction, friction),
        priority=priority,
    )


def _add_prop(spec: MjSpec, prop: Prop, *, friction: float | None) -> None:
    body = spec.worldbody.add_body(
        name=prop_body(prop.name), pos=list(prop.position), quat=list(prop.quat)
    )
    joint = prop.joint
    if joint.type == "free":
        body.add_freejoint(name=prop_body(prop.name))
    elif joint.type != "fixed":
        kind = mujoco.mjtJoint.mjJNT_HINGE if joint.type == "hinge" else mujoco.mjtJoint.mjJNT_SLIDE
        made = body.add_joint(
            name=prop_body(prop.name), type=kind, axis=list(joint.axis), pos=list(joint.anchor)
        )
        made.damping[0], made.frictionloss = joint.damping, joint.friction
        made.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        if joint.range is not None:
            in_degrees = joint.type == "hinge" and spec.compiler.degree
            made.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            made.range = np.rad2deg(joint.range) if in_degrees else np.array(joint.range)
    volumes = [float(np.prod(box.half_size)) for box in prop.boxes]
    for number, (box, volume) in enumerate(zip(prop.boxes, volumes, strict=True)):
        body.add_geom(
            name=f"{prop_body(prop.name)}/{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=list(box.half_size),
            pos=list(box.center),
            quat=list(box.quat),
            mass=prop.mass * volume / sum(volumes),
            friction=_with_tangential(prop.friction, friction),
            priority=0 if friction is None else _OVERRIDING_PRIORITY,
        )


def _with_tangential(friction: tuple[float, float, float], tangential: float | None) -> list[float]:
    return [friction[0] if tangential is None else tangential, friction[1], friction[2]]
