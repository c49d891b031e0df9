"""Where the robot's body is, how it moves, where its cameras look, and what rays at it meet.

These are the readings: nothing outside `nw_sim.physics` touches MuJoCo's model or data.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nw_base import same_bits
from nw_base.errors import UsageError, nearest
from nw_scenes.robots.spec import STATIC_GROUP, VISUAL_GROUP
from nw_sim.physics.binding import MjData, MjModel, mujoco
from nw_sim.physics.looks import RobotRays, mesh_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_scenes.robots import CameraMount, RobotSpec
    from nw_scenes.robots.spec import ImuMount


Array = npt.NDArray[np.float64]

Places = slice | npt.NDArray[np.intp]
"""Of numbers in an array of MuJoCo's; a slice, which gives a view, where they lie side by side."""


class Body:
    """Reads poses, velocities and joints out of a simulation, as they are at this instant.

    Frames: world z up; the trunk frame x forward, y left, z up; quaternions w x y z; joints in the
    order of `robot.joints`. Every property returns a fresh array.

    Args:
        robot: which robot.
        model: compiled model.
        data: its state.

    Attributes:
        bodies: numbers of `robot.bodies` in the model.
        body_count: how many bodies the model has, the world's among them.
    """

    def __init__(self, robot: RobotSpec, model: MjModel, data: MjData) -> None:
        self.robot = robot
        self._model: MjModel = model
        self._data: MjData = data
        self._trunk = int(model.body(robot.root).id)
        self.bodies = tuple(int(model.body(name).id) for name in robot.bodies)
        self.body_count = int(model.nbody)
        root = model.joint(robot.root_joint)
        joints = [int(model.joint(name).id) for name in robot.joints]
        # Of the free joint: position and quaternion, linear and angular rates.
        start, rates = int(root.qposadr[0]), int(root.dofadr[0])
        self._place, self._turn = slice(start, start + 3), slice(start + 3, start + 7)
        self._rates = slice(rates, rates + 6)
        self._linear, self._angular = slice(rates, rates + 3), slice(rates + 3, rates + 6)
        self._body_places: dict[tuple[str, ...], npt.NDArray[np.intp]] = {}
        self._joints = _places(model.jnt_qposadr[joints])
        self._joint_rates = _places(model.jnt_dofadr[joints])

    @property
    def trunk_position(self) -> Array:
        """Origin of the trunk in the world, (3,) m."""
        return self._data.xpos[self._trunk].copy()

    @property
    def trunk_quat(self) -> Array:
        """Orientation of the trunk in the world, (4,) w x y z, normalised."""
        return self._data.xquat[self._trunk].copy()

    @property
    def trunk_rotation(self) -> Array:
        """R_world_trunk, (3, 3)."""
        return self._data.xmat[self._trunk].reshape(3, 3).copy()

    @property
    def trunk_linear_velocity(self) -> Array:
        """Velocity of the trunk's origin, world frame, (3,) m / s."""
        return self._data.qvel[self._linear].copy()

    @property
    def trunk_angular_velocity(self) -> Array:
        """Angular velocity of the trunk, trunk frame, (3,) rad / s."""
        return self._data.qvel[self._angular].copy()

    @property
    def roll_pitch_yaw(self) -> Array:
        """Euler angles of the trunk, (3,) rad; yaw in (-pi, pi]."""
        w, x, y, z = self._data.xquat[self._trunk]
        return np.array(
            [
                same_bits.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                same_bits.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
                same_bits.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            ]
        )

    @property
    def uprightness(self) -> float:
        """Cosine of the angle between the trunk's z axis and the world's."""
        return float(self._data.xmat[self._trunk, 8])

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass of the whole robot in the world, (3,) m."""
        return self._data.subtree_com[self._trunk].copy()

    @property
    def joint_positions(self) -> Array:
        """(J,) rad."""
        return self._data.qpos[self._joints].copy()

    @property
    def joint_velocities(self) -> Array:
        """(J,) rad / s."""
        return self._data.qvel[self._joint_rates].copy()

    @property
    def geom_rgba(self) -> npt.NDArray[np.float32]:
        """Colour of every geom, (G, 4), for the geom numbers of `World.ray_robot`."""
        return self._model.geom_rgba.copy()

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
        body = self._carrier(mount)
        T_world_body = np.eye(4)
        T_world_body[:3, :3] = self._data.xmat[body].reshape(3, 3)
        T_world_body[:3, 3] = self._data.xpos[body]
        return T_world_body @ mount.T_trunk_camera

    def camera_velocity(self, name: str) -> tuple[Array, Array]:
        """Return how a camera of the robot moves: (3,) m / s and (3,) rad / s, world frame.

        Raises:
            UsageError: the robot has no such camera.
        """
        place = self.camera_pose(name)[:3, 3]
        body = self._carrier(self.robot.cameras[name])
        velocity = np.empty(6)  # Angular, then of the body's origin.
        mujoco.mj_objectVelocity(
            self._model, self._data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0
        )
        x, y, z = velocity[:3]
        turning = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return velocity[3:] + turning @ (place - self._data.xpos[body]), velocity[:3]

    def _carrier(self, mount: CameraMount | ImuMount) -> int:
        return int(self._model.body(mount.body).id) if mount.body else self._trunk

    @property
    def imu_rotation(self) -> Array:
        """R_world_imu, (3, 3); of a robot without an IMU R_world_trunk."""
        imu = self.robot.imu
        if imu is None:
            return self.trunk_rotation
        return self._data.xmat[self._carrier(imu)].reshape(3, 3) @ np.array(imu.R_body_imu)

    @property
    def imu_angular_velocity(self) -> Array:
        """Angular velocity along the axes of the IMU, or of the trunk without one, (3,) rad / s."""
        imu = self.robot.imu
        if imu is None:
            return self.trunk_angular_velocity
        rates = self.trunk_angular_velocity
        if imu.body:
            velocity = np.empty(6)
            kind = mujoco.mjtObj.mjOBJ_XBODY
            mujoco.mj_objectVelocity(self._model, self._data, kind, self._carrier(imu), velocity, 1)
            rates = velocity[:3]
        return same_bits.product(rates, np.array(imu.R_body_imu))

    def body_poses(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """Return where bodies of the robot are in the world.

        Args:
            names: of `robot.bodies`.

        Returns:
            Positions of their origins, (B, 3) m, and quaternions w x y z, (B, 4).
        """
        places = self._body_places.get(names)
        if places is None:
            places = np.array([int(self._model.body(name).id) for name in names], dtype=np.intp)
            self._body_places[names] = places
        return self._data.xpos.take(places, axis=0), self._data.xquat.take(places, axis=0)

    def kinematics(
        self, root: Array, joint_positions: Array, names: tuple[str, ...]
    ) -> tuple[Array, Array]:
        """Return where bodies would be in T poses of the robot; its state stays as it is.

        Args:
            root: (T, 7) position, m, and quaternion of the robot's root in the world.
            joint_positions: (T, J) rad.
            names: of `robot.bodies`.

        Returns:
            Positions (T, B, 3) m and quaternions (T, B, 4).
        """
        data = mujoco.MjData(self._model)
        places = [int(self._model.body(name).id) for name in names]
        positions = np.empty((len(root), len(names), 3))
        quats = np.empty((len(root), len(names), 4))
        for number, (pose, angles) in enumerate(zip(root, joint_positions, strict=True)):
            data.qpos[self._place], data.qpos[self._turn] = pose[:3], pose[3:]
            data.qpos[self._joints] = angles
            mujoco.mj_kinematics(self._model, data)
            positions[number], quats[number] = data.xpos[places], data.xquat[places]
        return positions, quats

    def hangs_on(self) -> dict[str, str]:
        """Return, by the name of each body of the robot but the root, the body it hangs on."""
        parents = self._model.body_parentid
        names = dict(zip(self.bodies, self.robot.bodies, strict=True))
        return {
            name: names[int(parents[number])]
            for number, name in names.items()
            if name != self.robot.root
        }

    def moving(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return what moves, now: views of the simulation's memory where that is possible.

        Returns:
            Positions (N, 3) and quaternions (N, 4) in the world of all bodies of the model, joint
            positions, joint velocities (J,) each, and of the trunk linear velocity (world frame),
            then angular velocity (trunk frame), (6,).
        """
        data = self._data
        joints = data.qpos[self._joints], data.qvel[self._joint_rates]
        return data.xpos, data.xquat, *joints, data.qvel[self._rates]

    def coordinates(self) -> tuple[Array, Array]:
        """Return all generalised positions and velocities, for digests.

        Returns:
            Views of the simulation's memory, in the order of the model: of the trunk 7 and 6
            numbers, of each joint one, also of joints that nothing drives.
        """
        return self._data.qpos, self._data.qvel

    def foot_places(self) -> tuple[Array, Array]:
        """Return where the feet are, (F, 3) m in the world, and half their widths along y, (F,) m.

        Of a foot that is a body, the box round its collision geometry counts.
        """
        count = len(self.robot.feet)
        places, widths = np.empty((count, 3)), np.empty(count)
        for row, geoms in enumerate(geoms_of(self._model, self.robot, self.robot.feet)):
            boxes = [_box_round(self._model, self._data, geom) for geom in geoms]
            if len(boxes) == 1:
                place, reach = boxes[0]
            else:
                low = np.min([middle - half for middle, half in boxes], axis=0)
                high = np.max([middle + half for middle, half in boxes], axis=0)
                place, reach = (low + high) / 2, (high - low) / 2
            places[row], widths[row] = place, reach[1]
        return places, widths

    def reaches(self) -> Array:
        """Return how far from its hip each foot gets at most, to its sole, (F,) m.

        The hip is the first joint of its leg; joints turn within their ranges. The state is lost.
        """
        model, data, reaches = self._model, self._data, np.zeros(len(self.robot.feet))
        for row, geoms in enumerate(geoms_of(model, self.robot, self.robot.feet)):
            number = int(model.geom_bodyid[geoms[0]])
            chain: list[int] = []
            while number != self._trunk:
                first, count = int(model.body_jntadr[number]), int(model.body_jntnum[number])
                chain = [*range(first, first + count), *chain]
                number = int(model.body_parentid[number])
            if not chain:
                continue

            def away(geoms: Sequence[int] = geoms, hip: int = chain[0]) -> float:
                mujoco.mj_kinematics(model, data)
                hub = data.xanchor[hip]
                places = [_box_round(model, data, geom)[0] for geom in geoms]
                soles = model.geom_aabb[geoms, 3:].min(axis=1)
                return max(
                    float(np.linalg.norm(at - hub)) + float(sole)
                    for at, sole in zip(places, soles, strict=True)
                )

            best = away()
            for joint in (*chain, *chain):  # Twice: one joint moves what another one can do.
                place = int(model.jnt_qposadr[joint])
                low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.pi, np.pi)
                kept = float(data.qpos[place])
                for angle in np.linspace(low, high, 25).tolist():
                    data.qpos[place] = angle
                    if (far := away()) > best + 1e-9:
                        best, kept = far, angle
                data.qpos[place] = kept
            reaches[row] = best
        return reaches

    def trunk_length(self) -> float:
        """Return how long the trunk's shapes are along the world's x, in m, legs left out."""
        own = np.flatnonzero(self._model.geom_bodyid == self._trunk)
        R = self._data.geom_xmat[own].reshape(-1, 3, 3)
        centre, half = self._model.geom_aabb[own, :3], self._model.geom_aabb[own, 3:]
        middle = self._data.geom_xpos[own, 0] + (R[:, 0] * centre).sum(axis=1)
        reach = (np.abs(R[:, 0]) * half).sum(axis=1)
        ends = [*(middle + reach).tolist(), *(middle - reach).tolist()]
        if self.robot.pictured == "visuals":  # Physics has no geom of what is only seen.
            ahead, x = self.trunk_rotation[0], float(self._data.xpos[self._trunk, 0])
            for shape in self.robot.visuals:
                if shape.body == self.robot.root:
                    along = mesh_of(shape)[0] @ ahead + x
                    ends += [float(along.min()), float(along.max())]
        return max(ends) - min(ends)

    def height_over_ground(self) -> float:
        """Return how far the trunk's origin is above what collides under it, m; inf = nothing."""
        groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        groups[STATIC_GROUP] = 1
        origin = self._data.xpos[self._trunk]
        met = np.zeros(1, dtype=np.int32)
        down = np.array([0.0, 0.0, -1.0])
        distance = mujoco.mj_ray(self._model, self._data, origin, down, groups, 1, -1, met, None)
        return float(distance) if met[0] >= 0 else np.inf

    def mounted(self, camera: str) -> Array:
        """Return where a camera of the robot is on its body, (7,): m, quaternion w x y z."""
        mount = self.robot.cameras[camera]
        pose = np.empty(7)
        pose[:3] = mount.position
        mujoco.mju_mat2Quat(pose[3:], np.array(mount.R_trunk_camera, np.float64).ravel())
        return pose


