"""A robot in a scene, stepped at the control rate."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import numpy.typing as npt

from nw_base import same_bits
from nw_base.errors import TrialError
from nw_base.protocol import STRICT, EvaluationProtocol
from nw_scenes.prop import prop_body
from nw_sim.physics.binding import mujoco
from nw_sim.physics.body import Body, cast_at_visuals, geoms_of
from nw_sim.physics.forces import (
    CONTACT_THRESHOLD,
    ContactForces,
    Forces,
    PhysicsRate,
    specific_force,
)
from nw_sim.physics.looks import Looks, RobotRays
from nw_sim.physics.model import Actuators, shared_model
from nw_sim.physics.motors import Motors
from nw_sim.physics.state import check, fingerprint, keep_warnings_out_of_files, pack, unpack

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    from nw_scenes.robots import RobotSpec
    from nw_scenes.robots.spec import ImuMount
    from nw_scenes.scene import Scene
    from nw_sim.tasks import StartPose

Array = npt.NDArray[np.float64]


class World(Body):
    """Owns one MuJoCo model and its state.

    What can be read of the robot's pose and motion is in `Body`, with its frames; targets and
    torques are in the order of `robot.joints` too.

    One control step is `substeps` physics steps with constant targets. After it, poses, velocities
    and contacts all belong to the same, newest instant. The contact forces do as well, since the
    solver runs once more without integrating, unless the protocol `reads_forces_of_last_solve`: a
    contact that has no force from that solve reads 0.

    Use it as a context manager, or call `close`. It is not shared between threads.

    Args:
        robot: which robot.
        scene: where; its `ground` and `solids` collide.
        protocol: which of its behaviours are the published ones.
        actuators: figures of the motors, the robot's own if None.
        friction: tangential friction coefficient of the whole scene, or None for each solid's own.
        payload: extra mass on the back, kg.
        timestep: of the physics, s.
        substeps: physics steps per control step.

    Attributes:
        monitored: names of the parts whose contact is a collision.
        control_period: seconds of one control step.
        control_rate: control steps in a second, Hz.
        drives: groups of motors that are more than servos.
        props: numbers of the bodies of the scene's props in the model.
        steps: control steps since the reset.
        start_yaw: heading that the reset gave, rad.
    """

    def __init__(
        self,
        robot: RobotSpec,
        scene: Scene,
        *,
        protocol: EvaluationProtocol = STRICT,
        actuators: Actuators | None = None,
        friction: float | None = None,
        payload: float = 0.0,
        timestep: float = 0.005,
        substeps: int = 4,
    ) -> None:
        keep_warnings_out_of_files()
        motors = Actuators.of(robot) if actuators is None else actuators
        model = shared_model(
            robot,
            scene,
            protocol=protocol,
            actuators=motors,
            friction=friction,
            payload=payload,
            timestep=timestep,
        )
        super().__init__(robot, model, mujoco.MjData(model))
        self.scene = scene
        self.protocol = protocol
        self.control_period = timestep * substeps
        rate = 1.0 / self.control_period
        self.control_rate = round(rate) if abs(rate - round(rate)) < 1e-9 else rate
        self.steps = 0
        self.start_yaw = 0.0
        self.monitored = (
            robot.published_monitored if protocol.watches_published_geoms else robot.monitored
        )
        self.props = tuple(int(model.body(prop_body(prop.name)).id) for prop in scene.props)
        self._holds_pose = np.array(motors.follows) == "position"
        self.drives = motors.drives
        self._driven = motors.driven
        self._motors = Motors(motors, timestep) if motors.drives else None
        self._substeps = substeps
        self._fingerprint = fingerprint(model, motors)
        self._closed = False
        self._warned = self._data.warning.number  # A view, always of now.
        self._physics: PhysicsRate | None = None
        feet = geoms_of(model, robot, robot.feet)
        # A foot that is made of several geoms has no centre of its own.
        self._feet = (
            np.array([geoms[0] for geoms in feet], dtype=np.intp)
            if all(len(geoms) == 1 for geoms in feet)
            else None
        )
        self._contact_forces = ContactForces(
            model,
            robot,
            (*robot.feet, *self.monitored),
            in_contact_frames=protocol.adds_forces_in_contact_frames,
        )
        self._forces: Forces
        start = scene.spawn
        x, y, z = start.position
        self.reset(position=(x, y, z + robot.spawn_height), yaw=start.yaw)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the simulation; calling it again does nothing."""
        self._closed = True

    # Moving.

    def reset(
        self,
        *,
        position: Sequence[float] | Array,
        yaw: float,
        joint_positions: Sequence[float] | Array | None = None,
    ) -> None:
        """Put the robot at rest.

        Args:
            position: (3,) of the trunk's origin in the world, m. For a start on the ground that is
                `scene.spawn.position` plus `robot.spawn_height` upwards.
            yaw: heading, rad; roll and pitch are 0.
            joint_positions: (J,) rad, the default pose if None. Servos hold it; motors that
                follow velocities stand still, and those that follow torques are idle.
        """
        self._require_open()
        pose = self.robot.default_pose if joint_positions is None else joint_positions
        data = self._data
        mujoco.mj_resetData(self._model, data)
        data.qpos[self._place] = position
        data.qpos[self._turn] = (np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0))
        data.qpos[self._joints] = pose
        self._hold(np.array(pose))
        self.steps = 0
        self.start_yaw = yaw
        mujoco.mj_forward(self._model, data)
        # Nothing has been sensed before the first step.
        self._forces = self._read_forces(np.zeros(len(self.robot.feet), dtype=np.bool_))
        check(data, self.time)

    def begin(self, pose: StartPose) -> None:
        """Put the robot into a pose, moving, after a `reset`; servos steer to its joints."""
        self._require_open()
        data = self._data
        data.qpos[self._place], data.qpos[self._turn] = pose.position, pose.quat
        data.qpos[self._joints] = pose.joint_positions
        data.qvel[self._linear], data.qvel[self._angular] = pose.velocity, pose.rates
        data.qvel[self._joint_rates] = pose.joint_velocities
        self._hold(np.array(pose.joint_positions))
        mujoco.mj_forward(self._model, data)
        self._forces = self._read_forces(np.zeros(len(self.robot.feet), dtype=np.bool_))
        check(data, self.time)

    def _hold(self, pose: Array) -> None:
        """Tell the motors what counts before the first step."""
        held = np.where(self._holds_pose, pose, 0.0)
        # Nothing has driven the motors of groups yet, which are told torques.
        self._data.ctrl[:] = np.where(self._driven, 0.0, held)
        if self._motors is not None:
            self._motors.reset(held)

    def push(self, velocity: Sequence[float] | Array) -> None:
        """Add a velocity to the trunk's, (2,) m/s in the world's x and y, before a step."""
        self._require_open()
        self._data.qvel[self._linear][:2] += velocity
        mujoco.mj_step1(self._model, self._data)

    def pull(self, force: Sequence[float] | Array) -> None:
        """Let a force act in the next control step, and no longer.

        It acts on the centre of mass of the robot's root body, the same in each physics step: over
        a control step of T s the momentum of the robot changes by T times the force, beside what
        gravity and contacts do.

        Args:
            force: (3,) N, world frame.
        """
        self._require_open()
        self._data.xfrc_applied[self._trunk, :3] = force

    def step(self, targets: Sequence[float] | Array) -> None:
        """Run one control step.

        Args:
            targets: (J,) joint positions that the servos steer to, rad; or velocities, rad/s, or
                torques, N m, for motors that follow them.

        Raises:
            DivergedError: the physics diverged.
            TrialError: a target is not finite, or the physics failed otherwise.
        """
        self._require_open()
        model, data = self._model, self._data
        data.ctrl[:] = targets
        # A sum is finite only if all of its parts are.
        if not math.isfinite(sum(data.ctrl.tolist())) and not np.isfinite(data.ctrl).all():
            raise TrialError(
                f"joint targets are not finite at {self.time:.3f} s: {data.ctrl.tolist()}",
                fix="check the policy's actions",
            )
        # Positions and velocities are already current here, so the first physics step skips them.
        if self._motors is not None:
            self._step_driven(self._motors)
        elif (physics := self._physics) is None:
            mujoco.mj_step2(model, data)
            mujoco.mj_step(model, data, self._substeps - 1)
        else:
            mujoco.mj_step2(model, data)
            physics.take(0)
            for substep in range(1, self._substeps):
                mujoco.mj_step(model, data)
                physics.take(substep)
        data.xfrc_applied[self._trunk] = 0.0
        # Taken before contacts move its rows; beyond the last, that memory is anything: it reads 0.
        reads_last = self.protocol.reads_forces_of_last_solve
        solved: Array | None = data.efc_force.copy() if reads_last else None
        self._derive()
        self.steps += 1
        self._forces = self._read_forces(self._forces.contacts, solved)
        if any(self._warned.tolist()):
            check(data, self.time)

    def _step_driven(self, motors: Motors) -> None:
        """Run the physics steps of a control step whose targets are in `ctrl`."""
        model, data = self._model, self._data
        targets = data.ctrl.copy()
        for substep in range(self._substeps):
            positions, velocities = data.qpos[self._joints], data.qvel[self._joint_rates]
            motors.drive(targets, positions, velocities, data.ctrl)
            if substep == 0:
                mujoco.mj_step2(model, data)
            else:
                mujoco.mj_step(model, data)
            if self._physics is not None:
                self._physics.take(substep)

    def state(self) -> bytes:
        """Return everything that the future depends on, for `restore`."""
        self._require_open()
        return pack(self._model, self._data, self._numbers(), self._fingerprint)

    def restore(self, state: bytes) -> None:
        """Go back to a state of a world with the same robot, scene and options, bit for bit.

        Raises:
            TrialError: the state is damaged or belongs to another model.
        """
        self._require_open()
        numbers = {name: array.copy() for name, array in self._numbers().items()}
        unpack(self._model, self._data, numbers, self._fingerprint, state)
        # The rest follows from the state; the solver's warm start is part of it.
        self._derive()
        self.steps = int(numbers["steps"][0])
        self.start_yaw = float(numbers["start_yaw"][0])
        if self._motors is not None:
            self._motors.memory[:] = numbers["motors"]
        self._forces = Forces(
            feet=numbers["foot_forces"],
            monitored=numbers["monitored_forces"],
            torques=numbers["torques"],
            acceleration=numbers["acceleration"],
            contacts=numbers["contacts"] > 0.0,
            previous_contacts=numbers["previous_contacts"] > 0.0,
        )

    @property
    def motor_bytes(self) -> int:
        """Bytes at the end of a `state` that are the motors'."""
        return 0 if self._motors is None else self._motors.memory.nbytes

    def adopt(self, other: World) -> None:
        """Go on from where another world of the same robot stands, whatever its scene and loads."""
        self._require_open()
        data, there = self._data, other._data
        mujoco.mj_resetData(self._model, data)
        data.time = there.time
        for name in ("qpos", "qvel", "qacc_warmstart", "ctrl"):
            ours, theirs = getattr(data, name), getattr(there, name)
            both = min(len(ours), len(theirs))  # The robot's come first, then those of props.
            ours[:both] = theirs[:both]
        held = np.where(self._holds_pose, data.qpos[self._joints], 0.0)
        if (changed := self._driven != other._driven).any():  # Torques and targets are two things.
            data.ctrl[changed] = np.where(self._driven, 0.0, held)[changed]
        if (motors := self._motors) is not None:
            theirs = None if other._motors is None else other._motors.memory
            if theirs is not None and theirs.size == motors.memory.size:
                motors.memory[:] = theirs
            else:
                motors.reset(held)
        self._derive()
        self.steps, self.start_yaw = other.steps, other.start_yaw
        self._forces = other._forces

    def pose(self, position: Array, quat: Array, joint_positions: Array) -> None:
        """Put the robot's bodies where they are drawn; forces and velocities stay as they are.

        Args:
            position: (3,) m of the trunk in the world.
            quat: (4,) of the trunk.
            joint_positions: (J,) rad.
        """
        self._require_open()
        data = self._data
        data.qpos[self._place], data.qpos[self._turn] = position, quat
        data.qpos[self._joints] = joint_positions
        mujoco.mj_kinematics(self._model, data)

    # What there is to know.

    def at_physics_rate(self) -> PhysicsRate:
        """Return what each further control step leaves of its physics steps.

        Nothing is kept before this is asked for: it costs some microseconds a control step.
        """
        if self._physics is None:
            self._physics = PhysicsRate(self._model, self._data, self._substeps, self._joint_rates)
        return self._physics

    def prop_poses(self) -> list[Array]:
        """Return T_world_prop, (4, 4), of each of `scene.props`, now."""
        poses: list[Array] = []
        for body in self.props:
            pose = np.eye(4)
            pose[:3, :3] = self._data.xmat[body].reshape(3, 3)
            pose[:3, 3] = self._data.xpos[body]
            poses.append(pose)
        return poses

    def trunk_readings(self) -> tuple[Array, Array, Array]:
        """Return what scores read of the trunk, now: views of the simulation's memory.

        Returns:
            Position (3,), rotation (9,), R_world_trunk row by row, and the velocities of `moving`,
            (6,).
        """
        data, trunk = self._data, self._trunk
        return data.xpos[trunk], data.xmat[trunk], data.qvel[self._rates]

    @property
    def timestep(self) -> float:
        """Of the physics, s."""
        return float(self._model.opt.timestep)

    @property
    def mass(self) -> float:
        """Of the robot with its payload, kg."""
        return float(self._model.body_subtreemass[self._trunk])

    @property
    def gravity(self) -> float:
        """Its size, m / s^2."""
        return float(np.linalg.norm(self._model.opt.gravity))

    @property
    def torque_limits(self) -> Array:
        """Largest torque of each motor here, (J,) N m: card and perturbations included."""
        return self._model.actuator_forcerange[:, 1].copy()

    @property
    def foot_positions(self) -> Array:
        """Centres of the feet in the world, (F, 3) m, in the order of `robot.feet`."""
        if self._feet is None:
            return self.foot_places()[0]
        return self._data.geom_xpos.take(self._feet, axis=0)

    @property
    def time(self) -> float:
        """Seconds since the reset."""
        return self.steps * self.control_period

    def specific_force(self, at: Sequence[float]) -> Array:
        """Return what an accelerometer reads: acceleration minus gravity.

        It belongs to the instant that contact forces do.

        Args:
            at: (3,) where it sits, from the IMU and along its axes, m; of a robot without one, from
                the trunk's origin along the trunk's axes.

        Returns:
            (3,) m / s^2 along these axes.
        """
        imu = self.robot.imu
        if imu is not None:
            R = np.array(imu.R_body_imu)
            place = np.array(imu.position) + R @ np.array(at)
            return same_bits.product(self._specific_force(place, imu), R)
        return specific_force(
            at,
            acceleration=self._forces.acceleration,
            rates=self.trunk_angular_velocity,
            R_world_trunk=self.trunk_rotation,
            gravity=self._model.opt.gravity,
        )

    def _specific_force(self, at: Array, imu: ImuMount) -> Array:
        """Return the same along the axes of the IMU's body, at a point (3,) in it, m."""
        if not imu.body:
            return specific_force(
                at.tolist(),
                acceleration=self._forces.acceleration,
                rates=self.trunk_angular_velocity,
                R_world_trunk=self.trunk_rotation,
                gravity=self._model.opt.gravity,
            )
        acceleration, kind = np.empty(6), mujoco.mjtObj.mjOBJ_XBODY
        body = self._carrier(imu)
        mujoco.mj_objectVelocity(self._model, self._data, kind, body, acceleration, 1)
        rates, change = acceleration[:3], self._forces.acceleration[:3]
        # The acceleration of the body's origin is given without gravity, as a sensor has it.
        own = self._forces.acceleration[3:]
        return own + np.cross(rates, np.cross(rates, at)) + np.cross(change, at)

    def _acceleration(self) -> Array:
        """Return what `Forces.acceleration` holds, (6,)."""
        imu = self.robot.imu
        if imu is None or not imu.body:
            return self._data.qacc[self._rates].copy()
        acceleration, kind = np.empty(6), mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_rnePostConstraint(self._model, self._data)
        mujoco.mj_objectAcceleration(
            self._model, self._data, kind, self._carrier(imu), acceleration, 1
        )
        return acceleration

    @property
    def torques(self) -> Array:
        """Servo torques after clipping, without joint damping, (J,) N m."""
        return self._forces.torques.copy()

    @property
    def foot_contacts(self) -> npt.NDArray[np.bool_]:
        """Whether each foot pushes with more than 2 N now, (F,) in the order of `robot.feet`."""
        return self._forces.contacts.copy()

    @property
    def previous_foot_contacts(self) -> npt.NDArray[np.bool_]:
        """The same, one control step ago; all False before the second step."""
        return self._forces.previous_contacts.copy()

    def foot_forces(self) -> Array:
        """Return the contact force on each foot, (F,) N."""
        return self._forces.feet.copy()

    def monitored_force(self) -> float:
        """Return the largest contact force on any monitored part, N."""
        return self._forces.largest

    def monitored_forces(self) -> dict[str, float]:
        """Return the contact force on each monitored part by name, N."""
        return dict(zip(self.monitored, self._forces.monitored.tolist(), strict=True))

    def ray_robot(
        self,
        origins: Array,
        directions: Array,
        *,
        exclude: Literal["nothing", "trunk"] = "nothing",
    ) -> RobotRays:
        """Cast rays at what the robot looks like.

        Args:
            origins: (3,) for a common origin, which is fast, or (N, 3); world frame.
            directions: (N, 3) unit vectors, world frame.
            exclude: `trunk` leaves out trunk and head, for cameras that sit inside them; or the
                body that carries the camera at `origins`, where it is another.
        """
        self._require_open()
        body = self._sees_from(origins) if exclude == "trunk" else -1
        if self.robot.pictured == "visuals":
            return self._looks.cast(self._data, origins, directions, exclude_body=body)
        return cast_at_visuals(self._model, self._data, origins, directions, exclude_body=body)

    def ray_ghost(
        self,
        pose: tuple[Array, Array, Array],
        origin: Array,
        directions: Array,
    ) -> Array:
        """Cast rays at what the robot would look like in another pose.

        Args:
            pose: position (3,) m and quaternion (4,) of the trunk, and (J,) rad.
            origin: (3,) of all rays, world frame.
            directions: (N, 3) unit vectors, world frame.

        Returns:
            Distances (N,) m; inf where nothing is.
        """
        self._require_open()
        data = mujoco.MjData(self._model)
        data.qpos[self._place], data.qpos[self._turn], data.qpos[self._joints] = pose
        mujoco.mj_kinematics(self._model, data)
        if self.robot.pictured == "visuals":
            return self._looks.cast(data, origin, directions, exclude_body=-1).distance
        return cast_at_visuals(self._model, data, origin, directions).distance

    @property
    def geom_rgba(self) -> npt.NDArray[np.float32]:
        """Colour of all that rays can meet of the robot, (G, 4), for `RobotRays.geom`."""
        return self._looks.rgba if self.robot.pictured == "visuals" else super().geom_rgba

    # Inside.

    @cached_property
    def _looks(self) -> Looks:
        return Looks(self.robot, self._model)

    def _sees_from(self, origin: Array) -> int:
        """Return the number of the body whose camera is at a point (3,), else of the trunk."""
        for name, mount in self.robot.cameras.items():
            if mount.body and origin.ndim == 1:
                away = self.camera_pose(name)[:3, 3] - origin
                if np.abs(away).max() < 1e-9:
                    return self._carrier(mount)
        return self._trunk

    def _derive(self) -> None:
        """Compute what follows from the state: forces too, unless those of before are read."""
        if self.protocol.reads_forces_of_last_solve:
            mujoco.mj_step1(self._model, self._data)
        else:
            mujoco.mj_forward(self._model, self._data)

    def _read_forces(
        self, previous_contacts: npt.NDArray[np.bool_], solved: Array | None = None
    ) -> Forces:
        contact = self._contact_forces.read(self._data, solved)
        count = len(self.robot.feet)
        feet = contact[:count]
        return Forces(
            feet=feet,
            monitored=contact[count:],
            torques=self._data.actuator_force.copy(),
            acceleration=self._acceleration(),
            contacts=feet > CONTACT_THRESHOLD,
            previous_contacts=previous_contacts,
        )

    def _numbers(self) -> dict[str, Array]:
        """Return what a state holds besides MuJoCo's own, as float64 arrays, in its order.

        Some are in memory of others: do not change them.
        """
        forces = self._forces
        motors = {} if self._motors is None else {"motors": self._motors.memory}
        return {
            "steps": np.array([self.steps], dtype=np.float64),
            "foot_forces": forces.feet,
            "monitored_forces": forces.monitored,
            "torques": forces.torques,
            "acceleration": forces.acceleration,
            "start_yaw": np.array([self.start_yaw]),
            "contacts": forces.contacts.astype(np.float64),
            "previous_contacts": forces.previous_contacts.astype(np.float64),
            **motors,
        }

    def _require_open(self) -> None:
        if self._closed:
            raise TrialError("this World was closed", fix="make a new one for each trial")
