"""A robot's model file as MuJoCo compiles it: one body with a free joint, and names for all parts.

MuJoCo compiles the model once to say what is in it. `derived` and `looks` read the compiled model,
and so does what says here where the robot's cameras and its IMU are, if `robot.yaml` does not.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar
from xml.etree.ElementTree import Element, ParseError, SubElement, fromstring, tostring

import mujoco as _mujoco
import numpy as np
import numpy.typing as npt

from nw_base.errors import RobotError, nearest
from nw_scenes.robots.account import Account
from nw_scenes.robots.folder import RobotFolder, element_lines, fill_meshes
from nw_scenes.robots.robot_file import Camera
from nw_scenes.robots.spec import CameraMount, ImuMount, Vector3

# Its classes live in compiled modules without type information.
mujoco: Any = _mujoco

MOST_JOINTS, MOST_BODIES, MOST_GEOMS = 100, 300, 2_000
"""Of a robot."""

_INDEPENDENT = 0.5  # volume of three unit axes
_LIGHTEST, _HEAVIEST = 0.1, 2_000.0  # kg
_T = TypeVar("_T")


@dataclass
class Shared:
    """What robots of one model file have in common, whatever their robot.yaml says.

    To compile a model and to write it out take seconds; drafts do it with several robot.yaml.

    Attributes:
        parts: by what they are made of.
    """

    parts: dict[Hashable, Any] = field(default_factory=dict[Hashable, Any])

    def get(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return a part; make it on first use."""
        if key not in self.parts:
            self.parts[key] = make()
        return self.parts[key]


@dataclass(frozen=True)
class _Compiled:
    """A model in which everything has a name, before anything of robot.yaml is in it."""

    mjspec: Any
    model: Any
    masks: list[tuple[int, int]]
    solid: set[str]
    before: int
    after: int
    account: Account
    notes: list[str]


