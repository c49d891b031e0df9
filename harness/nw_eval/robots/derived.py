"""What follows from a robot's model file and its `robot.yaml`: the specification.

MuJoCo compiles the model once to say what is in it: bodies, joints, masses, limits. Then actuators
are written anew, one for each joint that is driven, and what is seen is told from what collides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, tostring

import mujoco as _mujoco
import numpy as np
import numpy.typing as npt

from nw_eval.errors import RobotError, nearest
from nw_eval.robots.folder import Camera, RobotFolder, fill_meshes
from nw_eval.robots.spec import (
    COLLISION_GROUP,
    VISUAL_GROUP,
    CameraMount,
    RobotSpec,
    Shape,
)

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

Array = npt.NDArray[np.float64]

MOST_JOINTS, MOST_BODIES, MOST_GEOMS = 100, 300, 2_000
"""Of a robot."""

_GRAVITY = 9.806
_CLEARANCE = 0.01  # m between the lowest point and the ground at the start
_FOOT_REACH = 0.02  # m above the lowest collision point, within which a body stands on the ground
# contype of what is only seen, which nothing has in its conaffinity. It is not 0 because
# `mj_multiRay` of MuJoCo 4.0 passes over a body when the ray misses the box around those of its
# geoms that have any collision bit, and with it over visual geoms that stick out.
_HIDDEN = 1 << 30
_MOST_SHAPES = 400  # drawn in logs
_AHEAD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
_UNLIMITED = 1e6  # rad
_FLAT = 1e-9  # of variances across and along a mesh that lies in one plane
_TURN = 1e-6  # by which a rotation may miss
_REWRITE = "leave as_written out, and the file is rewritten"
_GREY = (0.6, 0.62, 0.65, 1.0)


def spec_of(folder: RobotFolder) -> RobotSpec:
    """Return the robot of a folder.

    Raises:
        RobotError: MuJoCo cannot compile the model, it is no robot that can be driven, or
            robot.yaml names what it does not have.
    """
    return _Derivation(folder).spec()


@dataclass(frozen=True, kw_only=True)
class _Motor:
    """What a joint is driven by."""

    kp: float | None
    kd: float
    torque: float | None
    armature: float
    friction: float


class _Derivation:
    def __init__(self, folder: RobotFolder) -> None:
        self.folder = folder
        self.settings = folder.settings
        self.mjspec: Any = self._parsed()
        self._tidy()
        self.model: Any = self._compiled(self.mjspec)
        self.data: Any = mujoco.MjData(self.model)
        self.root = self._root()
        self.bodies = [self._body(i) for i in range(1, self.model.nbody)]
        self.joints = self._joints()

    # Reading the model.

    def _parsed(self) -> Any:
        model = deepcopy(self.folder.model)
        try:
            if model.tag == "robot":
                model = self._converted(model)
            fill_meshes(model, self.folder)
            return mujoco.MjSpec.from_string(tostring(model, encoding="unicode"))
        except ValueError as error:
            raise self._fault(("model",), f"MuJoCo cannot read it: {_first(error)}") from None

    def _converted(self, urdf: Element) -> Element:
        """Return a URDF as MJCF."""
        for each in urdf.findall("mujoco"):
            urdf.remove(each)
        options = {"strippath": "true", "fusestatic": "false", "balanceinertia": "true"}
        SubElement(SubElement(urdf, "mujoco"), "compiler", options)
        text = tostring(urdf, encoding="unicode")
        spec = mujoco.MjSpec.from_string(text, assets=self.folder.meshes)
        spec.compile()
        model = fromstring(spec.to_xml())  # noqa: S314 - MuJoCo's own text.
        for each in model.findall("compiler"):
            for key in ("meshdir", "texturedir", "strippath"):
                each.attrib.pop(key, None)
        return model

    def _compiled(self, spec: Any) -> Any:
        try:
            model = spec.compile()
        except ValueError as error:
            raise self._fault(("model",), f"MuJoCo cannot compile it: {_first(error)}") from None
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
                raise self._fault(("model",), f"joint {name!r} is no hinge; only these are driven")
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
        ranges = [self._range(joint) for joint in self.joints]
        pose = self._pose(names, ranges)
        self._stand(pose)
        lows = self._lows()
        feet = self._feet(lows)
        weight = float(self.model.body_mass.sum()) * _GRAVITY
        collided, published = self.settings.collided, self.settings.published
        watched = tuple(self._parts(("body",), self._watched()))
        height, free = self.settings.spawn_height, published.free_joint
        cameras = self._cameras()
        visuals = self._visuals()
        as_written = self.settings.model.as_written
        mjcf = self._text_as_written(names) if as_written else self._mjcf(names)
        return RobotSpec(
            name=self.settings.name,
            joints=tuple(names),
            default_pose=tuple(pose),
            joint_ranges=tuple(ranges),
            kp=tuple(0.0 if motor.kp is None else motor.kp for motor in motors),
            joint_damping=tuple(motor.kd for motor in motors),
            torque_limits=tuple(0.0 if m.torque is None else m.torque for m in motors),
            armature=tuple(motor.armature for motor in motors),
            friction_loss=tuple(motor.friction for motor in motors),
            root_joint=self.root_joint,
            touches=self.settings.touches,
            feet=feet,
            monitored=watched,
            published_monitored=watched
            if published.body is None
            else tuple(self._parts(("published", "body"), published.body)),
            fell_tilt=self.settings.fell.tilt,
            fell_height=self.settings.fell.height,
            collided_force=collided.newtons or collided.force * weight,
            cameras=cameras,
            height_camera_offset=published.height_camera,
            root_defaults=(free.damping, free.armature, free.friction),
            bodies=(self.root, *(body for body in self.bodies if body != self.root)),
            visuals=visuals,
            spawn_height=-min(lows.values()) + _CLEARANCE if height is None else height,
            mjcf=mjcf,
        )

    def _motors(self, names: Sequence[str]) -> list[_Motor]:
        written, damped = self._written(), self._servo_damping()
        motors: list[_Motor] = []
        matched = [False] * len(self.settings.motors)
        for joint, name in zip(self.joints, names, strict=True):
            dof = int(self.model.jnt_dofadr[joint])
            kp, torque = written.get(name, (None, None))
            kd = float(np.ravel(self.model.dof_damping[dof])[0]) + damped.get(name, 0.0)
            armature = float(self.model.dof_armature[dof])
            friction = float(self.model.dof_frictionloss[dof])
            if self.model.jnt_actfrclimited[joint]:
                torque = float(np.abs(self.model.jnt_actfrcrange[joint]).max())
            for number, group in enumerate(self.settings.motors):
                if not any(fnmatchcase(name, pattern) for pattern in _patterns(group.joints)):
                    continue
                matched[number] = True
                kp = kp if group.kp is None else group.kp
                kd = kd if group.kd is None else group.kd
                torque = torque if group.torque is None else group.torque
                armature = armature if group.armature is None else group.armature
                friction = friction if group.friction is None else group.friction
            motors.append(_Motor(kp=kp, kd=kd, torque=torque, armature=armature, friction=friction))
        for number, was in enumerate(matched):
            if not was:
                raise self._fault(
                    ("motors", number, "joints"),
                    f"motors: no joint is named {self.settings.motors[number].joints}",
                    f"its joints are {', '.join(names)[:300]}",
                )
        for what, unit, values in (
            ("kp", "N m / rad", [motor.kp for motor in motors]),
            ("torque", "N m", [motor.torque for motor in motors]),
        ):
            lacking = [name for name, value in zip(names, values, strict=True) if value is None]
            if lacking:
                raise self._fault(
                    ("motors",),
                    f"motors: nothing says the {what} of {', '.join(lacking)[:300]}",
                    f'add `- {{joints: "*", {what}: ...}}` with its {unit}',
                )
        return motors

    def _written(self) -> dict[str, tuple[float | None, float | None]]:
        """Return gain and largest torque by joint, as the actuators of the file have them."""
        model = self.model
        found: dict[str, tuple[float | None, float | None]] = {}
        for motor in range(model.nu):
            if model.actuator_trntype[motor] != mujoco.mjtTrn.mjTRN_JOINT:
                continue
            gear = abs(float(model.actuator_gear[motor, 0])) or 1.0
            gain, bias = model.actuator_gainprm[motor, 0], model.actuator_biasprm[motor, 1]
            servo = bias < 0.0 and gain > 0.0
            torque = None
            if model.actuator_forcelimited[motor]:
                torque = gear * float(np.abs(model.actuator_forcerange[motor]).max())
            elif not servo and model.actuator_ctrllimited[motor]:
                torque = gear * float(gain * np.abs(model.actuator_ctrlrange[motor]).max())
            joint = str(model.joint(int(model.actuator_trnid[motor, 0])).name)
            found[joint] = (float(gain * gear * gear) if servo else None, torque)
        return found

    def _servo_damping(self) -> dict[str, float]:
        """Return the damping of servos by joint, `kv` or `dampratio` in the file, N m s / rad."""
        model, found = self.model, dict[str, float]()
        for motor in range(model.nu):
            if model.actuator_trntype[motor] == mujoco.mjtTrn.mjTRN_JOINT:
                joint = str(model.joint(int(model.actuator_trnid[motor, 0])).name)
                gear, kv = float(model.actuator_gear[motor, 0]), model.actuator_biasprm[motor, 2]
                found[joint] = max(0.0, -float(kv) * gear * gear)
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

    def _collides(self, geom: int) -> bool:
        return bool(self.model.geom_contype[geom] & 1 or self.model.geom_conaffinity[geom] & 1)

    def _lows(self) -> dict[str, float]:
        """Return how low each body that collides reaches, m, with the root's origin at 0."""
        lows: dict[str, float] = {}
        for geom in range(self.model.ngeom):
            if self._collides(geom):
                body = self._body(int(self.model.geom_bodyid[geom]))
                lows[body] = min(lows.get(body, math.inf), self._low(geom))
        if not lows:
            raise self._fault(("model",), "nothing of it collides with the ground")
        return lows

    def _low(self, geom: int) -> float:
        model, kind = self.model, self.model.geom_type[geom]
        down = self.data.geom_xmat[geom].reshape(3, 3)[2]
        size = model.geom_size[geom]
        centre = float(self.data.geom_xpos[geom, 2])
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

    def _feet(self, lows: dict[str, float]) -> tuple[str, ...]:
        if self.settings.touches == "geom":
            if self.settings.feet is None:
                raise self._fault(("touches",), "touches: geom", "name the geoms of `feet`")
            return tuple(self._parts(("feet",), self.settings.feet))
        if self.settings.feet is None:
            lowest = min(lows.values())
            near = [body for body, low in lows.items() if low < lowest + _FOOT_REACH]
            # A shin whose foot stands there, too, is none.
            above = {name for body in near for name in self._ancestors(body)}
            return tuple(body for body in near if body not in above)
        feet = self._known(("feet",), self.settings.feet)
        for index, foot in enumerate(feet):
            if foot not in lows:
                raise self._fault(
                    ("feet", index), f"feet: nothing of {foot!r} collides", nearest(foot, lows)
                )
        return tuple(feet)

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
        return [str(self.model.geom(geom).name) for geom in own if self._collides(geom)]

    def _parts(self, key: tuple[str, ...], names: Sequence[str]) -> list[str]:
        """Return bodies, or geoms that collide, which the model has."""
        if self.settings.touches == "body":
            return self._known(key, names)
        geoms = [self.model.geom(g).name for g in range(self.model.ngeom) if self._collides(g)]
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
        found = {
            name: self._mounted(camera, ("cameras", name))
            for name, camera in self.settings.cameras.items()
        }
        return found if "ego" in found else {"ego": self._eye()} | found

    def _eye(self) -> CameraMount:
        eye = self.settings.eye
        if eye is None:
            return self._camera() or CameraMount(
                position=(self._front(), 0.0, 0.0), R_trunk_camera=_AHEAD, fovy=math.pi / 2
            )
        return self._mounted(Camera(**dict(eye)), ("eye",))

    def _mounted(self, camera: Camera, key: tuple[str, ...]) -> CameraMount:
        (body,) = self._known((*key, "body"), [camera.body or self.root])
        axes = np.array(_AHEAD if camera.rotation is None else camera.rotation)
        if np.abs(axes.T @ axes - np.eye(3)).max() > _TURN or np.linalg.det(axes) < 0.0:
            name = ".".join(key)
            raise self._fault((*key, "rotation"), f"{name}.rotation: it is no rotation")
        position = np.array(camera.position)
        if camera.pitch != 0.0:
            cosine, sine = math.cos(camera.pitch), math.sin(camera.pitch)
            axes = axes @ np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
        if body != self.root:
            T = self._in_root(body, (*key, "body"))
            axes, position = T[:3, :3] @ axes, T[:3, :3] @ position + T[:3, 3]
        return _mount(position, axes, math.radians(camera.fovy))

    def _camera(self) -> CameraMount | None:
        """Return the first camera of the model that nothing moves against the trunk."""
        for camera in range(self.model.ncam):
            body = self._body(int(self.model.cam_bodyid[camera]))
            fixed = self.model.cam_mode[camera] == mujoco.mjtCamLight.mjCAMLIGHT_FIXED
            if not fixed or not self._is_rigid(body):
                continue
            T = self._in_root(body, ())
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, self.model.cam_quat[camera])
            axes = R.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])  # OpenCV's, of MuJoCo's
            position = T[:3, :3] @ self.model.cam_pos[camera] + T[:3, 3]
            fovy = math.radians(float(self.model.cam_fovy[camera]))
            return _mount(position, T[:3, :3] @ axes, fovy)
        return None

    def _front(self) -> float:
        own = np.flatnonzero(self.model.geom_bodyid == self.model.body(self.root).id)
        reach = [float(self.model.geom_pos[g, 0] + self.model.geom_rbound[g]) for g in own.tolist()]
        return max(reach, default=0.1)

    def _is_rigid(self, body: str) -> bool:
        number, root = int(self.model.body(body).id), int(self.model.body(self.root).id)
        return bool(self.model.body_weldid[number] == self.model.body_weldid[root])

    def _in_root(self, body: str, key: tuple[str, ...]) -> Array:
        """Return T_root_body, (4, 4)."""
        if not self._is_rigid(body):
            raise self._fault(
                key,
                f"{'.'.join(key)}: joints move {body!r} against {self.root!r}",
                f"name {self.root!r}, or a body that is fixed to it",
            )
        root, own = self.data.body(self.root), self.data.body(body)
        R = root.xmat.reshape(3, 3)
        T = np.eye(4)
        T[:3, :3] = R.T @ own.xmat.reshape(3, 3)
        T[:3, 3] = R.T @ (own.xpos - root.xpos)
        return T

    def _visuals(self) -> tuple[Shape, ...]:
        """Return primitives that are drawn in logs: of a mesh, the box round it."""
        model = self.model
        geoms = range(model.ngeom)
        seen = [g for g in geoms if not self._collides(g)] or list(geoms)
        shapes: list[Shape] = []
        for geom in seen[:_MOST_SHAPES]:
            body = self._body(int(model.geom_bodyid[geom]))
            if body not in self.bodies:
                continue
            shapes += _shapes(model, geom, body)
        return tuple(shapes)

    def _mjcf(self, names: Sequence[str]) -> str:
        """Write the model with one actuator a joint, and groups by what collides and is seen."""
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
        for geom in self._geoms():
            number = int(self.model.geom(geom.name).id)
            geom.rgba, geom.material = self._rgba(number), ""
            if self._collides(number):
                geom.group = COLLISION_GROUP
            else:
                geom.group, geom.conaffinity = VISUAL_GROUP, 0
                geom.contype = 0 if self._is_flat(number) else _HIDDEN
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
            COLLISION_GROUP if self._collides(geom) else VISUAL_GROUP for geom in range(model.ngeom)
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
                f"groups of geoms are not {COLLISION_GROUP}, or {VISUAL_GROUP} where none collides",
                model.geom_group.tolist() == kinds,
            ),
        ):
            if not is_so:
                raise self._fault(("model", "as_written"), f"model.as_written: {what}", _REWRITE)
        fill_meshes(tree, self.folder)
        indent(tree)  # Comments of the file are gone, and left their lines empty.
        return tostring(tree, encoding="unicode")

    def _is_flat(self, geom: int) -> bool:
        """Whether a geom is a mesh in one plane: it has no hull, and needs none with contype 0."""
        model, mesh = self.model, int(self.model.geom_dataid[geom])
        if mesh < 0 or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            return False
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        points = model.mesh_vert[first : first + count].astype(np.float64)
        spread = np.linalg.eigvalsh(np.cov(points, rowvar=False))
        return bool(spread[0] < _FLAT * spread[2])

    def _geoms(self) -> list[Any]:
        return [geom for body in self.mjspec.bodies for geom in body.geoms]

    def _rgba(self, geom: int) -> list[float]:
        material = int(self.model.geom_matid[geom])
        rgba = self.model.geom_rgba[geom] if material < 0 else self.model.mat_rgba[material]
        return [float(value) for value in rgba]

    def _fault(
        self, place: tuple[str | int, ...], message: str, fix: str | None = None
    ) -> RobotError:
        words = f"{self.settings.model.file}: {message}" if place == ("model",) else message
        return RobotError([self.folder.file.problem(place, words, fix)])


