"""A robot as a folder: `robot.yaml` beside an MJCF or URDF file and its meshes.

What the model file says is derived from it; `robot.yaml` says the rest, and overrides. The folder
may be a stranger's: its XML is checked element by element and its meshes are read here, so that
MuJoCo's compiler sees neither a path nor a plug-in. Here the files are read; `derived` asks MuJoCo
what is in them, and makes a `RobotSpec` whose MJCF holds everything.
"""

from __future__ import annotations

import hashlib
import io
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, cast
from xml.etree.ElementTree import Element, ParseError, XMLPullParser

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from nw_eval.errors import Problem, RobotError
from nw_eval.files.inside import OutsideError, bounded_bytes, inside
from nw_eval.files.yaml_file import YamlFile, YamlProblems, read_yaml, validation_problems

Array = npt.NDArray[np.float64]

ROBOT_FILE = "robot.yaml"

XML_BYTES = 2**22
ELEMENTS, DEPTH = 20_000, 100
MESHES, MESH_BYTES, MESHES_BYTES = 500, 2**26, 2**28
FACES, ALL_FACES = 200_000, 1_000_000
"""What a folder may hold: of the model file, of one mesh, of all of them."""

# Elements that say nothing about the body, and those of URDF that MuJoCo does not read or that
# show what is only seen.
_LEFT_OUT = frozenset(
    {
        *("option", "size", "visual", "statistic", "custom", "sensor", "texture", "light"),
        *("keyframe", "transmission", "gazebo", "dynamics", "safety_controller", "calibration"),
    }
)
_MJCF = """mujoco compiler default asset mesh material worldbody body frame inertial joint freejoint
    geom site camera contact pair exclude equality connect weld tendon fixed spatial actuator
    general motor position velocity intvelocity damper"""
_URDF = """robot link collision geometry box sphere cylinder origin mass inertia parent child axis
    limit mimic color"""
_KNOWN = frozenset([*_MJCF.split(), *_URDF.split()])
_FARTHEST = 1e5  # of a mesh's numbers, before its scale
_PATHS = frozenset(
    {
        *("file", "meshdir", "texturedir", "assetdir", "strippath", "content_type"),
        *("discardvisual", "fusestatic"),
    }
)


class _Part(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )


Name = Annotated[str, Field(min_length=1, max_length=200)]
Names = Annotated[list[Name], Field(max_length=200)]
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


class ModelFile(_Part):
    """The file that describes the body."""

    file: Name
    """MJCF (`.xml`) or URDF (`.urdf`), in the folder; its meshes lie beside it."""
    sha256: str | None = None
    """Hex digest that the file must have; None = whatever lies there."""


class Motors(_Part):
    """What the joints of a group have in place of what the model file says."""

    joints: Name | Names
    """Patterns of joint names, such as `*_hip_joint` or `*`."""
    follows: Literal["position", "velocity"] | None = None
    """What the motor is told. A wheel follows `velocity`: its torque is kd * (target - velocity),
    within `torque`. None = as the model file says, else `position`."""
    kp: NotNegative | None = None
    """Gain, N m / rad."""
    kd: NotNegative | None = None
    """Damping, N m s / rad, in place of the joint's own; of motors that follow velocities their
    gain."""
    torque: Positive | None = None
    """Largest torque, N m."""
    armature: NotNegative | None = None
    """kg m^2."""
    friction: NotNegative | None = None
    """Friction loss, N m."""


class Fell(_Part):
    """When the robot has fallen."""

    tilt: Annotated[float, Field(gt=0.0, le=math.pi)] = 1.2
    """Roll or pitch of the root, rad."""
    height: Positive | None = None
    """Height of the root above the ground under it, m, below which it fell; null = no limit."""


class Collided(_Part):
    """When the robot has collided."""

    force: Positive = 0.08
    """Force on one part of `body`, in times the robot's weight."""


Quaternion = tuple[float, float, float, float]


class Eye(_Part):
    """A camera, which looks along x of its body unless it is turned."""

    body: Name | None = None
    """None = the root. With a body that joints move, it moves, too."""
    position: tuple[float, float, float]
    """In the body, m."""
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Turn of a frame whose x axis it looks along, y to the left, in the body: w x y z."""
    pitch: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Angle by which it looks down from there, rad."""
    fovy: Annotated[float, Field(gt=1.0, lt=179.0)] = 90.0
    """Vertical field of view, degrees."""