class CompiledRobot:
    """A model file, parsed and compiled.

    Args:
        folder: of the robot.
        shared: with other robots of its model file; None = with none.

    Attributes:
        folder, settings: where it comes from, and its robot.yaml.
        mjspec: MuJoCo's editable model, in which everything has a name.
        model, data: compiled from it.
        root, root_joint: names of the body with the free joint, and of that joint.
        bodies: names of all, parents before children.
        before, after: how many numbers of a keyframe belong to bodies that were left out.
        solid: names of the geoms that touch ground or another geom.

    Raises:
        RobotError: MuJoCo cannot read or compile it, or it is not a robot.
    """

    def __init__(self, folder: RobotFolder, shared: Shared | None = None) -> None:
        self.folder = folder
        self.settings = folder.settings
        self.shared = shared or Shared()
        self._text = ""
        self.masks: list[tuple[int, int]] = []
        self.solid: set[str] = set()
        model = self.settings.model
        kept = self.shared.get((folder.model_digest, model.file), self._compiled)
        # A model that is not shared may be changed. A copy takes as much memory again.
        self.mjspec: Any = kept.mjspec if shared is None else kept.mjspec.copy()
        self.model: Any = kept.model
        self.masks, self.solid = kept.masks, kept.solid
        self.before, self.after = kept.before, kept.after
        folder.account.update(kept.account)
        folder.notes[:] = dict.fromkeys((*folder.notes, *kept.notes))
        self.data: Any = mujoco.MjData(self.model)
        self.root = self._root()
        self._weigh()
        self.bodies = [self.body_name(i) for i in range(1, self.model.nbody)]

    def _compiled(self) -> _Compiled:
        self.mjspec = self._parsed()
        self._tidy()
        return _Compiled(
            mjspec=self.mjspec,
            model=self.compiled(self.mjspec),
            masks=self.masks,
            solid=self.solid,
            before=self.before,
            after=self.after,
            account=deepcopy(self.folder.account),
            notes=[*self.folder.notes],
        )

    def _parsed(self) -> Any:
        model = deepcopy(self.folder.model)
        try:
            if model.tag == "robot":
                model = self._converted(model)
            fill_meshes(model, self.folder)
            self._text = tostring(model, encoding="unicode")
            return mujoco.MjSpec.from_string(self._text)
        except (ValueError, RuntimeError, ParseError) as error:
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
        if line == 1 and placed is not None and self._text:
            # MuJoCo counts the lines of the text that it was given.
            read = element_lines(self._text.encode())
            starts = [begin for event, _, begin in read if event == "start"]
            elements = list(self.folder.model.iter())
            if len(starts) == len(elements) and int(placed[1]) in starts:
                line = self.folder.lines[elements[starts.index(int(placed[1]))]]
        return self.folder.fault(f"{what}: {message}", line=line)

    def _converted(self, urdf: Element) -> Element:
        """Return a URDF as MJCF."""
        own: dict[str, str] = {}
        for each in urdf.findall("mujoco"):
            urdf.remove(each)
            own |= {k: v for part in each.findall("compiler") for k, v in part.attrib.items()}
        options = own | {"strippath": "true", "fusestatic": "false", "discardvisual": "false"}
        compiler = SubElement(SubElement(urdf, "mujoco"), "compiler", options)
        compiler.attrib.pop("meshdir", None)
        tried = 0
        while True:
            try:
                spec = self._read_urdf(urdf)
                break
            except ValueError as error:
                said, *about = str(error).strip().splitlines()
                name = (re.findall(r"name '([^']+)'", " ".join(about)) or ["?"])[0]
                if self._is_mended(said, name, urdf, compiler):
                    continue
                if tried or next(urdf.iter("visual"), None) is None:
                    raise
                tried = 1  # What is wrong without its looks, is.
                for link in urdf.iter("link"):
                    for visual in link.findall("visual"):
                        link.remove(visual)
                self.folder.notes.append(f"its <visual> are not drawn: MuJoCo says {said}")
        model = fromstring(spec.to_xml())  # noqa: S314 - MuJoCo's own text.
        for each in model.findall("compiler"):
            for key in ("meshdir", "texturedir", "strippath"):
                each.attrib.pop(key, None)
        return model

    def _is_mended(self, said: str, name: str, urdf: Element, compiler: Element) -> bool:
        """Give a link an inertia that a body can have, where MuJoCo refuses its own; or do not."""
        line = self.folder.line_of(name, "body")
        if "balanceinertia" in said and compiler.get("balanceinertia") != "true":
            compiler.set("balanceinertia", "true")
            self.folder.account.loses(
                f"inertia of <link {name}>, and others: no body has it, as A + B < C; the mean of "
                "the three is taken",
                line,
            )
            return True
        if "positive eigenvalues" not in said:
            return False
        # Slips: 0.001 for each of the six numbers of a hatch, 0.015 for 0.00015; or -5e-20 for 0.
        products: dict[str, str] = {"ixy": "0", "ixz": "0", "iyz": "0"}
        links = [each for each in urdf.iter("link") if each.get("name") == name]
        for link in links:
            for each in link.iter("inertia"):
                if each.attrib | products != each.attrib:
                    each.attrib.update(products)
                    why = "ixy, ixz and iyz of <link {}>: impossible with its ixx, iyy and izz"
                elif (ball := _ball(link)) != each.attrib:
                    each.attrib.update(ball)
                    why = "inertia of <link {}>: not positive; that of a ball of 2 cm is used"
                else:
                    continue
                self.folder.account.loses(why.format(name), line)
                return True
        return False

    def _read_urdf(self, urdf: Element) -> Any:
        text = tostring(urdf, encoding="unicode")
        spec = mujoco.MjSpec.from_string(text, assets=self.folder.meshes)
        spec.compile()
        return spec

    def compiled(self, spec: Any) -> Any:
        """Compile a model.

        Raises:
            RobotError: MuJoCo cannot, or it has too many parts.
        """
        try:
            model = spec.compile()
        except (ValueError, RuntimeError) as error:
            raise self._refused("MuJoCo cannot compile it", error) from None
        for what, count, most in (
            ("bodies", model.nbody, MOST_BODIES),
            ("joints", model.njnt, MOST_JOINTS),
            ("geoms", model.ngeom, MOST_GEOMS),
        ):
            if count > most:
                raise self.fault(("model",), f"it has {count} {what}, over {most}")
        return model

    def _tidy(self) -> None:
        """Leave the floor out, give everything a name, and one root a free joint."""
        spec = self.mjspec
        world = spec.worldbody
        tops = list(world.bodies)
        moving = [place for place, body in enumerate(tops) if _has_joints(body)]
        if len(moving) > 1:
            # Some files keep bodies of joints that are locked beside the robot (Unitree's g1, h1).
            moving = [place for place in moving if _is_free(tops[place])] or moving
        if len(moving) > 1 or not tops:
            names = ", ".join(tops[place].name or "?" for place in moving) or "none"
            raise self.fault(("model",), f"it must have one body at the top, and has {names}")
        place = moving[0] if moving else 0
        root, others = tops[place], [*tops[:place], *tops[place + 1 :]]
        # Keyframes have the numbers of the bodies that are left out, too.
        self.before = sum(map(_coordinates, tops[:place]))
        self.after = sum(map(_coordinates, tops[place + 1 :]))
        fixed = [body for body in others if not _has_joints(body)]
        self._meet_ground(root, [*world.geoms, *(g for body in fixed for g in _geoms(body))])
        for body in others:
            if body not in fixed:
                self.folder.account.loses(
                    f"body {body.name!r} beside the robot, with its joints and motors, is left out",
                    self.folder.line_of(body.name, "body"),
                )
            spec.delete(body)
        for kind in ("geoms", "sites", "cameras"):
            for each in list(getattr(world, kind)):
                self.folder.account.passes(f"{kind} of the world", "scenes have their own")
                spec.delete(each)
        if not _is_free(root):
            self._free(root)
        self._name()
        paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
        self.solid = {g.name for g in self.geoms() if g.contype or g.conaffinity} | paired

    def _free(self, root: Any) -> None:
        """Give a root a free joint, in place of joints that together move it as one does."""
        joints, kinds = list(root.joints), mujoco.mjtJoint
        slides = [j.axis for j in joints if j.type == kinds.mjJNT_SLIDE]
        hinges = [j.axis for j in joints if j.type == kinds.mjJNT_HINGE]
        turns = len(joints) == 4 and joints[-1].type == kinds.mjJNT_BALL
        turns = turns or (len(joints) == 6 and _is_basis(hinges))
        if joints and not (turns and _is_basis(slides)):
            raise self.fault(("model",), f"its top body {root.name!r} has joints that are not free")
        for joint in joints:
            for what in ("damping", "armature", "frictionloss", "stiffness"):
                if np.any(getattr(joint, what)):
                    self.folder.account.loses(f"{what} of the joints that move the root freely")
            self.mjspec.delete(joint)
        root.add_freejoint()

    def _meet_ground(self, root: Any, ground: Sequence[Any]) -> None:
        """Let the geoms that touch ground of the file touch that of scenes, and no others.

        Two geoms touch if a bit of the one's contype is in the other's conaffinity, if neither
        their bodies are an <exclude> nor they are a <pair>; ground of scenes has 1 in both. Masks
        that say the same of it stay as they are. Else bit 0 stands for ground, and theirs follow.
        """
        spec, geoms = self.mjspec, _geoms(root)
        floors = [
            (g.contype, g.conaffinity, g.parent.name) for g in ground if g.contype or g.conaffinity
        ] or [(1, 1, "world")]
        apart = {frozenset((each.bodyname1, each.bodyname2)) for each in spec.excludes}
        names, own = {g.name for g in ground if g.name}, {g.name for g in geoms if g.name}
        paired: set[str] = set()
        for pair in list(spec.pairs):
            ends = {pair.geomname1, pair.geomname2}
            if ends & names:
                paired |= ends & own
            if not ends <= own:
                spec.delete(pair)
        if paired:
            self.folder.account.loses(
                f"<pair> of ground and {', '.join(sorted(paired))}: they touch, with the friction "
                "and the solver's parameters of their geoms"
            )
        bodies = {"world", *(body.name for body in (root, *_below(root)))}
        for each in list(spec.excludes):
            if not {each.bodyname1, each.bodyname2} <= bodies:
                spec.delete(each)
        touches = [
            geom.name in paired
            or any(
                (geom.contype & affinity or kind & geom.conaffinity)
                and frozenset((geom.parent.name, body)) not in apart
                for kind, affinity, body in floors
            )
            for geom in geoms
        ]
        self.masks = sorted({(g.contype, g.conaffinity) for g in geoms})
        _mask(geoms, touches)

    def _name(self) -> None:
        """Give all parts names, and let defaults of the file act on nothing that is added."""
        spec = self.mjspec
        plain = mujoco.MjSpec()
        for kind in ("geom", "joint", "actuator"):
            theirs, own = getattr(plain.default, kind), getattr(spec.default, kind)
            for name in set(dir(own)) - _NO_DEFAULT:
                if not name.startswith(("_", "set_")):
                    setattr(own, name, getattr(theirs, name))
        for kind, parts in (("body", spec.bodies), ("joint", spec.joints), ("geom", self.geoms())):
            taken = {part.name for part in parts}
            for number, part in enumerate(parts):
                part.name = part.name or _free_name(f"{kind}_{number}", taken)

    def _root(self) -> str:
        free = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        if len(free) != 1:
            raise self.fault(("model",), f"it has {len(free)} free joints; a robot has one")
        self.root_joint = str(self.model.joint(int(free[0])).name)
        root = self.body_name(int(self.model.jnt_bodyid[free[0]]))
        if self.settings.root is not None and self.settings.root != root:
            raise self.fault(("root",), f"root: the free joint is that of {root!r}")
        return root

    def _weigh(self) -> None:
        masses = self.model.body_mass
        total, most = float(masses.sum()), self.body_name(int(masses.argmax()))
        if not _LIGHTEST <= total <= _HEAVIEST:
            raise self.folder.fault(
                f"the robot weighs {total:.4g} kg, of which {most!r} has {masses.max():.4g} kg; "
                f"{_LIGHTEST:g} to {_HEAVIEST:,.0f} kg are simulated",
                'masses are in kg; a mesh in millimetres needs scale="0.001 0.001 0.001"',
                self.folder.line_of(most, "body"),
            )

    def body_name(self, number: int) -> str:
        """Return the name of a body of `model`."""
        return str(self.model.body(number).name)

    def joint_names(self, joints: Sequence[int]) -> list[str]:
        """Return the names of joints of `model`."""
        return [str(self.model.joint(joint).name) for joint in joints]

    def known(
        self,
        key: tuple[str, ...],
        names: Sequence[str],
        kind: str = "body",
        known: Sequence[str] | None = None,
    ) -> list[str]:
        """Return names of robot.yaml that the model has.

        Args:
            key: where in robot.yaml they are.
            names: what is written there.
            kind: what they name.
            known: all that there are; None = the bodies.

        Raises:
            RobotError: there is none of a name, or one is there twice.
        """
        where = ".".join(key)
        known = self.bodies if known is None else known
        for index, name in enumerate(names):
            if name not in known:
                raise self.fault(
                    (*key, index), f"{where}: no {kind} {name!r}", nearest(name, known)
                )
            if name in names[:index]:
                raise self.fault((*key, index), f"{where}: {name!r} is named twice")
        return list(names)

    def geoms(self) -> list[Any]:
        """Return all geoms of `mjspec`."""
        return [geom for body in self.mjspec.bodies for geom in body.geoms]

    def fault(
        self, place: tuple[str | int, ...], message: str, fix: str | None = None
    ) -> RobotError:
        """Return an error about robot.yaml.

        Args:
            place: the key that it is about; `("model",)` = the model file.
            message: what is wrong.
            fix: what helps.
        """
        words = f"{self.settings.model.file}: {message}" if place == ("model",) else message
        return RobotError([self.folder.file.problem(place, words, fix)])