def _places(addresses: npt.NDArray[np.int32]) -> Places:
    """Return addresses as a slice, if they follow each other."""
    first, count = int(addresses[0]), len(addresses)
    if (addresses == np.arange(first, first + count)).all():
        return slice(first, first + count)
    return addresses.astype(np.intp)


def geoms_of(model: MjModel, robot: RobotSpec, names: Sequence[str]) -> list[list[int]]:
    """Return the numbers of the geoms that parts of a robot are made of.

    Args:
        model: compiled model.
        robot: says by `touches` what a name means.
        names: of geoms; or of bodies, whose geoms that collide count.
    """
    if robot.touches == "geom":
        return [[int(model.geom(name).id)] for name in names]
    collides = (model.geom_contype | model.geom_conaffinity) & 1 != 0
    return [
        np.flatnonzero(collides & (model.geom_bodyid == model.body(name).id)).tolist()
        for name in names
    ]


def _box_round(model: MjModel, data: MjData, geom: int) -> tuple[Array, Array]:
    """Return middle and half sizes of the box round a geom, (3,) each, world, m."""
    half = model.geom_aabb[geom, 3:]
    R = data.geom_xmat[geom].reshape(3, 3)
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        return data.geom_xpos[geom].copy(), half.copy()
    return data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3], np.abs(R) @ half


