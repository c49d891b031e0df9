"""What follows from a robot's model file and its `robot.yaml`: the specification.

MuJoCo compiles the model once to say what is in it: bodies, joints, masses, limits. `own_mjcf` then
writes it out anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product
from typing import Any, Literal

import mujoco as _mujoco
import numpy as np
import numpy.typing as npt

from nw_base.errors import RobotError, nearest
from nw_scenes.robots.compiled import CompiledRobot, Mounts, Shared
from nw_scenes.robots.folder import RobotFolder
from nw_scenes.robots.looks import visuals_of
from nw_scenes.robots.own_mjcf import rewritten, round_wheels, text_as_written
from nw_scenes.robots.spec import Follow, RobotSpec
from nw_scenes.robots.standing import CLEARANCE, LevelGround, collides, lowest

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

_GRAVITY = 9.806
_FOOT_REACH = 0.02  # m above the lowest collision point, within which a body stands on the ground
_UNLIMITED = 1e6  # rad
_ENDLESS, _LEVEL = 4.0 * math.pi, 0.2  # rad that a wheel turns at least; cosine of its axle
_ROUND, _SIDES = 0.9, 16  # least over largest radius of what is round, in so many directions
# One and the same, for hinges.
_ON_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))


def spec_of(folder: RobotFolder, shared: Shared | None = None) -> RobotSpec:
    """Return the robot of a folder.

    Args:
        folder: of the robot.
        shared: with other robots of its model file, which then need not be compiled again.

    Raises:
        RobotError: MuJoCo cannot compile the model, it is no robot that can be driven, or
            robot.yaml names what it does not have.
    """
    return _Derivation(folder, shared).spec()


@dataclass(frozen=True, kw_only=True)
class _Motor:
    """What a joint is driven by, as far as it is known."""

    follows: Literal["position", "velocity"] = "position"
    kp: float | None = None
    kd: float | None = None
    torque: float | None = None
    armature: float = 0.0
    friction: float = 0.0
    damping: float = 0.0  # of its own, which acts whatever it is told

    def beside(self, other: _Motor) -> _Motor:
        """Return what both do together on one joint."""
        kps = [motor.kp for motor in (self, other) if motor.kp is not None]
        kds = [motor.kd for motor in (self, other) if motor.kd is not None]
        torques = (self.torque, other.torque)
        return _Motor(
            follows="velocity" if kds and not kps else "position",
            kp=sum(kps) if kps else None,
            kd=sum(kds) if kds else None,
            torque=None if None in torques else sum(t for t in torques if t is not None),
            armature=self.armature + other.armature,
            damping=self.damping + other.damping,
        )


@dataclass(frozen=True, kw_only=True)
class ModelFacts:
    """What a model file says of its motors, each in the order of `joints`."""

    joints: tuple[str, ...]
    """Those with motors, or all hinges where the file has no motors."""
    has_motors: bool
    followers: dict[str, str]
    """Joints that an equality (URDF: <mimic>) moves, and which other joint each follows."""
    kp: tuple[float | None, ...]
    """Of servos, N m / rad."""
    kd: tuple[float, ...]
    """N m s / rad."""
    torque: tuple[float | None, ...]
    """N m."""
    armature: tuple[float, ...]
    friction: tuple[float, ...]
    is_limited: tuple[bool, ...]
    """Whether they have ranges."""
    is_wheel: tuple[bool, ...]
    """Whether they turn without end, what turns is round, and it is among what is lowest."""
    keyframes: dict[str, tuple[float, ...]]
    """Angles by name, rad, of those that fit."""
    bodies: int
    mass: float
    """kg."""
    camera: str | None
    """The one that is its eye."""


def facts_of(folder: RobotFolder, shared: Shared | None = None) -> ModelFacts:
    """Return what a model file says of its motors; `motors` of robot.yaml must name no values.

    Args:
        folder: of the robot.
        shared: as for `spec_of`.

    Raises:
        RobotError: as `spec_of`, but for gains that nothing says.
    """
    return _Derivation(folder, shared).facts()


class _Derivation(CompiledRobot):
    """Derives what follows from a compiled model and robot.yaml."""

    def __init__(self, folder: RobotFolder, shared: Shared | None) -> None:
        super().__init__(folder, shared)
        self.written = self._written()
        self.followers = self._followers()
        self.joints = self._joints()

    def spec(self) -> RobotSpec:
        """Return the specification."""
        names = self.joint_names(self.joints)
        motors = self._motors(names)
        self._require_gains(names, motors)
        ranges = [self._range(joint) for joint in self.joints]
        pose = self._pose(names, ranges)
        self._stand(pose)
        lows = self._lows()
        weight = float(self.model.body_mass.sum()) * _GRAVITY
        collided, published = self.settings.collided, self.settings.published
        watched = tuple(self._parts(("body",), self._watched()))
        height, free = self.settings.spawn_height, published.free_joint
        mounts = Mounts(self)
        visuals, pictured = self.shared.get("visuals", lambda: visuals_of(self))
        follows: tuple[Follow, ...] = tuple(motor.follows for motor in motors)

        def text() -> str:
            wheels = zip(self.joints, follows, strict=True)
            round_wheels(self, [joint for joint, follow in wheels if follow != "position"])
            if self.settings.model.as_written:
                return text_as_written(self, names)
            return rewritten(self, names, is_seen_apart=pictured == "visuals")

        mjcf = self.shared.get((*names, *follows), text)
        spec = RobotSpec(
            name=self.settings.name,
            joints=tuple(names),
            default_pose=tuple(pose),
            joint_ranges=tuple(ranges),
            kp=tuple(0.0 if motor.kp is None else motor.kp for motor in motors),
            joint_damping=tuple(0.0 if motor.kd is None else motor.kd for motor in motors),
            torque_limits=tuple(0.0 if m.torque is None else m.torque for m in motors),
            armature=tuple(motor.armature for motor in motors),
            friction_loss=tuple(motor.friction for motor in motors),
            follows=follows if "velocity" in follows else (),
            root_joint=self.root_joint,
            touches=self.settings.touches,
            feet=self._feet(lows),
            monitored=watched,
            published_monitored=watched
            if published.body is None
            else tuple(self._parts(("published", "body"), published.body)),
            fell_tilt=self.settings.fell.tilt,
            fell_height=self.settings.fell.height,
            collided_force=collided.newtons or collided.force * weight,
            cameras=mounts.cameras(),
            imu=mounts.imu(),
            height_camera_offset=published.height_camera,
            root_defaults=(free.damping, free.armature, free.friction),
            bodies=(self.root, *(body for body in self.bodies if body != self.root)),
            visuals=visuals,
            pictured=pictured,
            spawn_height=-min(lows.values()) + CLEARANCE if height is None else height,
            mjcf=mjcf,
        )
        return spec if self.settings.feet else replace(spec, feet=self._standing(spec, lows))

    def facts(self) -> ModelFacts:
        """Return what the file says."""
        names = self.joint_names(self.joints)
        motors = self._motors(names)
        self._stand(self._pose(names, [self._range(joint) for joint in self.joints]))
        eye, lows = Mounts(self).first_camera(), self._lows()
        return ModelFacts(
            joints=tuple(names),
            has_motors=bool(self.written),
            followers=self.followers,
            kp=tuple(motor.kp for motor in motors),
            kd=tuple(0.0 if motor.kd is None else motor.kd for motor in motors),
            torque=tuple(motor.torque for motor in motors),
            armature=tuple(motor.armature for motor in motors),
            friction=tuple(motor.friction for motor in motors),
            is_limited=tuple(bool(self.model.jnt_limited[joint]) for joint in self.joints),
            is_wheel=tuple(self._is_wheel(joint, lows) for joint in self.joints),
            keyframes={name: tuple(pose) for name, pose in self._keyframes()},
            bodies=len(self.bodies),
            mass=float(self.model.body_mass.sum()),
            camera=None if eye is None else eye[0],
        )

    def _is_wheel(self, joint: int, lows: dict[str, float]) -> bool:
        """Return whether a joint turns a wheel; where the robot stands in its pose."""
        model, (low, high) = self.model, self._range(joint)
        body = int(model.jnt_bodyid[joint])
        level = abs(float(self.data.xaxis[joint, 2])) < _LEVEL
        own = [g for g in np.flatnonzero(model.geom_bodyid == body) if collides(model, int(g))]
        if not (high - low > _ENDLESS and level and own):
            return False
        axis, radius = model.jnt_axis[joint], 0.0
        for geom in map(int, own):
            points = _outline(model, geom) - model.jnt_pos[joint]
            points = points - np.outer(points @ axis, axis)

            first = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
            first /= np.linalg.norm(first)
            turns = np.arange(_SIDES) * (2.0 * math.pi / _SIDES)
            ways = np.outer(np.cos(turns), first) + np.outer(np.sin(turns), np.cross(axis, first))
            reach = (points @ ways.T).max(axis=0)
            if reach.min() < _ROUND * reach.max():
                return False
            radius = max(radius, float(reach.max()))
        return lows[self.body_name(body)] < min(lows.values()) + radius

    def _joints(self) -> list[int]:
        """Return the numbers of the joints that are driven, in the order of the tree."""
        model = self.model
        hinges: list[int] = []
        for joint in range(model.njnt):
            kind = model.jnt_type[joint]
            if kind == mujoco.mjtJoint.mjJNT_HINGE:
                hinges.append(joint)
            elif kind != mujoco.mjtJoint.mjJNT_FREE:
                name = model.joint(joint).name
                raise self.folder.fault(
                    f"joint {name!r} is not a hinge; only hinges are driven",
                    "weld it: remove the joint",
                    self.folder.line_of(name, "joint"),
                )
        driven = [joint for joint in hinges if self.joint_names([joint])[0] in self.written]
        patterns = [p for group in self.settings.motors for p in _patterns(group.joints)]
        if not driven:  # The file has no motors; those of robot.yaml are all there are.
            driven = [
                joint
                for joint in hinges
                for name in self.joint_names([joint])
                if any(
                    pattern == name or (fnmatchcase(name, pattern) and name not in self.followers)
                    for pattern in patterns
                )
            ]
        if not driven:
            raise self.fault(
                ("motors",),
                f"motors: {self.settings.model.file} has no motors, and nothing here names a joint",
                'add `- {joints: "*", kp: ..., kd: ..., torque: ...}`',
            )
        return driven

    def _followers(self) -> dict[str, str]:
        """Return the joints that an equality moves with another joint, and which each follows."""
        model, joint = self.model, int(mujoco.mjtEq.mjEQ_JOINT)
        names = self.joint_names(range(model.njnt))
        return {
            names[model.eq_obj1id[n]]: names[model.eq_obj2id[n]]
            for n in np.flatnonzero((model.eq_type == joint) & model.eq_active0).tolist()
            if model.eq_obj2id[n] >= 0
        }

    def _keyframes(self) -> Iterator[tuple[str, list[float]]]:
        for name in self.folder.poses:
            try:
                yield name, self._keyframe(name)
            except RobotError:
                continue  # Of other joints, as those of a scene are.

    def _motors(self, names: Sequence[str]) -> list[_Motor]:
        written = self.written
        motors: list[_Motor] = []
        matched = [False] * len(self.settings.motors)
        for joint, name in zip(self.joints, names, strict=True):
            dof = int(self.model.jnt_dofadr[joint])
            motor = written.get(name, _Motor())
            follows, kp, torque = motor.follows, motor.kp, motor.torque
            gain = motor.kd if follows == "velocity" else None
            kd = float(np.ravel(self.model.dof_damping[dof])[0])
            kd += motor.damping
            own = kd
            if follows == "position":  # The damping of a servo comes on top of the joint's.
                kd += motor.kd or 0.0
            armature = float(self.model.dof_armature[dof]) + motor.armature
            friction = float(self.model.dof_frictionloss[dof])
            if self.model.jnt_actfrclimited[joint]:
                most = self._largest(name, "actuatorfrc", self.model.jnt_actfrcrange[joint])
                torque = most if torque is None else min(torque, most)
            for number, group in enumerate(self.settings.motors):
                if not any(fnmatchcase(name, pattern) for pattern in _patterns(group.joints)):
                    continue
                matched[number] = True
                kp = kp if group.kp is None else group.kp
                follows = follows if group.follows is None else group.follows
                kd = kd if group.kd is None else group.kd
                gain = gain if group.kd is None else group.kd
                torque = torque if group.torque is None else group.torque
                armature = armature if group.armature is None else group.armature
                friction = friction if group.friction is None else group.friction
            if follows == "velocity":  # The joint's own damping is no gain of a servo.
                kp, kd = 0.0, gain or None
                if own > 0.0:
                    what = f"damping={own:g} of its joint has no effect beside kd of a velocity"
                    self._loses(name, what)
            motors.append(
                _Motor(
                    follows=follows,
                    kp=kp,
                    kd=kd,
                    torque=torque,
                    armature=armature,
                    friction=friction,
                )
            )
        for number, was in enumerate(matched):
            if not was:
                raise self.fault(
                    ("motors", number, "joints"),
                    f"motors: no joint is named {self.settings.motors[number].joints}",
                    f"its joints are {', '.join(names)[:300]}",
                )
        return motors

    def _require_gains(self, names: Sequence[str], motors: Sequence[_Motor]) -> None:
        for what, unit, values in (
            ("kp", "N m / rad", [motor.kp for motor in motors]),
            ("kd", "N m s / rad", [motor.kd for motor in motors]),
            ("torque", "N m", [motor.torque for motor in motors]),
        ):
            lacking = [name for name, value in zip(names, values, strict=True) if value is None]
            if lacking:
                raise self.fault(
                    ("motors",),
                    f"motors: nothing says the {what} of {', '.join(lacking)[:300]}",
                    f'add `- {{joints: "*", {what}: ...}}` with its {unit}',
                )

    def _written(self) -> dict[str, _Motor]:
        """Return gains and largest torque by joint, as the actuators of the file have them.

        Several motors of a joint add up. What they have beyond that, the account says.
        """
        model, motors = self.model, dict[str, _Motor]()
        for motor in range(len(model.actuator_trntype)):  # Some have several controls.
            name = str(model.actuator(motor).name) or str(motor)
            if int(model.actuator_trntype[motor]) not in _ON_JOINTS:
                kind = mujoco.mjtTrn(int(model.actuator_trntype[motor])).name[6:].lower()
                self._loses(name, f"it acts on a {kind}, and is left out")
                continue
            gear = abs(float(model.actuator_gear[motor, 0])) or 1.0
            gain = float(model.actuator_gainprm[motor, 0])
            has_bias = float(model.actuator_biastype[motor] > 0)
            constant, stiffness, damping = (has_bias * model.actuator_biasprm[motor, :3]).tolist()
            servo = gain > 0.0 and stiffness < 0.0
            # <velocity kv="...">; a damper or a motor with friction has another gain than kv.
            wheel = gain > 0.0 and stiffness == 0.0 and damping == -gain
            torque = None
            if model.actuator_forcelimited[motor]:
                torque = gear * self._largest(name, "force", model.actuator_forcerange[motor])
            is_other = model.actuator_gaintype[motor] > 0 or model.actuator_biastype[motor] > 1
            if not (servo or wheel or is_other) and model.actuator_ctrllimited[motor]:
                own = gear * gain * self._largest(name, "ctrl", model.actuator_ctrlrange[motor])
                torque = own if torque is None else min(torque, own)
            joint = str(model.joint(int(model.actuator_trnid[motor, 0])).name)
            kd = gain if wheel else max(0.0, -damping) if servo else None
            for what, is_so in (
                ("it clamps its targets", (servo or wheel) and model.actuator_ctrllimited[motor]),
                ("it has states of its own", model.actuator_dyntype[motor]),
                ("its force is not linear in what it is told, position and speed", is_other),
                ("its force has a constant", constant != 0.0),
                ("its gain is not its stiffness", servo and not math.isclose(gain, -stiffness)),
                ("its force has a share of the speed", not servo and not wheel and damping != 0.0),
                ("its targets are late", model.actuator_delay[motor] > 0.0),
                ("its gear turns it the other way", model.actuator_gear[motor, 0] < 0.0),
            ):
                if is_so:
                    self._loses(name, f"{what}, which is not simulated")
            more = _Motor(
                follows="velocity" if wheel else "position",
                kp=gain * gear * gear if servo else None,
                kd=None if kd is None else kd * gear * gear,
                torque=torque,
                armature=float(model.actuator_armature[motor]) * gear * gear,
                damping=float(model.actuator_damping[motor]) * gear * gear,
            )
            motors[joint] = motors[joint].beside(more) if joint in motors else more
        return motors

    def _loses(self, motor: str, what: str) -> None:
        line = next(
            (
                self.folder.lines[each]
                for each in self.folder.model.iter()
                if each.get("name") == motor and "joint" in each.attrib
            ),
            0,
        )
        self.folder.account.loses(f"motor {motor!r}: {what}", line)

    def _largest(self, name: str, what: str, limits: Any) -> float:
        """Return the larger of two limits, which hold both ways here."""
        low, high = np.abs(limits).tolist()
        if not math.isclose(low, high, rel_tol=1e-6):
            self._loses(name, f"its {what}range is not the same both ways; the larger end is taken")
        return max(low, high)

    def _range(self, joint: int) -> tuple[float, float]:
        if not self.model.jnt_limited[joint]:
            return -_UNLIMITED, _UNLIMITED
        low, high = self.model.jnt_range[joint].tolist()
        return low, high

    def _keyframe(self, said: str) -> list[float]:
        """Return the angles of the joints in a keyframe."""
        if said not in self.folder.poses:
            raise self.fault(
                ("pose",), f"pose: no keyframe {said!r}", nearest(said, self.folder.poses)
            )
        values = _numbers(self.folder.poses[said])
        if len(values) == self.before + self.model.nq + self.after:
            values = values[self.before : self.before + self.model.nq]
        if len(values) != self.model.nq:
            raise self.fault(
                ("pose",),
                f"pose: keyframe {said!r} has {len(values)} numbers, the model {self.model.nq}",
                'write the angles: {"*_thigh_joint": 0.8}',
            )
        return [values[int(self.model.jnt_qposadr[joint])] for joint in self.joints]

    def _pose(self, names: Sequence[str], ranges: Sequence[tuple[float, float]]) -> list[float]:
        said = self.settings.pose
        if said is None and self.folder.poses:
            only = next(iter(self.folder.poses)) if len(self.folder.poses) == 1 else None
            said = "home" if "home" in self.folder.poses else only
        pose = [min(max(0.0, low), high) for low, high in ranges]
        if isinstance(said, str):
            return self._keyframe(said)
        for pattern, angle in (said or {}).items():
            hits = [i for i, name in enumerate(names) if fnmatchcase(name, pattern)]
            if not hits:
                raise self.fault(
                    ("pose", pattern),
                    f"pose: no joint is named {pattern!r}",
                    nearest(pattern, names),
                )
            for index in hits:
                pose[index] = angle
        for name, angle, (low, high) in zip(names, pose, ranges, strict=True):
            if not low <= angle <= high:
                raise self.fault(
                    ("pose",),
                    f"pose: {angle:g} is beyond the range of {name}",
                    f"give radians from {low:g} to {high:g}",
                )
        return pose

    def _stand(self, pose: Sequence[float]) -> None:
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self.data.qpos[self.model.jnt_qposadr[self.joints]] = pose
        mujoco.mj_forward(self.model, self.data)

    def _lows(self) -> dict[str, float]:
        """Return how low each body that collides reaches, m, with the root's origin at 0."""
        lows: dict[str, float] = {}
        for geom in range(self.model.ngeom):
            if collides(self.model, geom):
                body = self.body_name(int(self.model.geom_bodyid[geom]))
                lows[body] = min(lows.get(body, math.inf), lowest(self.model, self.data, geom))
        if not lows:
            masks = ", ".join(f"{kind} and {affinity}" for kind, affinity in self.masks[:4])
            raise self.folder.fault(
                f"nothing of it collides with the ground: its geoms have contype and conaffinity "
                f"{masks}, ground has 1 and 1",
                "set bit 1 in contype of what touches it, or let a floor in the file have theirs",
            )
        return lows

    def _feet(self, lows: dict[str, float]) -> tuple[str, ...]:
        if self.settings.touches == "geom":
            if self.settings.feet is None:
                raise self.fault(("touches",), "touches: geom", "name the geoms of `feet`")
            return tuple(self._parts(("feet",), self.settings.feet))
        if self.settings.feet is None:
            lowest = min(lows.values())
            return self._ends([body for body, low in lows.items() if low < lowest + _FOOT_REACH])
        feet = self.known(("feet",), self.settings.feet)
        for index, foot in enumerate(feet):
            if foot not in lows:
                raise self.fault(
                    ("feet", index), f"feet: nothing of {foot!r} collides", nearest(foot, lows)
                )
        return tuple(feet)

    def _ends(self, bodies: Sequence[str]) -> tuple[str, ...]:
        """Return those that have no other of them below: a shin whose foot stands there is none."""
        above = {name for body in bodies for name in self._ancestors(body)}
        return tuple(body for body in self.bodies if body in bodies and body not in above)

    def _standing(self, spec: RobotSpec, lows: dict[str, float]) -> tuple[str, ...]:
        """Return its feet, and the ends of what else carries it after a drop from its pose.

        A pose may have feet at several heights. One that falls has its feet as they are lowest.
        """
        dropped = self.shared.get("ground", lambda: LevelGround(spec)).under(spec).drop()
        if not dropped.stands:
            return spec.feet
        feet = [*spec.feet]
        for body in dropped.carriers:
            below = [other for other in lows if body in self._ancestors(other)]
            if not any(foot == body or foot in below for foot in feet):
                feet.append(min(self._ends(below) or [body], key=lows.__getitem__))
        return self._ends(feet)

    def _ancestors(self, body: str) -> Iterator[str]:
        number = int(self.model.body(body).id)
        while (number := int(self.model.body_parentid[number])) > 0:
            yield self.body_name(number)

    def _watched(self) -> Sequence[str]:
        """Return the parts whose contact is `collided`: by default, all of the root."""
        if self.settings.body is not None:
            return self.settings.body
        if self.settings.touches == "body":
            return [self.root]
        number = int(self.model.body(self.root).id)
        own = np.flatnonzero(self.model.geom_bodyid == number).tolist()
        return [str(self.model.geom(geom).name) for geom in own if collides(self.model, geom)]

    def _parts(self, key: tuple[str, ...], names: Sequence[str]) -> list[str]:
        """Return bodies, or geoms that collide, which the model has."""
        if self.settings.touches == "body":
            return self.known(key, names)
        geoms = [
            self.model.geom(g).name for g in range(self.model.ngeom) if collides(self.model, g)
        ]
        return self.known(key, names, "geom that collides", [str(name) for name in geoms])


def _outline(model: Any, geom: int) -> npt.NDArray[np.float64]:
    """Return points on the border of a geom in its body, (N, 3) m."""
    kind, size, R = model.geom_type[geom], model.geom_size[geom], np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        points = model.mesh_vert[first : first + count].astype(np.float64)
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        points = np.array([*product((-1.0, 1.0), repeat=3)]) * size
    else:  # Round about z; a sphere and an ellipsoid about all axes.
        turns = np.arange(64) * (2.0 * math.pi / 64)
        ring = np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1) * size[0]
        half = np.array([0.0, 0.0, size[1]])
        tall = kind in {mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE}
        rings = (
            [ring + half, ring - half] if tall else [ring, ring[:, [2, 0, 1]], ring[:, [1, 2, 0]]]
        )
        points = np.concatenate(rings)
    return points @ R.reshape(3, 3).T + model.geom_pos[geom]


def _patterns(joints: str | list[str]) -> list[str]:
    return [joints] if isinstance(joints, str) else joints


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []
