"""What follows from a robot's model file and its `robot.yaml`: the specification.

MuJoCo compiles the model once to say what is in it: bodies, joints, masses, limits. Then actuators
are written anew, one for each joint that is driven, and what is seen is told from what collides.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, Literal
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, tostring

import mujoco as _mujoco
import numpy as np
import numpy.typing as npt

from nw_eval.errors import RobotError, nearest
from nw_eval.robots.folder import Camera, RobotFolder, element_lines, fill_meshes
from nw_eval.robots.looks import kept_thinned, shares
from nw_eval.robots.spec import (
    COLLISION_GROUP,
    VISUAL_GROUP,
    CameraMount,
    Follow,
    ImuMount,
    RobotSpec,
    Shape,
    Triangles,
    Vector3,
)
from nw_eval.robots.standing import CLEARANCE, LevelGround, collides, lowest

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

Array = npt.NDArray[np.float64]

MOST_JOINTS, MOST_BODIES, MOST_GEOMS = 100, 300, 2_000
"""Of a robot."""

_GRAVITY = 9.806
_FOOT_REACH = 0.02  # m above the lowest collision point, within which a body stands on the ground
# contype of what is only seen, which nothing has in its conaffinity. It is not 0 because
# `mj_multiRay` of MuJoCo 4.0 passes over a body when the ray misses the box around those of its
# geoms that have any collision bit, and with it over visual geoms that stick out.
_HIDDEN = 1 << 30
_MOST_SHAPES = 400  # that are drawn
_GRID = 2.0**14  # points of meshes stand on 1/16384 m: the zero bits compress, and nobody sees it
_AHEAD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
_UNLIMITED = 1e6  # rad
_TURN = 1e-6  # by which a rotation may miss
_REWRITE = "leave as_written out, and the file is rewritten"
_LIGHTEST, _HEAVIEST = 0.1, 2_000.0  # kg
_CAMERA = re.compile(r"[A-Za-z0-9][\w.-]{0,63}", re.ASCII)  # name of a camera


def spec_of(folder: RobotFolder) -> RobotSpec:
    """Return the robot of a folder.

    Raises:
        RobotError: MuJoCo cannot compile the model, it is no robot that can be driven, or
            robot.yaml names what it does not have.
    """
    return _Derivation(folder).spec()


@dataclass(frozen=True, kw_only=True)
class _Motor:
    """What a joint is driven by, as far as it is known."""

    follows: Literal["position", "velocity"] = "position"
    kp: float | None = None
    kd: float | None = None
    torque: float | None = None
    armature: float = 0.0
    friction: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ModelFacts:
    """What a model file says of its motors, each in the order of `joints`."""

    joints: tuple[str, ...]
    """Those with motors, or all hinges where the file has no motors."""
    has_motors: bool
    kp: tuple[float | None, ...]
    """Of servos, N m / rad."""
    kd: tuple[float | None, ...]
    """N m s / rad."""
    torque: tuple[float | None, ...]
    """N m."""
    armature: tuple[float, ...]
    friction: tuple[float, ...]
    is_limited: tuple[bool, ...]
    """Whether they have ranges."""
    keyframes: dict[str, tuple[float, ...]]
    """Angles by name, rad, of those that fit."""
    bodies: int
    mass: float
    """kg."""
    camera: str | None
    """The one that is its eye."""


def facts_of(folder: RobotFolder) -> ModelFacts:
    """Return what a model file says of its motors; `motors` of robot.yaml must name no values.

    Raises:
        RobotError: as `spec_of`, but for gains that nothing says.
    """
    derivation = _Derivation(folder)
    return derivation.facts()


class _Derivation:
    def __init__(self, folder: RobotFolder) -> None:
        self.folder = folder
        self.settings = folder.settings
        self._text = ""
        self.mjspec: Any = self._parsed()
        self._tidy()
        self.model: Any = self._compiled(self.mjspec)
        self.data: Any = mujoco.MjData(self.model)
        self.root = self._root()
        self._weigh()
        self.bodies = [self._body(i) for i in range(1, self.model.nbody)]
        self.joints = self._joints()

    # Reading the model.

    def _parsed(self) -> Any:
        model = deepcopy(self.folder.model)
        try:
            if model.tag == "robot":
                model = self._converted(model)
            fill_meshes(model, self.folder)
            self._text = tostring(model, encoding="unicode")
            return mujoco.MjSpec.from_string(self._text)
        except ValueError as error:
            raise self._refused("MuJoCo cannot read it", error) from None

    def _refused(self, what: str, error: Exception) -> RobotError:
        """Return an error of MuJoCo's, with the line of the file that it is about."""
        message, *further = str(error).strip().splitlines()
        about, line = " ".join(further), 1
        named = re.search(r"name '([^']+)'", about)
        placed = re.search(r"line (\d+)", about)
        if named is not None:
            message += f" ({named[1]})"
            line = self.folder.line_of(named[1], "body", "joint", "geom", "mesh")
        if line == 1 and placed is not None:
            # MuJoCo counts the lines of the text that it was given.
            read = element_lines(self._text.encode())
            starts = [begin for event, _, begin in read if event == "start"]
            elements = list(self.folder.model.iter())
            if len(starts) == len(elements) and int(placed[1]) in starts:
                line = self.folder.lines[elements[starts.index(int(placed[1]))]]
        return self.folder.fault(f"{what}: {message}", line=line)

    def _converted(self, urdf: Element) -> Element:
        """Return a URDF as MJCF."""
        for each in urdf.findall("mujoco"):
            urdf.remove(each)
        options = {"strippath": "true", "fusestatic": "false", "balanceinertia": "true"}
        SubElement(SubElement(urdf, "mujoco"), "compiler", {**options, "discardvisual": "false"})
        try:
            spec = self._read_urdf(urdf)
        except ValueError as error:
            if next(urdf.iter("visual"), None) is None:
                raise
            for link in urdf.iter("link"):
                for visual in link.findall("visual"):
                    link.remove(visual)
            spec = self._read_urdf(urdf)  # What is wrong without its looks, is.
            said = str(error).strip().splitlines()[0]
            self.folder.notes.append(f"its <visual> are not drawn: MuJoCo says {said}")
        model = fromstring(spec.to_xml())  # noqa: S314 - MuJoCo's own text.
        for each in model.findall("compiler"):
            for key in ("meshdir", "texturedir", "strippath"):
                each.attrib.pop(key, None)
        return model

    def _read_urdf(self, urdf: Element) -> Any:
        text = tostring(urdf, encoding="unicode")
        spec = mujoco.MjSpec.from_string(text, assets=self.folder.meshes)
        spec.compile()
        return spec

    def _compiled(self, spec: Any) -> Any:
        try:
            model = spec.compile()
        except ValueError as error:
            raise self._refused("MuJoCo cannot compile it", error) from None
        for what, count, most in (
            ("bodies", model.nbody, MOST_BODIES),
            ("joints", model.njnt, MOST_JOINTS),
            ("geoms", model.ngeom, MOST_GEOMS),
        ):
            if count > most:
                raise self._fault(("model",), f"it has {count} {what}, over {most}")
        return model

    def _tidy(self) -> None:
        """Leave the floor out, give everything a name, and one root a free joint."""
        spec = self.mjspec
        world = spec.worldbody
        for kind in ("geoms", "sites", "cameras"):
            for each in list(getattr(world, kind)):
                spec.delete(each)
        tops = list(world.bodies)
        moving = [body for body in tops if _has_joints(body)]
        if len(moving) > 1:
            # Some files keep bodies of joints that are locked beside the robot (Unitree's g1, h1).
            moving = [body for body in moving if _is_free(body)] or moving
        if len(moving) > 1 or not tops:
            names = ", ".join(body.name or "?" for body in moving) or "none"
            raise self._fault(("model",), f"it must have one body at the top, and has {names}")
        root = moving[0] if moving else tops[0]
        place = [body.name for body in tops].index(root.name)
        # Keyframes have the numbers of the bodies that are left out, too.
        self.before = sum(map(_coordinates, tops[:place]))
        self.after = sum(map(_coordinates, tops[place + 1 :]))
        for body in tops:
            if body.name != root.name:
                spec.delete(body)
        joints = list(root.joints)
        if not _is_free(root):
            if joints:
                raise self._fault(
                    ("model",), f"its top body {root.name!r} has joints that are not free"
                )
            root.add_freejoint()
        self._name()

    def _name(self) -> None:
        """Give all parts names, and let defaults of the file not act on the scene beside it."""
        spec = self.mjspec
        plain, own = mujoco.MjSpec().default.geom, spec.default.geom
        for name in ("condim", "contype", "conaffinity", "friction", "margin", "gap", "group"):
            setattr(own, name, getattr(plain, name))
        for name in ("solref", "solimp", "solmix", "priority", "density", "rgba", "type"):
            setattr(own, name, getattr(plain, name))
        for kind, parts in (("body", spec.bodies), ("joint", spec.joints), ("geom", self._geoms())):
            taken = {part.name for part in parts}
            for number, part in enumerate(parts):
                part.name = part.name or _free_name(f"{kind}_{number}", taken)

    def _root(self) -> str:
        free = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        if len(free) != 1:
            raise self._fault(("model",), f"it has {len(free)} free joints; a robot has one")
        self.root_joint = str(self.model.joint(int(free[0])).name)
        root = self._body(int(self.model.jnt_bodyid[free[0]]))
        if self.settings.root is not None and self.settings.root != root:
            raise self._fault(("root",), f"root: the free joint is that of {root!r}")
        return root

    def _weigh(self) -> None:
        masses = self.model.body_mass
        total, most = float(masses.sum()), self._body(int(masses.argmax()))
        if not _LIGHTEST <= total <= _HEAVIEST:
            raise self.folder.fault(
                f"the robot weighs {total:.4g} kg, of which {most!r} has {masses.max():.4g} kg; "
                f"{_LIGHTEST:g} to {_HEAVIEST:,.0f} kg are simulated",
                'masses are in kg; a mesh in millimetres needs scale="0.001 0.001 0.001"',
                self.folder.line_of(most, "body"),
            )

    def _body(self, number: int) -> str:
        return str(self.model.body(number).name)

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
                    f"joint {name!r} is no hinge; only these are driven",
                    "weld it: remove the joint",
                    self.folder.line_of(name, "joint"),
                )
        driven = [joint for joint in hinges if self._names([joint])[0] in self._written()]
        patterns = [p for group in self.settings.motors for p in _patterns(group.joints)]
        if not driven:  # The file has no motors; those of robot.yaml are all there are.
            driven = [
                joint
                for joint in hinges
                if any(fnmatchcase(self._names([joint])[0], pattern) for pattern in patterns)
            ]
        if not driven:
            raise self._fault(
                ("motors",),
                f"motors: {self.settings.model.file} has no motors, and nothing here names a joint",
                'add `- {joints: "*", kp: ..., kd: ..., torque: ...}`',
            )
        return driven

    def _names(self, joints: Sequence[int]) -> list[str]:
        return [str(self.model.joint(joint).name) for joint in joints]

    # What it is.

    def spec(self) -> RobotSpec:
        """Return the specification."""
        names = self._names(self.joints)
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
        cameras = self._cameras()
        visuals, pictured = self._visuals()
        follows: tuple[Follow, ...] = tuple(motor.follows for motor in motors)
        self._round_wheels(
            [j for j, follow in zip(self.joints, follows, strict=True) if follow != "position"]
        )
        as_written = self.settings.model.as_written
        mjcf = (
            self._text_as_written(names)
            if as_written
            else self._mjcf(names, is_seen_apart=pictured == "visuals")
        )
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
            cameras=cameras,
            imu=self._imu(),
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
        names = self._names(self.joints)
        motors = self._motors(names)
        self._stand(self._pose(names, [self._range(joint) for joint in self.joints]))
        eye = self._first_camera()
        return ModelFacts(
            joints=tuple(names),
            has_motors=bool(self._written()),
            kp=tuple(motor.kp for motor in motors),
            kd=tuple(motor.kd for motor in motors),
            torque=tuple(motor.torque for motor in motors),
            armature=tuple(motor.armature for motor in motors),
            friction=tuple(motor.friction for motor in motors),
            is_limited=tuple(bool(self.model.jnt_limited[joint]) for joint in self.joints),
            keyframes={name: tuple(pose) for name, pose in self._keyframes()},
            bodies=len(self.bodies),
            mass=float(self.model.body_mass.sum()),
            camera=None if eye is None else eye[0],
        )

    def _keyframes(self) -> Iterator[tuple[str, list[float]]]:
        for name in self.folder.poses:
            try:
                yield name, self._keyframe(name)
            except RobotError:
                continue  # Of other joints, as those of a scene are.

    def _motors(self, names: Sequence[str]) -> list[_Motor]:
        written = self._written()
        motors: list[_Motor] = []
        matched = [False] * len(self.settings.motors)
        for joint, name in zip(self.joints, names, strict=True):
            dof = int(self.model.jnt_dofadr[joint])
            motor = written.get(name, _Motor())
            follows, kp, torque = motor.follows, motor.kp, motor.torque
            gain = motor.kd if follows == "velocity" else None
            kd = float(np.ravel(self.model.dof_damping[dof])[0])
            if follows == "position":  # The damping of a servo comes on top of the joint's.
                kd += motor.kd or 0.0
            armature = float(self.model.dof_armature[dof])
            friction = float(self.model.dof_frictionloss[dof])
            if self.model.jnt_actfrclimited[joint]:
                torque = float(np.abs(self.model.jnt_actfrcrange[joint]).max())
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
                raise self._fault(
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
                raise self._fault(
                    ("motors",),
                    f"motors: nothing says the {what} of {', '.join(lacking)[:300]}",
                    f'add `- {{joints: "*", {what}: ...}}` with its {unit}',
                )

    def _written(self) -> dict[str, _Motor]:
        """Return gains and largest torque by joint, as the actuators of the file have them."""
        model = self.model
        found: dict[str, _Motor] = {}
        for motor in range(model.nu):
            if model.actuator_trntype[motor] != mujoco.mjtTrn.mjTRN_JOINT:
                continue
            gear = abs(float(model.actuator_gear[motor, 0])) or 1.0
            gain = float(model.actuator_gainprm[motor, 0])
            _, stiffness, damping = model.actuator_biasprm[motor, :3].tolist()
            servo = gain > 0.0 and stiffness < 0.0
            # <velocity kv="...">; a damper or a motor with friction has another gain than kv.
            wheel = gain > 0.0 and stiffness == 0.0 and damping == -gain
            torque = None
            if model.actuator_forcelimited[motor]:
                torque = gear * float(np.abs(model.actuator_forcerange[motor]).max())
            elif not servo and not wheel and model.actuator_ctrllimited[motor]:
                torque = gear * float(gain * np.abs(model.actuator_ctrlrange[motor]).max())
            joint = str(model.joint(int(model.actuator_trnid[motor, 0])).name)
            kd = gain if wheel else max(0.0, -damping) if servo else None
            found[joint] = _Motor(
                follows="velocity" if wheel else "position",
                kp=gain * gear * gear if servo else None,
                kd=None if kd is None else kd * gear * gear,
                torque=torque,
            )
        return found

    def _range(self, joint: int) -> tuple[float, float]:
        if not self.model.jnt_limited[joint]:
            return -_UNLIMITED, _UNLIMITED
        low, high = self.model.jnt_range[joint].tolist()
        return low, high

    def _keyframe(self, said: str) -> list[float]:
        """Return the angles of the joints in a keyframe."""
        if said not in self.folder.poses:
            raise self._fault(
                ("pose",), f"pose: no keyframe {said!r}", nearest(said, self.folder.poses)
            )
        values = _numbers(self.folder.poses[said])
        if len(values) == self.before + self.model.nq + self.after:
            values = values[self.before : self.before + self.model.nq]
        if len(values) != self.model.nq:
            raise self._fault(
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
                raise self._fault(
                    ("pose", pattern),
                    f"pose: no joint is named {pattern!r}",
                    nearest(pattern, names),
                )
            for index in hits:
                pose[index] = angle
        for name, angle, (low, high) in zip(names, pose, ranges, strict=True):
            if not low <= angle <= high:
                raise self._fault(
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
                body = self._body(int(self.model.geom_bodyid[geom]))
                lows[body] = min(lows.get(body, math.inf), lowest(self.model, self.data, geom))
        if not lows:
            raise self._fault(("model",), "nothing of it collides with the ground")
        return lows

    def _feet(self, lows: dict[str, float]) -> tuple[str, ...]:
        if self.settings.touches == "geom":
            if self.settings.feet is None:
                raise self._fault(("touches",), "touches: geom", "name the geoms of `feet`")
            return tuple(self._parts(("feet",), self.settings.feet))
        if self.settings.feet is None:
            lowest = min(lows.values())
            return self._ends([body for body, low in lows.items() if low < lowest + _FOOT_REACH])
        feet = self._known(("feet",), self.settings.feet)
        for index, foot in enumerate(feet):
            if foot not in lows:
                raise self._fault(
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
        dropped = LevelGround(spec).drop()
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
            yield self._body(number)

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
            return self._known(key, names)
        geoms = [
            self.model.geom(g).name for g in range(self.model.ngeom) if collides(self.model, g)
        ]
        return self._known(key, names, "geom that collides", [str(name) for name in geoms])

    def _known(
        self,
        key: tuple[str, ...],
        names: Sequence[str],
        kind: str = "body",
        known: Sequence[str] | None = None,
    ) -> list[str]:
        known = self.bodies if known is None else known
        for index, name in enumerate(names):
            if name not in known:
                raise self._fault(
                    (*key, index), f"{key[0]}: no {kind} {name!r}", nearest(name, known)
                )
            if name in names[:index]:
                raise self._fault((*key, index), f"{key[0]}: {name!r} is named twice")
        return list(names)

    # What it sees, and how it looks.

    def _cameras(self) -> dict[str, CameraMount]:
        """Return `ego`, then the other cameras of robot.yaml and of the model, by name."""
        settings = self.settings.cameras
        said = {name: self._mounted(eye, ("cameras", name)) for name, eye in settings.items()}
        if self.settings.eye is not None:
            if "ego" in said:
                raise self._fault(("cameras", "ego"), "cameras: `eye` is `ego`, too", "remove one")
            said["ego"] = self._mounted(Camera(**dict(self.settings.eye)), ("eye",))
        own: dict[str, CameraMount] = {}
        for camera in range(self.model.ncam):
            name = str(self.model.camera(camera).name)
            mount = self._camera(camera)
            if mount is not None and _CAMERA.fullmatch(name):
                own[name] = mount
        first = self._first_camera()
        ego = (
            said.get("ego")
            or (None if first is None else first[1])
            or CameraMount(
                position=(self._front(), 0.0, 0.0), R_trunk_camera=_AHEAD, fovy=math.pi / 2
            )
        )
        return {"ego": ego} | {k: v for k, v in (own | said).items() if k != "ego"}

    def _mounted(self, camera: Camera, key: tuple[str, ...]) -> CameraMount:
        (body,) = self._known((*key, "body"), [camera.body or self.root])
        if camera.rotation is None:
            cosine, sine = math.cos(camera.pitch), math.sin(camera.pitch)
            turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
            axes = self._turn(camera.quaternion, key) @ np.array(_AHEAD) @ turn
        else:
            axes = np.array(camera.rotation)
            if np.abs(axes.T @ axes - np.eye(3)).max() > _TURN or np.linalg.det(axes) < 0.0:
                message = f"{'.'.join(key)}.rotation: it is no rotation"
                raise self._fault((*key, "rotation"), message)
        position, fovy = np.array(camera.position), math.radians(camera.fovy)
        if body == self.root:  # Its numbers are taken as they are written, to the last bit.
            return _mount(position, axes, fovy, "")
        carrier, T = self._carried(body)
        return _mount(T[:3, :3] @ position + T[:3, 3], T[:3, :3] @ axes, fovy, carrier)

    def _imu(self) -> ImuMount | None:
        imu = self.settings.imu
        if imu is None:
            return None
        if imu.site is not None:
            sites = [str(self.model.site(number).name) for number in range(self.model.nsite)]
            if imu.site not in sites:
                fix = (
                    nearest(imu.site, sites) if sites else "name a body: {body: ..., position: ...}"
                )
                raise self._fault(("imu", "site"), f"imu: no site {imu.site!r}", fix)
            number = sites.index(imu.site)
            body = self._body(int(self.model.site_bodyid[number]))
            position, quaternion = self.model.site_pos[number], self.model.site_quat[number]
        else:
            (body,) = self._known(("imu", "body"), [imu.body or self.root])
            position, quaternion = np.array(imu.position), imu.quaternion
        carrier, T = self._carried(body)
        R = T[:3, :3] @ self._turn(quaternion, ("imu",))
        x, y, z = (T[:3, :3] @ position + T[:3, 3]).tolist()
        return ImuMount(body=carrier, position=(x, y, z), R_body_imu=_rows(R))

    def _turn(self, quaternion: Sequence[float], key: tuple[str, ...]) -> Array:
        """Return the rotation of a quaternion, (3, 3)."""
        length = float(np.linalg.norm(quaternion))
        if not 0.9 < length < 1.1:
            message = f"{key[0]}: a quaternion of length {length:g}"
            raise self._fault((*key, "quaternion"), message, "give w x y z of length 1")
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, np.array(quaternion, dtype=np.float64) / length)
        return R.reshape(3, 3)

    def _first_camera(self) -> tuple[str, CameraMount] | None:
        """Return the first camera of the model that nothing moves against the trunk, by name."""
        for camera in range(self.model.ncam):
            mount = self._camera(camera)
            if mount is not None and not mount.body:
                return str(self.model.camera(camera).name) or "camera without a name", mount
        return None

    def _camera(self, camera: int) -> CameraMount | None:
        """Return a camera of the model; None if it is not fixed to its body."""
        if self.model.cam_mode[camera] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            return None
        carrier, T = self._carried(self._body(int(self.model.cam_bodyid[camera])))
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, self.model.cam_quat[camera])
        axes = R.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])  # OpenCV's, of MuJoCo's
        position = T[:3, :3] @ self.model.cam_pos[camera] + T[:3, 3]
        fovy = math.radians(float(self.model.cam_fovy[camera]))
        return _mount(position, T[:3, :3] @ axes, fovy, carrier)

    def _front(self) -> float:
        own = np.flatnonzero(self.model.geom_bodyid == self.model.body(self.root).id)
        reach = [float(self.model.geom_pos[g, 0] + self.model.geom_rbound[g]) for g in own.tolist()]
        return max(reach, default=0.1)

    def _is_rigid(self, body: str) -> bool:
        number, root = int(self.model.body(body).id), int(self.model.body(self.root).id)
        return bool(self.model.body_weldid[number] == self.model.body_weldid[root])

    def _carried(self, body: str) -> tuple[str, Array]:
        """Return what carries things on a body, and T_carrier_body, (4, 4).

        That is the root ("") where no joint moves the body against it, else the body itself.
        """
        T = np.eye(4)
        if not self._is_rigid(body):
            return body, T
        root, own = self.data.body(self.root), self.data.body(body)
        R = root.xmat.reshape(3, 3)
        T[:3, :3] = R.T @ own.xmat.reshape(3, 3)
        T[:3, 3] = R.T @ (own.xpos - root.xpos)
        return "", T

    def _visuals(self) -> tuple[tuple[Shape, ...], Literal["geoms", "visuals"]]:
        """Return what is drawn, and what of it pictures show.

        Where all that is only seen are primitives, pictures show these geoms. Else no mesh is left
        to physics, and a body without anything that is only seen shows what collides.
        """
        model = self.model
        geoms = [g for g in range(model.ngeom) if self._look(g)[3] > 0.0]
        only_seen = [g for g in geoms if not collides(self.model, g)]
        has_meshes = any(model.geom_type[g] == _MESH for g in only_seen)
        if only_seen and not has_meshes:
            shapes = [shape for g in only_seen[:_MOST_SHAPES] for shape in self._shapes(g, None)]
            return tuple(shapes), "geoms"
        shown = {int(model.geom_bodyid[g]) for g in only_seen}
        seen = [g for g in geoms if g in only_seen or int(model.geom_bodyid[g]) not in shown]
        meshes = [g for g in seen[:_MOST_SHAPES] if model.geom_type[g] == _MESH]
        faces = [int(model.mesh_facenum[model.geom_dataid[g]]) for g in meshes]
        sizes = [float(np.linalg.norm(model.geom_aabb[g, 3:])) for g in meshes]
        most = dict(zip(meshes, shares(faces, sizes), strict=True))
        return tuple(
            s for g in seen[:_MOST_SHAPES] for s in self._shapes(g, most.get(g))
        ), "visuals"

    def _look(self, geom: int) -> tuple[float, float, float, float]:
        """Return the colour of a geom, 0 to 1: its own, else its material's, as MuJoCo draws it."""
        material = int(self.model.geom_matid[geom])
        own = self.model.geom_rgba[geom]
        is_own = material < 0 or not np.array_equal(own, np.array(_PLAIN, np.float32))
        red, green, blue, alpha = _decimals(own if is_own else self.model.mat_rgba[material])
        return red, green, blue, alpha

    def _shapes(self, geom: int, most: int | None) -> list[Shape]:
        """Return what a geom looks like, in the frame of its body.

        Args:
            geom: its number.
            most: how many faces a mesh may have.
        """
        model = self.model
        kind, size = int(model.geom_type[geom]), model.geom_size[geom].tolist()
        position, turn = model.geom_pos[geom], tuple(model.geom_quat[geom].tolist())
        at = tuple(position.tolist())
        body = self._body(int(model.geom_bodyid[geom]))
        look: dict[str, Any] = {"body": body, "rgba": self._look(geom)}
        if kind in _KINDS:
            name, count = _KINDS[kind]
            return [Shape(kind=name, size=tuple(size[:count]), position=at, quat=turn, **look)]  # pyright: ignore[reportArgumentType]
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
        R = turned.reshape(3, 3)
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            radius, half = size[:2]
            ends = [tuple((position + R[:, 2] * end).tolist()) for end in (half, -half)]
            tube = Shape(kind="cylinder", size=(radius, half), position=at, quat=turn, **look)
            return [tube, *(Shape(kind="sphere", size=(radius,), position=e, **look) for e in ends)]
        if kind != _MESH or not most:
            return []
        mesh = int(model.geom_dataid[geom])
        start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        vertices = model.mesh_vert[start : start + count].astype(np.float64)
        start, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        faces = model.mesh_face[start : start + count].astype(np.int64)
        fewer = kept_thinned(vertices, faces, most)
        if not len(fewer.faces):
            return []
        points = np.rint((fewer.vertices @ R.T + position) * _GRID) / _GRID
        return [Shape(kind="mesh", size=(), triangles=Triangles.of(points, fewer.faces), **look)]

    def _mjcf(self, names: Sequence[str], *, is_seen_apart: bool) -> str:
        """Write the model with one actuator a joint, and groups by what collides and is seen.

        Args:
            names: of the joints that have one.
            is_seen_apart: what is only seen is left out.
        """
        spec, model = self.mjspec, self.model
        # What was compiled is written out, body by body: classes of defaults may say less.
        for body in spec.bodies[1:]:
            number = int(model.body(body.name).id)
            body.explicitinertial = True
            body.mass, body.inertia = model.body_mass[number], model.body_inertia[number]
            body.ipos, body.iquat = model.body_ipos[number], model.body_iquat[number]
            body.fullinertia = [math.nan, *(0.0,) * 5]  # What is not a number is not set.
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
        spec.compiler.settotalmass = -1.0
        for part in (*self._geoms(), *spec.joints, *spec.sites, *spec.meshes):
            part.classname = spec.default
        self._group_geoms(is_seen_apart=is_seen_apart)
        for what in ("actuators", "cameras", "materials"):
            for each in list(getattr(spec, what)):
                spec.delete(each)
        for name in names:
            actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.set_to_position(kp=1.0)
            actuator.forcelimited, actuator.forcerange = True, [-1.0, 1.0]
        for joint in spec.joints:  # The motors' limits are the actuators'.
            joint.actfrclimited = False
        self._compiled(spec)
        return str(spec.to_xml())

    def _text_as_written(self, names: Sequence[str]) -> str:
        """Return the model file's own text, where it needs no rewriting."""
        tree, model = deepcopy(self.folder.model), self.model
        tops = [child for world in tree.iter("worldbody") for child in world]
        free = {
            each.tag if each.get("type") != "free" else "freejoint" for top in tops for each in top
        }
        motors = [(each.tag, each.get("name"), each.get("joint")) for each in tree.iter("position")]
        kinds = [
            COLLISION_GROUP if collides(self.model, geom) else VISUAL_GROUP
            for geom in range(model.ngeom)
        ]
        for what, is_so in (
            ("the file is no MJCF", tree.tag == "mujoco"),
            ("the world holds other than one body", [top.tag for top in tops] == ["body"]),
            ("its body has no free joint", "freejoint" in free),
            (
                "its actuators are other than one position servo a joint, of its name",
                motors == [("position", name, name) for name in names] and model.nu == len(names),
            ),
            (
                f"groups of geoms are not {COLLISION_GROUP}, and {VISUAL_GROUP} of what is seen",
                model.geom_group.tolist() == kinds,
            ),
        ):
            if not is_so:
                raise self._fault(("model", "as_written"), f"model.as_written: {what}", _REWRITE)
        fill_meshes(tree, self.folder)
        indent(tree)  # Comments of the file are gone, and left their lines empty.
        return tostring(tree, encoding="unicode")

    def _round_wheels(self, joints: Sequence[int]) -> None:
        """Let a cylinder roll in place of each mesh that collides and turns with a wheel.

        A hull has facets, and on scanned ground the box round it would not roll.
        """
        for joint in joints:
            number = int(self.model.jnt_bodyid[joint])
            for geom in self.mjspec.body(self._body(number)).geoms:
                own = int(self.model.geom(geom.name).id)
                is_mesh = self.model.geom_type[own] == mujoco.mjtGeom.mjGEOM_MESH
                if not (is_mesh and collides(self.model, own)):
                    continue
                mesh = int(self.model.geom_dataid[own])
                first, count = (
                    int(self.model.mesh_vertadr[mesh]),
                    int(self.model.mesh_vertnum[mesh]),
                )
                R = np.empty(9)
                mujoco.mju_quat2Mat(R, self.model.geom_quat[own])
                points = self.model.mesh_vert[first : first + count] @ R.reshape(3, 3).T
                points = points + self.model.geom_pos[own] - self.model.jnt_pos[joint]
                axis = self.model.jnt_axis[joint]
                along = points @ axis
                radius = float(np.linalg.norm(points - np.outer(along, axis), axis=1).max())
                quat = np.empty(4)
                mujoco.mju_quatZ2Vec(quat, axis)
                middle = (float(along.min()) + float(along.max())) / 2.0
                geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_CYLINDER, ""
                geom.size = [radius, float(np.ptp(along)) / 2.0, 0.0]
                geom.pos, geom.quat = self.model.jnt_pos[joint] + middle * axis, quat

    def _group_geoms(self, *, is_seen_apart: bool) -> None:
        """Tell what collides from what is only seen, or leave that out with its meshes."""
        spec = self.mjspec
        for geom in self._geoms():
            number = int(self.model.geom(geom.name).id)
            geom.rgba, geom.material = list(self._look(number)), ""
            if collides(self.model, number):
                geom.group = COLLISION_GROUP
            elif is_seen_apart:
                spec.delete(geom)
            else:
                geom.group, geom.contype, geom.conaffinity = VISUAL_GROUP, _HIDDEN, 0
        used = {geom.meshname for geom in self._geoms()}
        for mesh in list(spec.meshes):
            if mesh.name not in used:
                spec.delete(mesh)

    def _geoms(self) -> list[Any]:
        return [geom for body in self.mjspec.bodies for geom in body.geoms]

    def _fault(
        self, place: tuple[str | int, ...], message: str, fix: str | None = None
    ) -> RobotError:
        words = f"{self.settings.model.file}: {message}" if place == ("model",) else message
        return RobotError([self.folder.file.problem(place, words, fix)])