_OWN = "id name classname parent frame signature info compiler alt plugin"
_NO_DEFAULT = frozenset(_OWN.split())
"""Of a part of MuJoCo's editable model: what no class of defaults sets."""


def _mask(geoms: Sequence[Any], touches: Sequence[bool]) -> None:
    """Write masks of which bit 0 says what touches ground; none for what touches nothing."""
    masks = [g.contype | g.conaffinity for g in geoms]
    if [bool(mask & 1) for mask in masks] != [*touches]:
        bits = [bit for bit in range(32) if any(mask >> bit & 1 for mask in masks)]
        for geom, touch in zip(geoms, touches, strict=True):
            kind, affinity = (
                sum(2 << n for n, bit in enumerate(bits) if mask >> bit & 1)
                for mask in (geom.contype, geom.conaffinity)
            )
            geom.contype, geom.conaffinity = kind | touch, affinity
    kinds = affinities = 0
    for geom in geoms:
        kinds, affinities = kinds | geom.contype, affinities | geom.conaffinity
    for geom, touch in zip(geoms, touches, strict=True):
        if not (touch or geom.contype & affinities or kinds & geom.conaffinity):
            geom.contype = geom.conaffinity = 0


def _below(body: Any) -> list[Any]:
    return [part for child in body.bodies for part in (child, *_below(child))]