class Imu(_Part):
    """Where angular velocity, gravity and acceleration are measured."""

    site: Name | None = None
    """A site of the model, with its place and its axes."""
    body: Name | None = None
    """Else a body; None = the root."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """In the body, m."""
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Turn of its axes in the body, w x y z."""

    @model_validator(mode="after")
    def _one_place(self) -> Imu:
        if self.site is not None and self.model_fields_set - {"site"}:
            raise ValueError("a site has its place and axes; remove `site`, or all else")
        return self


CameraName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]


class RobotFile(_Part):
    """`robot.yaml`: what a model file does not say about a robot, or says otherwise."""

    schema_version: Literal[1] = Field(alias="nw-robot")
    """Version of this kind of file."""
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,63}$")]
    """What cards and reports call the robot."""
    model: ModelFile
    root: Name | None = None
    """The body with the free joint, which is the trunk; derived."""
    feet: Annotated[Names, Field(min_length=1)] | None = None
    """Bodies, in the order that cards may use; derived: those lowest in the pose."""
    pose: Name | dict[Name, float] | None = None
    """A keyframe of the model, or angles (rad) by patterns of joint names; what is not named is 0,
    or the nearest in its range. None = the keyframe `home`, if there is one."""
    motors: list[Motors] = Field(default_factory=list[Motors], max_length=200)
    """A later group wins."""
    body: Names | None = None
    """Bodies whose contact is `collided`; [] = none. None = the root."""
    fell: Fell = Fell()
    collided: Collided = Collided()
    eye: Eye | None = None
    """The camera `ego`. None = the model's first camera on the trunk, or one at its front."""
    cameras: dict[CameraName, Eye] = Field(default_factory=dict[str, Eye], max_length=16)
    """Cameras by the names that cards call them, beside those of the model that have a name."""
    imu: Imu | None = None
    """None = the root's own frame."""
    spawn_height: Positive | None = None
    """Of the root's origin above the ground at the start, m; derived."""


_NOT_FINITE = {sign + word for sign in ("", "+", "-") for word in ("nan", "inf", "infinity")}


@dataclass(frozen=True, kw_only=True)
class RobotFolder:
    """A folder that was read, and nothing of it derived yet.

    Attributes:
        path: of the folder, absolute.
        file: robot.yaml with the places of its settings.
        settings: the same, valid in itself.
        model: the root of the model file, without what is left out.
        meshes: bytes of the meshes, by the names that stand in it now.
        names: of the meshes' files, by these names.
        poses: joint positions of its keyframes by name, as they are written.
        files: names of all files that were read.
        digest: hex SHA-256 of their names and bytes.
    """

    path: Path
    file: YamlFile
    settings: RobotFile
    model: Element
    meshes: dict[str, bytes]
    names: dict[str, str]
    poses: dict[str, str]
    files: tuple[str, ...]
    digest: str

    def fault(self, message: str, fix: str | None = None) -> RobotError:
        """Return an error about the model file."""
        where = str(self.path / self.settings.model.file)
        return RobotError([Problem(file=where, line=1, column=1, message=message, fix=fix)])


def read_folder(folder: Path) -> RobotFolder:
    """Read a robot's folder.

    Raises:
        RobotError: what is wrong with it, with file, line and column.
    """
    path = folder / ROBOT_FILE
    try:
        file = read_yaml(path)
    except YamlProblems as error:
        raise RobotError(error.problems) from None
    try:
        settings = RobotFile.model_validate(file.data)
    except ValidationError as error:
        raise RobotError(validation_problems(error, file, RobotFile)) from None
    reader = _Reader(folder, file)
    reader.take(ROBOT_FILE, path.read_bytes())
    model = reader.xml(settings.model)
    keys = enumerate(model.iter("key"))
    poses = {key.get("name", f"key {number}"): key.get("qpos", "") for number, key in keys}
    reader.tidy(model)
    return RobotFolder(
        path=folder.resolve(),
        file=file,
        settings=settings,
        model=model,
        meshes=reader.meshes,
        names=reader.names,
        poses=poses,
        files=tuple(reader.seen),
        digest=reader.digest,
    )