def _free_name(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _is_free(body: Any) -> bool:
    return any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)


def _coordinates(body: Any) -> int:
    """Return how many numbers of a keyframe a body and those below it have."""
    sizes = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    own = sum(sizes.get(joint.type, 1) for joint in body.joints)
    return own + sum(map(_coordinates, body.bodies))


def _has_joints(body: Any) -> bool:
    return bool(list(body.joints)) or any(_has_joints(child) for child in body.bodies)


def _patterns(joints: str | list[str]) -> list[str]:
    return [joints] if isinstance(joints, str) else joints


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def _decimals(values: npt.NDArray[np.float32]) -> tuple[float, ...]:
    """Return what single-precision numbers were written as: 0.8, not 0.800000011920929."""
    return tuple(float(str(value)) for value in values)


def _mount(position: Array, R: Array, fovy: float, body: str) -> CameraMount:
    x, y, z = position.tolist()
    return CameraMount(position=(x, y, z), R_trunk_camera=_rows(R), fovy=fovy, body=body)


def _rows(R: Array) -> tuple[Vector3, Vector3, Vector3]:
    one, two, three = ((a, b, c) for a, b, c in R.tolist())
    return one, two, three


_PLAIN = (0.5, 0.5, 0.5, 1.0)
"""The colour of a geom that has none of its own."""
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("sphere", 1),
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
}