def _geoms(body: Any) -> list[Any]:
    return [geom for part in (body, *_below(body)) for geom in part.geoms]


def _free_name(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _is_free(body: Any) -> bool:
    return any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)


def _is_basis(axes: Sequence[Any]) -> bool:
    """Whether motions along or about three axes make up all of space."""
    return len(axes) == 3 and abs(np.linalg.det(np.array(axes))) > _INDEPENDENT


def _coordinates(body: Any) -> int:
    """Return how many numbers of a keyframe a body and those below it have."""
    sizes = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
    own = sum(sizes.get(joint.type, 1) for joint in body.joints)
    return own + sum(map(_coordinates, body.bodies))


def _has_joints(body: Any) -> bool:
    return bool(list(body.joints)) or any(_has_joints(child) for child in body.bodies)


Array = npt.NDArray[np.float64]

_AHEAD = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
_TURN = 1e-6  # by which a rotation may miss
_CAMERA = re.compile(r"[A-Za-z0-9][\w.-]{0,63}", re.ASCII)  # name of a camera


class Mounts:
    """Finds what is mounted on a robot.

    Args:
        robot: in the pose in which it stands.
    """

    def __init__(self, robot: CompiledRobot) -> None:
        self.robot = robot
        self.settings = robot.settings
        self.model, self.data = robot.model, robot.data

    def cameras(self) -> dict[str, CameraMount]:
        """Return `ego`, then the other cameras of robot.yaml and of the model, by name."""
        settings = self.settings.cameras
        said = {name: self._mounted(eye, ("cameras", name)) for name, eye in settings.items()}
        if self.settings.eye is not None:
            if "ego" in said:
                raise self.robot.fault(
                    ("cameras", "ego"), "cameras: `eye` is `ego`, too", "remove one"
                )
            eye = self.settings.eye
            keys = {key: getattr(eye, key) for key in eye.model_fields_set}
            said["ego"] = self._mounted(Camera(**keys), ("eye",))
        own: dict[str, CameraMount] = {}
        for camera in range(self.model.ncam):
            name = str(self.model.camera(camera).name)
            mount = self._camera(camera)
            if mount is not None and _CAMERA.fullmatch(name):
                own[name] = mount
        first = self.first_camera()
        ego = (
            said.get("ego")
            or (None if first is None else first[1])
            or CameraMount(
                position=(self._front(), 0.0, 0.0), R_trunk_camera=_AHEAD, fovy=math.pi / 2
            )
        )
        return {"ego": ego} | {k: v for k, v in (own | said).items() if k != "ego"}

    def imu(self) -> ImuMount | None:
        """Return where the IMU of robot.yaml is; None = it is the root's own frame."""
        imu = self.settings.imu
        if imu is None:
            return None
        if imu.site is not None:
            sites = [str(self.model.site(number).name) for number in range(self.model.nsite)]
            if imu.site not in sites:
                fix = (
                    nearest(imu.site, sites) if sites else "name a body: {body: ..., position: ...}"
                )
                raise self.robot.fault(("imu", "site"), f"imu: no site {imu.site!r}", fix)
            number = sites.index(imu.site)
            body = self.robot.body_name(int(self.model.site_bodyid[number]))
            position, quaternion = self.model.site_pos[number], self.model.site_quat[number]
        else:
            (body,) = self.robot.known(("imu", "body"), [imu.body or self.robot.root])
            position, quaternion = np.array(imu.position), imu.quaternion
        carrier, T = self._carried(body)
        R = T[:3, :3] @ self._turn(quaternion, ("imu",))
        x, y, z = (T[:3, :3] @ position + T[:3, 3]).tolist()
        return ImuMount(body=carrier, position=(x, y, z), R_body_imu=_rows(R))

    def first_camera(self) -> tuple[str, CameraMount] | None:
        """Return the first camera of the model that nothing moves against the trunk, by name."""
        for camera in range(self.model.ncam):
            mount = self._camera(camera)
            if mount is not None and not mount.body:
                return str(self.model.camera(camera).name) or "camera without a name", mount
        return None

    def _mounted(self, camera: Camera, key: tuple[str, ...]) -> CameraMount:
        (body,) = self.robot.known((*key, "body"), [camera.body or self.robot.root])
        if camera.rotation is None:
            cosine, sine = math.cos(camera.pitch), math.sin(camera.pitch)
            turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
            axes = self._turn(camera.quaternion, key) @ np.array(_AHEAD) @ turn
        else:
            axes = np.array(camera.rotation)
            if np.abs(axes.T @ axes - np.eye(3)).max() > _TURN or np.linalg.det(axes) < 0.0:
                message = f"{'.'.join(key)}.rotation: it is not a rotation"
                fix = "give rows of length 1, square to each other, of a right-handed frame"
                raise self.robot.fault((*key, "rotation"), message, fix)
        position, fovy = np.array(camera.position), math.radians(camera.fovy)
        if body == self.robot.root:  # Its numbers are taken as they are written, to the last bit.
            mount = _mount(position, axes, fovy, "")
        else:
            carrier, T = self._carried(body)
            mount = _mount(T[:3, :3] @ position + T[:3, 3], T[:3, :3] @ axes, fovy, carrier)
        lens = camera.intrinsics
        mount = replace(mount, readout=camera.readout, exposure=camera.exposure)
        return mount if lens is None else mount.with_intrinsics(lens)

    def _turn(self, quaternion: Sequence[float], key: tuple[str, ...]) -> Array:
        """Return the rotation of a quaternion, (3, 3)."""
        length = float(np.linalg.norm(quaternion))
        if not 0.9 < length < 1.1:
            message = f"{'.'.join(key)}: a quaternion of length {length:g}"
            raise self.robot.fault((*key, "quaternion"), message, "give w x y z of length 1")
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, np.array(quaternion, dtype=np.float64) / length)
        return R.reshape(3, 3)

    def _camera(self, camera: int) -> CameraMount | None:
        """Return a camera of the model; None if it is not fixed to its body."""
        if self.model.cam_mode[camera] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            return None
        carrier, T = self._carried(self.robot.body_name(int(self.model.cam_bodyid[camera])))
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, self.model.cam_quat[camera])
        axes = R.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])  # OpenCV's, of MuJoCo's
        position = T[:3, :3] @ self.model.cam_pos[camera] + T[:3, 3]
        fovy = math.radians(float(self.model.cam_fovy[camera]))
        return _mount(position, T[:3, :3] @ axes, fovy, carrier)

    def _front(self) -> float:
        own = np.flatnonzero(self.model.geom_bodyid == self.model.body(self.robot.root).id)
        reach = [float(self.model.geom_pos[g, 0] + self.model.geom_rbound[g]) for g in own.tolist()]
        return max(reach, default=0.1)

    def _is_rigid(self, body: str) -> bool:
        number, root = int(self.model.body(body).id), int(self.model.body(self.robot.root).id)
        return bool(self.model.body_weldid[number] == self.model.body_weldid[root])

    def _carried(self, body: str) -> tuple[str, Array]:
        """Return what carries things on a body, and T_carrier_body, (4, 4).

        That is the root ("") where no joint moves the body against it, else the body itself.
        """
        T = np.eye(4)
        if not self._is_rigid(body):
            return body, T
        root, own = self.data.body(self.robot.root), self.data.body(body)
        R = root.xmat.reshape(3, 3)
        T[:3, :3] = R.T @ own.xmat.reshape(3, 3)
        T[:3, 3] = R.T @ (own.xpos - root.xpos)
        return "", T


def _mount(position: Array, R: Array, fovy: float, body: str) -> CameraMount:
    x, y, z = position.tolist()
    return CameraMount(position=(x, y, z), R_trunk_camera=_rows(R), fovy=fovy, body=body)


def _rows(R: Array) -> tuple[Vector3, Vector3, Vector3]:
    one, two, three = ((a, b, c) for a, b, c in R.tolist())
    return one, two, three


def _ball(link: Element) -> dict[str, str]:
    """Return the inertia of a ball of a link's mass whose radius is 1 cm: 2/5 m r^2."""
    mass = next((float(each.get("value", "0")) for each in link.iter("mass")), 0.0)
    size = f"{max(0.4 * mass * 0.01**2, 1e-9):.9g}"
    axes: dict[str, str] = dict.fromkeys(("ixx", "iyy", "izz"), size)
    return {**axes, "ixy": "0", "ixz": "0", "iyz": "0"}