@dataclass
class _Reader:
    """Reads the files of a folder, none of which lies outside it."""

    folder: Path
    file: YamlFile
    seen: dict[str, str] = field(default_factory=dict[str, str])
    """SHA-256 by name."""
    meshes: dict[str, bytes] = field(default_factory=dict[str, bytes])
    names: dict[str, str] = field(default_factory=dict[str, str])
    where: str = ""

    @property
    def digest(self) -> str:
        """Of all that was read."""
        text = "".join(f"{name}\0{self.seen[name]}\n" for name in sorted(self.seen))
        return hashlib.sha256(text.encode()).hexdigest()

    def take(self, name: str, content: bytes) -> bytes:
        """Let a file count for the digest."""
        self.seen[name] = hashlib.sha256(content).hexdigest()
        return content

    def read(self, name: str, most: int) -> bytes:
        """Return the bytes of a file.

        Raises:
            FileNotFoundError: there is none.
            ValueError: what is wrong with it.
        """
        try:
            return self.take(name, bounded_bytes(inside(self.folder, name), most))
        except FileNotFoundError:
            raise
        except OutsideError as error:
            message = f"{name!r} leaves the folder: {error}"
        except OSError as error:
            message = f"{name!r}: {error.strerror}"
        except ValueError as error:
            message = f"{name!r}: {error}"
        raise ValueError(message)

    def xml(self, model: ModelFile) -> Element:
        """Return the root of the model file."""
        self.where = str(self.folder / model.file)
        try:
            content = self.read(model.file, XML_BYTES)
        except FileNotFoundError:
            message = f"model.file: there is no file {model.file!r} in the folder"
            raise RobotError([self.file.problem(("model", "file"), message)]) from None
        except ValueError as error:
            problem = self.file.problem(("model", "file"), f"model.file: {error}")
            raise RobotError([problem]) from None
        found = self.seen[model.file]
        if model.sha256 is not None and model.sha256.lower() != found:
            message = f"model.sha256: that of {model.file} is {found}"
            problem = self.file.problem(("model", "sha256"), message, "write it, if that is meant")
            raise RobotError([problem])
        self._content = content
        return self._tree(content)

    def fault(self, message: str, fix: str | None = None, line: int = 1) -> RobotError:
        """Return an error about the model file."""
        return RobotError([Problem(file=self.where, line=line, column=1, message=message, fix=fix)])

    def _tree(self, content: bytes) -> Element:
        if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
            raise self.fault("it declares a document type or entities", "remove them")
        parser = XMLPullParser(("start", "end"))
        count = depth = 0
        root: Element | None = None
        try:
            parser.feed(content)
            parser.close()
            for event, element in cast("Any", parser.read_events()):
                depth += 1 if event == "start" else -1
                count += event == "start"
                root = element if root is None else root
                if count > ELEMENTS or depth > DEPTH:
                    raise self.fault(f"it has over {ELEMENTS} elements, or {DEPTH} in each other")
        except ParseError as error:
            raise self.fault(f"it is not XML: {error}", line=error.position[0]) from None
        except (ValueError, LookupError) as error:  # An encoding that the parser does not know.
            raise self.fault(f"it cannot be read: {error}", "write it in UTF-8") from None
        if root is None or root.tag not in {"mujoco", "robot"}:
            tag = "nothing" if root is None else f"<{root.tag}>"
            raise self.fault(f"it begins with {tag}", "give an MJCF (<mujoco>) or a URDF (<robot>)")
        return root

    def tidy(self, root: Element) -> None:
        """Leave out what a body does not need, and read the meshes."""
        self._check(root)
        compiler = {k: v for each in root.iter("compiler") for k, v in each.attrib.items()}
        if root.tag == "mujoco":
            self._mjcf_meshes(root, compiler)
        else:
            self._urdf_meshes(root)
        for element in root.iter():
            if element.tag != "mesh":
                for key in _PATHS & set(element.attrib):
                    del element.attrib[key]
            if element.tag == "material":
                element.attrib.pop("texture", None)

    def _check(self, parent: Element) -> None:
        for child in list(parent):
            if child.tag in _LEFT_OUT:
                parent.remove(child)
            elif child.tag in _KNOWN:
                for key, value in child.attrib.items():
                    if key != "name" and _NOT_FINITE & set(value.lower().split()):
                        raise self.fault(f"<{child.tag}> has {key}={value[:40]!r}", "write numbers")
                self._check(child)
            else:
                raise self.fault(
                    f"<{child.tag}> is not among the elements that a robot may have",
                    "write what it stands for into the file, or remove it",
                )

    def _mjcf_meshes(self, root: Element, compiler: dict[str, str]) -> None:
        folder = compiler.get("meshdir", compiler.get("assetdir", ""))
        used = {geom.get("mesh") for geom in root.iter("geom")}
        for asset in root.iter("asset"):
            for mesh in asset.findall("mesh"):
                file = mesh.get("file", "")
                mesh.set("name", mesh.get("name") or Path(file).stem)
                if mesh.get("name") not in used:
                    asset.remove(mesh)
                elif file:
                    if compiler.get("strippath") == "true":
                        file = Path(file).name
                    mesh.set("file", self._mesh(Path(folder, file)))

    def _urdf_meshes(self, root: Element) -> None:
        for mesh in root.iter("mesh"):
            file = mesh.get("filename", "")
            # `package://name/meshes/hip.stl`: the folder stands for the package.
            _, scheme, rest = file.partition("package://")
            mesh.set("filename", self._mesh(Path(rest.partition("/")[2] if scheme else file)))

    def _mesh(self, path: Path) -> str:
        """Read a mesh, and return the name that it has from now on."""
        fix = "thin it out, or leave it out"
        line = 1 + self._content.partition(path.name.encode())[0].count(b"\n")
        if path.name.encode() not in self._content:
            line = 1
        try:
            content = self.read(str(path), MESH_BYTES)
        except FileNotFoundError:
            fix = "put it there, or remove the mesh and its geoms from the file"
            message = f"mesh {str(path)!r} is not in the folder"
            raise self.fault(message, fix, line) from None
        except ValueError as error:
            raise self.fault(f"mesh {error}", fix, line) from None
        name = f"{len(self.meshes)}{path.suffix.lower()}"
        self.meshes[name], self.names[name] = content, str(path)
        if len(self.meshes) > MESHES or sum(map(len, self.meshes.values())) > MESHES_BYTES:
            raise self.fault(f"it has over {MESHES} meshes or {MESHES_BYTES // 2**20} MiB", fix)
        return name