_NO_CUTOFF = 1e10


def cast_at_visuals(
    model: MjModel,
    data: MjData,
    origins: npt.NDArray[np.float64],
    directions: npt.NDArray[np.float64],
    *,
    exclude_body: int = -1,
) -> RobotRays:
    """Cast rays at the visual primitives of the robot.

    Args:
        model: compiled model.
        data: its state, with current geom poses.
        origins: (3,) for a common origin, which is fast, or (N, 3).
        directions: (N, 3) unit vectors, world frame.
        exclude_body: body whose geoms are transparent, or -1.
    """
    count = len(directions)
    distance = np.full(count, -1.0)
    geom = np.full(count, -1, dtype=np.int32)
    normal = np.zeros((count, 3))
    groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
    groups[VISUAL_GROUP] = 1
    rays = np.ascontiguousarray(directions, dtype=np.float64)
    starts = np.asarray(origins, dtype=np.float64)
    # One fan for a common origin, else a fan of one for each ray.
    fans = [slice(0, count)] if starts.ndim == 1 else [slice(i, i + 1) for i in range(count)]
    for fan in fans:
        _cast_fan(
            model,
            data,
            starts if starts.ndim == 1 else starts[fan.start],
            rays[fan],
            groups,
            exclude_body,
            (geom[fan], distance[fan], normal[fan]),
        )
    missed = geom < 0
    distance[missed] = np.inf
    normal[missed] = 0.0
    return RobotRays(distance, geom, normal)


def _cast_fan(
    model: MjModel,
    data: MjData,
    origin: npt.NDArray[np.float64],
    directions: npt.NDArray[np.float64],
    groups: npt.NDArray[np.uint8],
    exclude_body: int,
    out: tuple[npt.NDArray[np.int32], npt.NDArray[np.float64], npt.NDArray[np.float64]],
) -> None:
    if not len(directions):
        return
    geom, distance, normal = out
    mujoco.mj_multiRay(
        m=model,
        d=data,
        pnt=origin,
        vec=directions.reshape(-1),
        geomgroup=groups,
        flg_static=False,
        bodyexclude=exclude_body,
        geomid=geom,
        dist=distance,
        normal=normal.reshape(-1),
        nray=len(directions),
        cutoff=_NO_CUTOFF,
    )
