"""A robot in a scene, stepped at the control rate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import numpy.typing as npt

from nw_eval.errors import TrialError, UsageError, nearest
from nw_eval.sim import health, snapshot
from nw_eval.sim.actuators import Actuators
from nw_eval.sim.binding import MjData, MjModel, mujoco
from nw_eval.sim.contacts import ContactForces
from nw_eval.sim.model import compile_model
from nw_eval.sim.rays import RobotRays, cast_at_visuals

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    from nw_eval.robots import RobotSpec
    from nw_eval.scenes.scene import Scene
    from nw_eval.sim.protocol import Protocol

Array = npt.NDArray[np.float64]

# A foot is in contact above this force, N.
CONTACT_THRESHOLD = 2.0

_JOINTS = slice(7, None)  # of qpos, after the free joint's 7 numbers
_JOINT_RATES = slice(6, None)  # of qvel


class World:
    """Owns one MuJoCo model and its state.

    Frames: world z up; the trunk frame x forward, y left, z up; quaternions w x y z; joints,
    targets and torques in the order of `robot.joints`. Every property returns a fresh array.

    One control step is `substeps` physics steps with constant targets. After it, poses, velocities
    and contacts all belong to the same, newest instant. Under `strict` the contact forces do as
    well, since the solver runs once more without integrating. Under `neverwhere-2026` the forces
    are what the solver left behind one physics step earlier, read at the new contacts, which is
    how the published evaluation reads them (dm_control's legacy step); a contact that has no force
    from that solve reads 0.

    Use it as a context manager, or call `close`. It is not shared between threads.

    Args:
        robot: which robot.
        scene: where; its `ground` and `solids` collide.
        protocol: see `sim.protocol`.
        actuators: servo figures, the robot's own if None.
        friction: tangential friction coefficient of the whole scene, or None for each solid's own.
        payload: extra mass on the back, kg.
        timestep: of the physics, s.
        substeps: physics steps per control step.

    Attributes:
        model: compiled model. Read it; changing it makes trials incomparable.
        data: state of the simulation, for sensors that need more than the properties here.
        control_period: seconds of one control step.
        steps: control steps since the reset.
        start_yaw: heading that the reset gave, rad.
    """

    def __init__(
        self,
        robot: RobotSpec,
        scene: Scene,
        *,
        protocol: Protocol = "strict",
        actuators: Actuators | None = None,
        friction: float | None = None,
        payload: float = 0.0,
        timestep: float = 0.005,
        substeps: int = 4,
    ) -> None:
        self.robot = robot
        self.scene = scene
        self.protocol: Protocol = protocol
        self.control_period = timestep * substeps
        self.steps = 0
        self.start_yaw = 0.0
        motors = Actuators.of(robot) if actuators is None else actuators
        self._holds_pose = motors.follow == "position"
        health.keep_warnings_out_of_files()
        self.model: MjModel = compile_model(
            robot,
            scene,
            protocol=protocol,
            actuators=motors,
            friction=friction,
            payload=payload,
            timestep=timestep,
        )
        self.data: MjData = mujoco.MjData(self.model)
        self._fingerprint = snapshot.fingerprint(self.model)
        self._closed = False
        self._substeps = substeps
        self._trunk = int(self.model.body("trunk").id)
        self._bodies = {name: int(self.model.body(name).id) for name in robot.bodies}
        published = protocol == "neverwhere-2026"
        self.monitored_geoms = (
            robot.published_monitored_geoms if published else robot.monitored_geoms
        )
        self._contact_forces = ContactForces(
            self.model, (*robot.feet, *self.monitored_geoms), in_contact_frames=published
        )
        count = len(robot.feet)
        self._foot_forces = np.zeros(count)
        self._monitored_forces = np.zeros(len(self.monitored_geoms))
        self._torques = np.zeros(len(robot.joints))
        self._acceleration = np.zeros(6)
        self._contacts = np.zeros(count, dtype=np.bool_)
        self._previous_contacts = np.zeros(count, dtype=np.bool_)
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
            joint_positions: (12,) rad, the default pose if None. Servos hold it; motors that
                follow torques are idle.
        """
        self._require_open()
        pose = self.robot.default_pose if joint_positions is None else joint_positions
        data = self.data
        mujoco.mj_resetData(self.model, data)
        data.qpos[:3] = position
        data.qpos[3:7] = (np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0))
        data.qpos[_JOINTS] = pose
        data.ctrl[:] = pose if self._holds_pose else 0.0
        self.steps = 0
        self.start_yaw = yaw
        mujoco.mj_forward(self.model, data)
        # Nothing has been sensed before the first step.
        self._contacts[:] = False
        self._read_forces()
        health.check(data, self.time)

    def step(self, targets: Sequence[float] | Array) -> None:
        """Run one control step.

        Args:
            targets: (12,) joint positions that the servos steer to, rad; or torques, N m, for
                motors that follow them.

        Raises:
            DivergedError: the physics diverged.
            TrialError: a target is not finite, or the physics failed otherwise.
        """
        self._require_open()
        model, data = self.model, self.data
        data.ctrl[:] = targets
        if not np.isfinite(data.ctrl).all():
            raise TrialError(
                f"joint targets are not finite at {self.time:.3f} s: {data.ctrl.tolist()}",
                fix="check the policy's actions",
            )
        # Positions and velocities are already current here, so the first physics step skips them.
        mujoco.mj_step2(model, data)
        for _ in range(self._substeps - 1):
            mujoco.mj_step(model, data)
        solved: Array | None = None
        if self.protocol == "strict":
            mujoco.mj_forward(model, data)
        else:
            # The published evaluation reads what the last solve left in memory, at the places of
            # the new contacts. Beyond its last row that memory is anything; here it is 0.
            solved = data.efc_force.copy()
            mujoco.mj_step1(model, data)
        self.steps += 1
        self._read_forces(solved)
        health.check(data, self.time)

    def state(self) -> bytes:
        """Return everything that the future depends on, for `restore`."""
        self._require_open()
        return snapshot.pack(self.model, self.data, self._numbers(), self._fingerprint)

    def restore(self, state: bytes) -> None:
        """Go back to a state of a world with the same robot, scene and options, bit for bit.

        Raises:
            TrialError: the state is damaged or belongs to another model.
        """
        self._require_open()
        numbers = self._numbers()
        snapshot.unpack(self.model, self.data, numbers, self._fingerprint, state)
        # Derived quantities follow from the state; the solver's warm start is part of it.
        if self.protocol == "strict":
            mujoco.mj_forward(self.model, self.data)
        else:
            mujoco.mj_step1(self.model, self.data)
        self.steps = int(numbers["steps"][0])
        self._foot_forces = numbers["foot_forces"]
        self._monitored_forces = numbers["monitored_forces"]
        self._torques = numbers["torques"]
        self._acceleration = numbers["acceleration"]
        self.start_yaw = float(numbers["start_yaw"][0])
        self._contacts = numbers["contacts"] > 0.0
        self._previous_contacts = numbers["previous_contacts"] > 0.0

    # What there is to know.

    @property
    def time(self) -> float:
        """Seconds since the reset."""
        return self.steps * self.control_period

    @property
    def trunk_position(self) -> Array:
        """Origin of the trunk in the world, (3,) m."""
        return self.data.xpos[self._trunk].copy()

    @property
    def trunk_quat(self) -> Array:
        """Orientation of the trunk in the world, (4,) w x y z, normalised."""
        return self.data.xquat[self._trunk].copy()

    @property
    def trunk_rotation(self) -> Array:
        """R_world_trunk, (3, 3)."""
        return self.data.xmat[self._trunk].reshape(3, 3).copy()

    @property
    def trunk_linear_velocity(self) -> Array:
        """Velocity of the trunk's origin, world frame, (3,) m / s."""
        return self.data.qvel[:3].copy()

    @property
    def trunk_angular_velocity(self) -> Array:
        """Angular velocity of the trunk, trunk frame, (3,) rad / s."""
        return self.data.qvel[3:6].copy()

    def specific_force(self, at: Sequence[float]) -> Array:
        """Return what an accelerometer on the trunk reads: acceleration minus gravity.

        It is what MuJoCo's accelerometer reads at a site there. Under `neverwhere-2026` the
        acceleration is that of the last physics step, as forces are.

        Args:
            at: (3,) where it sits, trunk frame, m.

        Returns:
            (3,) m / s^2, trunk frame.
        """
        # Plain cross products: `np.cross` takes longer than all the rest.
        px, py, pz = at
        wx, wy, wz = self.data.qvel[3:6].tolist()
        ax, ay, az = self._acceleration[3:].tolist()
        # Speed of the point around the origin, and what its circling adds: w x (w x p) + a x p.
        vx, vy, vz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
        circling = np.array(
            [
                wy * vz - wz * vy + ay * pz - az * py,
                wz * vx - wx * vz + az * px - ax * pz,
                wx * vy - wy * vx + ax * py - ay * px,
            ]
        )
        in_world = self._acceleration[:3] - self.model.opt.gravity
        return self.trunk_rotation.T @ in_world + circling

    @property
    def roll_pitch_yaw(self) -> Array:
        """Euler angles of the trunk, (3,) rad; yaw in (-pi, pi]."""
        w, x, y, z = self.data.xquat[self._trunk]
        return np.array(
            [
                np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
                np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            ]
        )

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass of the whole robot in the world, (3,) m."""
        return self.data.subtree_com[self._trunk].copy()

    @property
    def joint_positions(self) -> Array:
        """(12,) rad."""
        return self.data.qpos[_JOINTS].copy()

    @property
    def joint_velocities(self) -> Array:
        """(12,) rad / s."""
        return self.data.qvel[_JOINT_RATES].copy()

    @property
    def torques(self) -> Array:
        """Servo torques after clipping, without joint damping, (12,) N m."""
        return self._torques.copy()

    @property
    def foot_contacts(self) -> npt.NDArray[np.bool_]:
        """Whether each foot pushes with more than 2 N now, (4,) in the order of `robot.feet`."""
        return self._contacts.copy()

    @property
    def previous_foot_contacts(self) -> npt.NDArray[np.bool_]:
        """The same, one control step ago; all False before the second step."""
        return self._previous_contacts.copy()

    def foot_forces(self) -> Array:
        """Return the contact force on each foot, (4,) N."""
        return self._foot_forces.copy()

    def monitored_force(self) -> float:
        """Return the largest contact force on any monitored geom, N."""
        return float(self._monitored_forces.max(initial=0.0))

    def monitored_forces(self) -> dict[str, float]:
        """Return the contact force on each monitored geom by name, N."""
        return dict(zip(self.monitored_geoms, self._monitored_forces.tolist(), strict=True))

    def camera_pose(self, name: str) -> Array:
        """Return T_world_camera, (4, 4), of a camera of the robot; OpenCV axes.

        Raises:
            UsageError: the robot has no such camera.
        """
        mount = self.robot.cameras.get(name)
        if mount is None:
            raise UsageError(
                f"{self.robot.name} has no camera {name!r}", fix=nearest(name, self.robot.cameras)
            )
        T_world_trunk = np.eye(4)
        T_world_trunk[:3, :3] = self.trunk_rotation
        T_world_trunk[:3, 3] = self.trunk_position
        return T_world_trunk @ mount.T_trunk_camera

    def body_transforms(self) -> dict[str, tuple[Array, Array]]:
        """Return position (3,) and quaternion (4,) in the world of every body of the robot."""
        data = self.data
        return {
            name: (data.xpos[body].copy(), data.xquat[body].copy())
            for name, body in self._bodies.items()
        }

    @property
    def geom_rgba(self) -> npt.NDArray[np.float32]:
        """Colour of every geom, (G, 4), for the geom numbers of `ray_robot`."""
        return self.model.geom_rgba.copy()

    def ray_robot(
        self,
        origins: Array,
        directions: Array,
        *,
        exclude: Literal["nothing", "trunk"] = "nothing",
    ) -> RobotRays:
        """Cast rays at the robot's visual primitives.

        Args:
            origins: (3,) for a common origin, which is fast, or (N, 3); world frame.
            directions: (N, 3) unit vectors, world frame.
            exclude: `trunk` leaves out trunk and head, for cameras that sit inside them.
        """
        self._require_open()
        body = self._trunk if exclude == "trunk" else -1
        return cast_at_visuals(self.model, self.data, origins, directions, exclude_body=body)

    # Inside.

    def _read_forces(self, solved: Array | None = None) -> None:
        forces = self._contact_forces.read(self.data, solved)
        count = len(self.robot.feet)
        self._foot_forces = forces[:count]
        self._monitored_forces = forces[count:]
        self._torques = self.data.actuator_force.copy()
        # Of the free joint: linear in the world's axes, angular in the trunk's.
        self._acceleration = self.data.qacc[:6].copy()
        self._previous_contacts = self._contacts
        self._contacts = self._foot_forces > CONTACT_THRESHOLD

    def _numbers(self) -> dict[str, Array]:
        """Return what a state holds besides MuJoCo's own, as float64 arrays."""
        return {
            "steps": np.array([self.steps], dtype=np.float64),
            "foot_forces": self._foot_forces.copy(),
            "monitored_forces": self._monitored_forces.copy(),
            "torques": self._torques.copy(),
            "acceleration": self._acceleration.copy(),
            "start_yaw": np.array([self.start_yaw]),
            "contacts": self._contacts.astype(np.float64),
            "previous_contacts": self._previous_contacts.astype(np.float64),
        }

    def _require_open(self) -> None:
        if self._closed:
            raise TrialError("this World was closed", fix="make a new one for each trial")