def fill_meshes(model: Element, folder: RobotFolder) -> None:
    """Write vertices and faces into every <mesh> of an MJCF, in place of its file.

    Raises:
        RobotError: a file is no mesh, or has too many faces.
    """
    count = 0
    for mesh in model.iter("mesh"):
        file = mesh.attrib.pop("file", None)
        if file is None:
            continue
        mesh.attrib.pop("content_type", None)
        name, fix = folder.names[file], "thin it out, or leave it out"
        try:
            vertices, faces = triangles(folder.meshes[file], Path(file).suffix)
        except ValueError as error:
            raise folder.fault(f"mesh {name!r}: {error}", fix) from None
        count += len(faces)
        if len(faces) > FACES or count > ALL_FACES:
            bound = f"{FACES} faces, or all have over {ALL_FACES}"
            raise folder.fault(f"mesh {name!r} has over {bound}", fix)
        mesh.set("vertex", " ".join(f"{value:.9g}" for value in vertices.ravel().tolist()))
        mesh.set("face", " ".join(map(str, faces.ravel().tolist())))


def triangles(content: bytes, suffix: str) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return vertices (V, 3) and faces (F, 3) of an STL or OBJ file.

    Raises:
        ValueError: it is neither, or damaged.
    """
    if suffix not in {".stl", ".obj"}:
        message = f"{suffix or 'a file without an ending'} cannot be read; give .stl or .obj"
        raise ValueError(message)
    import trimesh

    load: Any = trimesh.load_mesh  # pyright: ignore[reportUnknownMemberType]
    try:
        mesh = load(io.BytesIO(content), file_type=suffix[1:], skip_materials=True)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # noqa: BLE001 - whatever a damaged file makes of a parser.
        message = f"it cannot be read: {type(error).__name__}"
        raise ValueError(message) from None
    if not len(faces) or not np.isfinite(vertices).all() or np.abs(vertices).max() > _FARTHEST:
        message = "it has no faces, or numbers that are no lengths in metres"
        raise ValueError(message)
    return vertices, faces
