"""How a robot stands: put down on level ground, and a pose that it may stand in.

Both ask MuJoCo, and need no scene. What stands here may still fall on other ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco as _mujoco
import numpy as np
import numpy.typing as npt

from nw_scenes.robots.spec import RobotSpec

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

Array = npt.NDArray[np.float64]

CLEARANCE = 0.01
"""Between the lowest point of a robot and the ground at the start, m."""
_GRAVITY = 9.806
_TIMESTEP, _STEPS, _MEASURED = 0.005, 400, 100  # s, and physics steps of a drop
_CARRIES = 0.02  # of the weight; a body that carries more of it stands on the ground
_UPRIGHT = 0.9  # cosine of the root's tilt
_SUNK = 0.5  # of the height at which it was put down

_SAMPLES = 57  # angles of a joint that are tried
_WIDEST = 2.8  # rad; no leg bends farther in a stance
_BENT, _STRAIGHT = 0.75, 0.98  # of a leg's length, in the stance of four legs and of two
_SOLE = 0.02  # m above the lowest point of a foot, within which a geom is of its sole
_STEEP = 0.2  # cosine between a capsule and the vertical; one that lies touches along its length
_SIDEWAYS = 0.9  # cosine between a joint's axis and the root's y, above which it is one of pitch


@dataclass(frozen=True, kw_only=True)
class Drop:
    """What became of a robot, 2 s after it was put down in a pose with its gains."""

    forces: dict[str, float]
    """N upwards, from the ground on each body that touches it, on average over the last 0.5 s."""
    carriers: tuple[str, ...]
    """The bodies with more than 2 % of its weight of that."""
    torques: tuple[float, ...]
    """(J,) N m, size of the motors' torques, on average over the last 0.5 s."""
    positions: tuple[float, ...]
    """(J,) rad, at the end."""
    self_contacts: tuple[tuple[str, str], ...]
    """Pairs of its bodies that pushed each other in the last 0.5 s."""
    upright: float
    """Cosine of the root's tilt at the end; -1 if the physics diverged."""
    spawn_height: float
    """Of the root's origin above the ground where it was put down, m."""
    height: float
    """The same at the end, m."""
    fell_after: float | None
    """Seconds until its own limits of tilt and height said that it fell; None = it did not."""
    stands: bool
    """Whether it is upright, not lower than half of where it was put down, and not on its root."""


class LevelGround:
    """Level ground on which a robot is put down, as often as one likes.

    Args:
        robot: with the gains that hold its pose.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        spec = mujoco.MjSpec.from_string(robot.mjcf)
        spec.option.timestep = _TIMESTEP
        spec.option.gravity = [0.0, 0.0, -_GRAVITY]
        for name, kp, kd, torque, armature, friction in zip(
            robot.joints, *_motors(robot), strict=True
        ):
            joint, servo = spec.joint(name), spec.actuator(name)
            joint.damping[0], joint.armature, joint.frictionloss = kd, armature, friction
            servo.gainprm[0], servo.biasprm[1], servo.forcerange = kp, -kp, [-torque, torque]
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        self._model: Any = spec.compile()
        self._data: Any = mujoco.MjData(self._model)
        joints = [int(self._model.joint(name).id) for name in robot.joints]
        self._places = self._model.jnt_qposadr[joints]
        self._root = int(self._model.body(robot.root).id)

    def under(self, robot: RobotSpec) -> LevelGround:
        """Return the ground under another robot: this model, if that has the same motors."""
        own = self._robot
        if robot.mjcf != own.mjcf or _motors(robot) != _motors(own):
            return LevelGround(robot)
        other = copy(self)
        other._robot = robot  # noqa: SLF001 - of its own class.
        return other

    @property
    def mass(self) -> float:
        """Of the robot, kg."""
        return float(self._model.body_mass.sum())

    def bodies_of(self, parts: Sequence[str]) -> tuple[str, ...]:
        """Return the bodies of parts, which are bodies or geoms as the robot's `touches` says."""
        if self._robot.touches == "body":
            return tuple(parts)
        numbers = (int(self._model.geom(part).bodyid[0]) for part in parts)
        return tuple(str(self._model.body(number).name) for number in numbers)

    def drop(self, pose: Sequence[float] | None = None, *, held: bool = False) -> Drop:
        """Put the robot down for 2 s.

        Args:
            pose: angle of each joint, rad, from a centimetre above the ground; None = its own, from
                its own height.
            held: whether its root is kept upright and in its place, but for its height, as by a
                gantry: what only a policy can balance stands on its legs then.
        """
        model, data = self._model, self._data
        mujoco.mj_resetData(model, data)
        data.qpos[:7] = (0.0, 0.0, self._robot.spawn_height, 1.0, 0.0, 0.0, 0.0)
        data.qpos[self._places] = self._robot.default_pose if pose is None else pose
        data.ctrl[:] = data.qpos[self._places]
        if pose is not None:
            mujoco.mj_forward(model, data)
            own = [g for g in range(model.ngeom) if model.geom_bodyid[g] and collides(model, g)]
            data.qpos[2] += CLEARANCE - min(lowest(model, data, geom) for geom in own)
        start = float(data.qpos[2])
        measure = _Measure(model)
        fell_after: float | None = None
        for step in range(_STEPS):
            mujoco.mj_step(model, data)
            if held:
                data.qpos[[0, 1, 3, 4, 5, 6]] = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
                data.qvel[[0, 1, 3, 4, 5]] = 0.0
            if fell_after is None and self._fell():
                fell_after = (step + 1) * _TIMESTEP
            if step >= _STEPS - _MEASURED:
                measure.take(data)
        weight = float(model.body_mass.sum()) * _GRAVITY
        forces = measure.pushes / _MEASURED
        carriers = np.flatnonzero(forces > _CARRIES * weight).tolist()
        is_sound = bool(np.isfinite(data.qpos).all()) and not data.warning.number.any()
        upright = float(data.xmat[self._root, 8]) if is_sound else -1.0
        height = float(data.xpos[self._root, 2])
        name = [str(model.body(number).name) for number in range(model.nbody)]
        return Drop(
            forces={name[n]: float(forces[n]) for n in np.flatnonzero(forces > 0.0).tolist()},
            carriers=tuple(name[number] for number in carriers),
            torques=tuple((measure.torques / _MEASURED).tolist()),
            positions=tuple(data.qpos[self._places].tolist()),
            self_contacts=tuple((name[one], name[other]) for one, other in sorted(measure.own)),
            upright=upright,
            spawn_height=start,
            height=height,
            fell_after=fell_after,
            stands=(
                upright > _UPRIGHT
                and height > _SUNK * start
                and self._root not in carriers
                and bool(carriers)
            ),
        )

    def _fell(self) -> bool:
        robot, data = self._robot, self._data
        w, x, y, z = data.xquat[self._root].tolist()
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
        is_low = robot.fell_height is not None and data.xpos[self._root, 2] < robot.fell_height
        return max(abs(roll), abs(pitch)) > robot.fell_tilt or bool(is_low)