def _first(error: Exception) -> str:
    return str(error).strip().splitlines()[0]


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


def _mount(position: Array, R: Array, fovy: float) -> CameraMount:
    x, y, z = position.tolist()
    rows = tuple((a, b, c) for a, b, c in R.tolist())
    return CameraMount(position=(x, y, z), R_trunk_camera=(rows[0], rows[1], rows[2]), fovy=fovy)


_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): ("sphere", 1),
    int(mujoco.mjtGeom.mjGEOM_BOX): ("box", 3),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): ("cylinder", 2),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
}


def _shapes(model: Any, geom: int, body: str) -> list[Shape]:
    """Return what a geom looks like, in the frame of its body."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom].tolist()
    position, turn = model.geom_pos[geom], tuple(model.geom_quat[geom].tolist())
    material = int(model.geom_matid[geom])
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    look: dict[str, Any] = {"body": body, "quat": turn, "rgba": _decimals(rgba)}
    if kind in _KINDS:
        name, count = _KINDS[kind]
        at = tuple(position.tolist())
        return [Shape(kind=name, size=tuple(size[:count]), position=at, **look)]  # pyright: ignore[reportArgumentType]
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
    R = turned.reshape(3, 3)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        radius, half = size[:2]
        ends = [tuple((position + R[:, 2] * end).tolist()) for end in (half, -half)]
        tube = Shape(
            kind="cylinder", size=(radius, half), position=tuple(position.tolist()), **look
        )
        return [tube, *(Shape(kind="sphere", size=(radius,), position=end, **look) for end in ends)]
    middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    at = tuple((position + R @ middle).tolist())
    return [Shape(kind="box", size=tuple(half.tolist()), position=at, **look)]