def _motors(robot: RobotSpec) -> tuple[tuple[float, ...], ...]:
    gains = (robot.kp, robot.joint_damping, robot.torque_limits)
    return *gains, robot.armature, robot.friction_loss


class _Measure:
    """Adds up what steps of the physics show."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self.pushes = np.zeros(model.nbody)
        self.torques = np.zeros(model.nu)
        self.own: set[tuple[int, int]] = set()

    def take(self, data: Any) -> None:
        """Add the step that was just made."""
        push = np.empty(6)
        self.torques += np.abs(data.actuator_force)
        for number, pair in enumerate(self._model.geom_bodyid[data.contact.geom].tolist()):
            mujoco.mj_contactForce(self._model, data, number, push)
            if 0 in pair:
                self.pushes[max(pair)] += push[0]
            elif push[0] > 0.0:
                self.own.add((min(pair), max(pair)))


def collides(model: Any, geom: int) -> bool:
    """Return whether a geom collides with the ground."""
    return bool(model.geom_contype[geom] & 1 or model.geom_conaffinity[geom] & 1)


def lowest(model: Any, data: Any, geom: int) -> float:
    """Return the height of a geom's lowest point in the world, m."""
    kind = model.geom_type[geom]
    down = data.geom_xmat[geom].reshape(3, 3)[2]
    size = model.geom_size[geom]
    centre = float(data.geom_xpos[geom, 2])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        return centre + float((model.mesh_vert[first : first + count] @ down).min())
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return centre - float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return centre - float(size[0] + abs(down[2]) * size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        flat = math.hypot(float(down[0]), float(down[1]))
        return centre - float(flat * size[0] + abs(down[2]) * size[1])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return centre - float(np.linalg.norm(down * size))
    return centre - float(np.abs(down) @ size)


def standing_pose(robot: RobotSpec) -> dict[str, float] | None:
    """Return a guess at a pose that a robot may stand in; its other joints stay at its own pose.

    Each leg is bent at its first two joints of pitch until its foot is under its hip, and a third
    one keeps the foot level.

    Args:
        robot: whose feet are the ends of its legs.

    Returns:
        Angles in rad by names of joints; None where no leg has two joints of pitch.
    """
    model = mujoco.MjModel.from_xml_string(robot.mjcf)
    data = mujoco.MjData(model)
    follows = robot.follows or ("position",) * len(robot.joints)
    ranges = {
        name: limits
        for name, limits, follow in zip(robot.joints, robot.joint_ranges, follows, strict=True)
        if follow == "position"
    }
    # Bent legs turn the axes of joints below: they are looked at where all are straight.
    for name, (low, high) in ranges.items():
        data.qpos[model.joint(name).qposadr[0]] = min(max(0.0, low), high)
    data.qpos[3:7] = (1.0, 0.0, 0.0, 0.0)
    share = _STRAIGHT if len(robot.feet) < 3 else _BENT
    pose: dict[str, float] = {}
    feet = robot.feet
    if robot.touches == "geom":
        feet = [str(model.body(int(model.geom(foot).bodyid[0])).name) for foot in feet]
    for foot in feet:
        mujoco.mj_forward(model, data)
        pitch = _pitch_joints(model, data, foot, ranges)
        if len(pitch) > 1:
            pose |= _bent(model, data, foot, pitch, ranges, share)
    return pose or None


def _pitch_joints(
    model: Any, data: Any, foot: str, ranges: dict[str, tuple[float, float]]
) -> dict[str, float]:
    """Return the joints of pitch above a foot from the root on, and which way each turns."""
    joints: dict[str, float] = {}
    body = int(model.body(foot).id)
    while body > 0:
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            name, turn = str(model.joint(joint).name), float(data.xaxis[joint, 1])
            if name in ranges and abs(turn) > _SIDEWAYS:
                joints = {name: float(np.sign(turn)), **joints}
        body = int(model.body_parentid[body])
    return joints


def _bent(
    model: Any,
    data: Any,
    foot: str,
    pitch: dict[str, float],
    ranges: dict[str, tuple[float, float]],
    share: float,
) -> dict[str, float]:
    """Return the angles of a leg whose foot is under its hip, at a share of the leg's length."""
    hip, knee, *others = pitch
    top, body, sole = int(model.joint(hip).id), int(model.body(foot).id), _sole(model, data, foot)
    # Two feet carry a robot whose weight is over them.
    root = model.body_rootid[body]
    over = float(data.subtree_com[root, 0] - data.xanchor[top, 0]) if share == _STRAIGHT else 0.0
    places = [int(model.joint(name).qposadr[0]) for name in (hip, knee)]
    straight = data.qpos[places].copy()
    tries: list[tuple[float, float, float, float]] = []
    for angles in product(*(_angles(ranges[name]) for name in (hip, knee))):
        data.qpos[places] = angles
        mujoco.mj_kinematics(model, data)
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ sole
        ahead, _, up = (tip - data.xanchor[top]).tolist()
        tries.append((*angles, ahead - over, -up))
    data.qpos[places] = straight
    table = np.array(tries)
    reach = float(table[:, 3].max())
    off = (table[:, 2] / reach) ** 2 + (table[:, 3] / reach - share) ** 2
    # Small angles are better than large ones. Of two ways to bend, the thigh of an animal goes
    # backwards, that of a biped forwards.
    backwards = table[:, 0] * pitch[hip]
    wrong = np.maximum(backwards, 0.0) if share == _STRAIGHT else np.maximum(-backwards, 0.0)
    weight = 5e-2 if share == _STRAIGHT else 1e-3
    cost = off + 1e-3 * (table[:, :2] ** 2).sum(axis=1) + weight * wrong
    best = int(cost.argmin())
    pose = {hip: float(table[best, 0]), knee: float(table[best, 1])}
    if others:
        ankle = others[0]
        turned = sum(pitch[name] * angle for name, angle in pose.items())
        low, high = ranges[ankle]
        pose[ankle] = min(max(-turned * pitch[ankle], low), high)
    return {name: round(angle, 2) + 0.0 for name, angle in pose.items()}


def _angles(limits: tuple[float, float]) -> Array:
    low, high = max(limits[0], -_WIDEST), min(limits[1], _WIDEST)
    return np.linspace(low, high, _SAMPLES) if low < high else np.array([limits[0]])


def _sole(model: Any, data: Any, foot: str) -> Array:
    """Return the middle of what is lowest of a foot, (3,) m in the frame of its body."""
    body = int(model.body(foot).id)
    own = [g for g in np.flatnonzero(model.geom_bodyid == body).tolist() if collides(model, g)]
    low = [lowest(model, data, geom) for geom in own]
    under = [geom for geom, z in zip(own, low, strict=True) if z < min(low) + _SOLE]
    middle = np.mean([_low_end(model, data, geom) for geom in under], axis=0)
    return data.xmat[body].reshape(3, 3).T @ (middle - data.xpos[body])


def _low_end(model: Any, data: Any, geom: int) -> Array:
    """Return the middle of a geom in the world, (3,) m; of a capsule that stands, its lower end."""
    axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    is_long = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE and abs(axis[2]) > _STEEP
    half = float(model.geom_size[geom, 1]) if is_long else 0.0
    return data.geom_xpos[geom] - np.sign(axis[2]) * half * axis
