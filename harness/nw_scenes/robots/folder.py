"""A robot as a folder: `robot.yaml` beside an MJCF or URDF file and its meshes.

What the model file says is derived from it; `robot.yaml` says the rest, and overrides. The folder
may be untrusted: its XML is checked element by element and its meshes are read here, so that
MuJoCo's compiler sees neither a path nor a plug-in. Here the files are read; `derived` asks MuJoCo
what is in them, and makes a `RobotSpec` whose MJCF holds everything.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, cast
from xml.etree.ElementTree import Element, ParseError, XMLPullParser

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from nw_base.errors import Problem, RobotError
from nw_base.files.inside import OutsideError, bounded_bytes, inside
from nw_base.files.yaml_file import (
    YamlFile,
    YamlProblems,
    parse_yaml,
    read_yaml,
    validation_problems,
)
from nw_scenes.robots.account import SHAPES, Account, unexpanded
from nw_scenes.robots.collada import SUFFIX, as_stl
from nw_scenes.robots.robot_file import ROBOT_FILE, ModelFile, RobotFile

Array = npt.NDArray[np.float64]

XML_BYTES = 2**22
ELEMENTS, DEPTH = 20_000, 100
MESHES, MESH_BYTES, MESHES_BYTES = 500, 2**26, 2**28
FACES, ALL_FACES = 200_000, 1_000_000
"""What a folder may hold: of the model file, of one mesh, of all of them."""

_MJCF = """mujoco compiler default asset mesh material worldbody body frame inertial joint freejoint
    geom site camera contact pair exclude equality connect weld tendon fixed spatial pulley actuator
    general motor position velocity intvelocity damper cylinder pid dcmotor"""
KNOWN = frozenset(_MJCF.split())
"""Of an MJCF; what a URDF may have, `account` says."""
_READ = frozenset({".stl", ".obj"})
_FARTHEST = 1e5  # of a mesh's numbers, before its scale
_LENGTHS = frozenset({"pos", "size", "fromto", "xyz", "radius", "length"})
_MOTION = frozenset({"damping", "armature", "stiffness", "frictionloss", "gravcomp", "margin"})
_LONGEST, _STRONGEST, _LARGEST = 1e4, 1e6, 1e20  # m, N m and the like, any figure
_PATHS = frozenset({"file", "meshdir", "assetdir", "strippath"})
_OTHERWISE = frozenset({"vertex", "face", "builtin", "params"})  # What else says a mesh.


# As C's strtod reads them, which takes `nan(1)` too.
_NOT_FINITE = re.compile(r"(?:^|\s)[+-]?(?:nan(?:\(\w*\))?|inf(?:inity)?)(?=\s|$)", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class RobotFolder:
    """A folder that was read, and nothing of it derived yet.

    Attributes:
        path: of the folder, absolute.
        file: robot.yaml with the positions of its settings.
        settings: the same, valid in itself.
        model: the root of the model file, without what is left out.
        lines: where each of its elements stands in the file, counted from 1.
        meshes: bytes of the meshes, by the names that stand in it now.
        names: of the meshes' files, by these names.
        poses: joint positions of its keyframes by name, as they are written.
        files: names of all files that were read.
        digest: hex SHA-256 of their names and bytes.
        model_digest: the same of all but robot.yaml.
        notes: sentences about what is not drawn.
        account: what of the model file is passed over, or is not simulated.
    """

    path: Path
    file: YamlFile
    settings: RobotFile
    model: Element
    lines: dict[Element, int]
    meshes: dict[str, bytes]
    names: dict[str, str]
    poses: dict[str, str]
    files: tuple[str, ...]
    digest: str
    model_digest: str
    notes: list[str]
    account: Account

    def fault(self, message: str, fix: str | None = None, line: int = 1) -> RobotError:
        """Return an error about the model file."""
        where = str(self.path / self.settings.model.file)
        return RobotError([Problem(file=where, line=line, column=1, message=message, fix=fix)])

    def line_of(self, name: str, *tags: str) -> int:
        """Return the line of the first element of a name, of one of some tags; 1 = there is none.

        A link of a URDF is a body.
        """
        wanted = {*tags, "link"} if "body" in tags else set(tags)
        elements = (e for e in self.model.iter() if e.get("name") == name and e.tag in wanted)
        return next((self.lines.get(element, 1) for element in elements), 1)


def read_folder(
    folder: Path, text: str | None = None, seen: dict[str, str] | None = None
) -> RobotFolder:
    """Read a robot's folder.

    Args:
        folder: with the model file that `robot.yaml` names.
        text: of a `robot.yaml` that is not written yet; None = the folder's own.
        seen: gets SHA-256 of the files that are read, by name, also if one cannot be read.

    Raises:
        RobotError: what is wrong with it, with file, line and column.
    """
    path = folder / ROBOT_FILE
    try:
        file = read_yaml(path) if text is None else parse_yaml(text, file=str(path))
    except YamlProblems as error:
        raise RobotError(error.problems) from None
    try:
        settings = RobotFile.model_validate(file.data)
    except ValidationError as error:
        raise RobotError(validation_problems(error, file, RobotFile)) from None
    reader = _Reader(folder, file, {} if seen is None else seen)
    reader.take(ROBOT_FILE, path.read_bytes() if text is None else text.encode())
    model = reader.xml(settings.model)
    keys = enumerate(model.iter("key"))
    poses = {key.get("name", f"key {number}"): key.get("qpos", "") for number, key in keys}
    reader.tidy(model)
    return RobotFolder(
        path=folder.resolve(),
        file=file,
        settings=settings,
        model=model,
        lines=reader.lines,
        meshes=reader.meshes,
        names=reader.names,
        poses=poses,
        files=tuple(reader.seen),
        digest=reader.digest(),
        model_digest=reader.digest(ROBOT_FILE),
        notes=reader.notes,
        account=reader.account,
    )


def digest_of(seen: Mapping[str, str]) -> str:
    """Return the digest of a folder, from the SHA-256 of its files by name."""
    text = "".join(f"{name}\0{seen[name]}\n" for name in sorted(seen))
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass
class _Reader:
    """Reads the files of a folder, none of which lies outside it."""

    folder: Path
    file: YamlFile
    seen: dict[str, str] = field(default_factory=dict[str, str])
    """SHA-256 by name."""
    meshes: dict[str, bytes] = field(default_factory=dict[str, bytes])
    names: dict[str, str] = field(default_factory=dict[str, str])
    lines: dict[Element, int] = field(default_factory=dict[Element, int])
    notes: list[str] = field(default_factory=list[str])
    account: Account = field(default_factory=Account)
    where: str = ""
    base: str = ""
    """The folder of the model file, from which its paths start, within the robot's."""

    def digest(self, *but: str) -> str:
        """Of all that was read, but some files."""
        return digest_of({name: own for name, own in self.seen.items() if name not in but})

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
            raise OutsideError(message) from None
        except OSError as error:
            message = f"{name!r}: {error.strerror}"
        except ValueError as error:
            message = f"{name!r}: {error}"
        raise ValueError(message)

    def xml(self, model: ModelFile) -> Element:
        """Return the root of the model file."""
        self.where, self.base = str(self.folder / model.file), str(Path(model.file).parent)
        try:
            content = self.read(model.file, XML_BYTES)
        except FileNotFoundError:
            message = f"model.file: there is no file {model.file!r} in the folder"
            raise RobotError([self.file.problem(("model", "file"), message)]) from None
        except ValueError as error:
            problem = self.file.problem(("model", "file"), f"model.file: {error}")
            raise RobotError([problem]) from None
        digest = self.seen[model.file]
        if model.sha256 is not None and model.sha256.lower() != digest:
            message = f"model.sha256: that of {model.file} is {digest}"
            problem = self.file.problem(("model", "sha256"), message, "write it, if that is meant")
            raise RobotError([problem])
        root = self._tree(content, {"mujoco", "robot"})
        if root.tag == "mujoco":
            self._include(root, PurePosixPath(self.base))
        elif (words := unexpanded(root)) is not None:
            message = f"it is no URDF yet: it has {words}, which only xacro reads"
            raise self.fault(message, "expand it: `xacro FILE > robot.urdf`")
        return root

    def fault(self, message: str, fix: str | None = None, line: int = 1) -> RobotError:
        """Return an error about the model file."""
        return RobotError([Problem(file=self.where, line=line, column=1, message=message, fix=fix)])

    def _include(self, parent: Element, base: PurePosixPath) -> None:
        """Put what each <include> names in its place.

        Args:
            parent: whose elements are replaced.
            base: the folder of its file. Names begin there or, as MuJoCo has it, in the model's.
        """
        for index, child in reversed(list(enumerate(parent))):
            if child.tag != "include":
                self._include(child, base)
                continue
            line = self.lines[child]
            said = child.get("file", "")
            tried = [os.path.normpath(Path(each, said)) for each in (self.base, base)]
            name = next(filter(self._has, tried), tried[-1]) if said else said
            if name in self.seen:  # MuJoCo refuses that, too.
                raise self.fault(
                    f"<include>: {name!r} is read already", "include each file once", line
                )
            try:
                content = self.read(name, XML_BYTES)
            except FileNotFoundError:
                message = f"<include>: {name!r} is not in the folder"
                raise self.fault(message, "put it there", line) from None
            except ValueError as error:
                message = f"<include>: {error}"
                raise self.fault(message, "put it into the folder", line) from None
            where, self.where = self.where, str(self.folder / name)
            root = self._tree(content, {"mujoco", "mujocoinclude"})
            self._include(root, PurePosixPath(name).parent)
            self.where = where
            for element in root.iter():  # Places are told in the model file.
                self.lines[element] = self.lines[child]
            parent[index : index + 1] = list(root)

    def _tree(self, content: bytes, tags: Collection[str]) -> Element:
        if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
            raise self.fault("it declares a document type or entities", "remove them")
        # MuJoCo's parser ends a comment at the first `-->`, whatever dashes stand in it; XML's does
        # not allow them.
        content = re.sub(rb"<!--.*?-->", _lines_of, content, flags=re.DOTALL)
        depth = 0
        root: Element | None = None
        try:
            for event, element, line in element_lines(content):
                depth += 1 if event == "start" else -1
                self.lines.setdefault(element, line)
                root = element if root is None else root
                if len(self.lines) > ELEMENTS or depth > DEPTH:
                    raise self.fault(f"it has over {ELEMENTS} elements, or {DEPTH} in each other")
        except ParseError as error:
            raise self.fault(f"it is not XML: {error}", line=error.position[0]) from None
        except (ValueError, LookupError) as error:  # An encoding that the parser does not know.
            raise self.fault(f"it cannot be read: {error}", "write it in UTF-8") from None
        if root is None or root.tag not in tags:
            tag = "nothing" if root is None else f"<{root.tag}>"
            raise self.fault(f"it begins with {tag}", "give an MJCF (<mujoco>) or a URDF (<robot>)")
        return root

    def _has(self, name: str) -> bool:
        """Return whether a name is one of a file in the folder."""
        try:
            return inside(self.folder, name).is_file()
        except (OutsideError, OSError):
            return False

    def tidy(self, root: Element) -> None:
        """Leave out what a body does not need, and read the meshes."""
        compiler = {k: v for each in root.iter("compiler") for k, v in each.attrib.items()}
        if root.tag == "robot":
            self.account.attributes(root, root.tag, self.lines[root])
        self._check(root, root.tag)
        if root.tag == "robot":
            self._urdf_meshes(root, compiler.get("meshdir", ""))
        else:
            self._mjcf_meshes(root, compiler)
        for element in root.iter():
            if element.tag != "mesh":
                for key in _PATHS & set(element.attrib):
                    del element.attrib[key]

    def _check(self, parent: Element, kind: str) -> None:
        """Account for all elements below one; leave out, or refuse, what is not simulated."""
        for child in list(parent):
            line = self.lines[child]
            if child.tag == "keyframe" and kind == "mujoco":
                for key in {key for each in child for key in each.attrib} - {"name", "qpos"}:
                    self.account.passes(f"{key} of <key>", "only positions of joints are taken")
                parent.remove(child)
                continue
            is_out = self.account.leaves_out(child, kind, line)
            if is_out or (kind == "robot" and not self._is_drawable(child)):
                parent.remove(child)
                continue
            if kind == "mujoco" and child.tag not in KNOWN:
                raise self.fault(
                    f"<{child.tag}> is not among the elements that a robot may have",
                    "write what it stands for into the file, or remove it",
                    line,
                )
            self.account.attributes(child, kind, line)
            for key, value in child.attrib.items():
                if key != "name" and _NOT_FINITE.search(value):
                    message = f"<{child.tag}> has {key}={value[:40]!r}"
                    raise self.fault(message, "write numbers", line)
                self._check_size(child, key, value)
            if parent.tag == "equality" and child.tag in {"connect", "weld"}:
                bodies = [child.get(key) or "the world" for key in ("body1", "body2")]
                raise self.fault(
                    f"<{child.tag}> closes a loop of {' and '.join(bodies)}, and closed loops "
                    "are not simulated",
                    "remove it, and drive the joints of a chain that is open",
                    line,
                )
            if child.tag == "geom":
                self._check_ground(child, parent)
            self._check(child, kind)

    def _check_ground(self, geom: Element, parent: Element) -> None:
        """Let a plane stand for what ground of the file is a mesh or a height field.

        Its masks say what touches the ground; scenes have their own.
        """
        is_field = geom.get("type") == "hfield" or "hfield" in geom.attrib
        moves = any(True for tag in ("joint", "freejoint") for _ in parent.iter(tag))
        if is_field and moves and parent.tag != "worldbody":
            message = "a <geom> of the robot is a height field, which cannot move"
            raise self.fault(message, "use a mesh", self.lines[geom])
        if is_field or (parent.tag == "worldbody" and "mesh" in geom.attrib):
            geom.attrib.update(type="plane", size="1 1 1")
            for key in ("hfield", "mesh"):
                geom.attrib.pop(key, None)

    def _is_drawable(self, element: Element) -> bool:
        """Return whether MuJoCo knows the shapes of a <collision> or <visual> of a URDF.

        Raises:
            RobotError: it does not know that of a <collision>.
        """
        shapes = [e.tag for g in element.findall("geometry") for e in g if e.tag not in SHAPES]
        if shapes and element.tag == "collision":
            message = f"<{shapes[0]}> is not a URDF shape"
            raise self.fault(message, f"use one of {', '.join(SHAPES)}", self.lines[element])
        if shapes:
            self.notes.append(f"a <visual> is not drawn: <{shapes[0]}> is not a URDF shape")
        return not shapes

    def _check_size(self, element: Element, key: str, value: str) -> None:
        """Refuse a figure that no robot has: physics would fail, and say less."""
        most, fix = _LARGEST, "write figures in SI units"
        if key in _LENGTHS:
            most, fix = _LONGEST, "lengths are in m"
        elif key in _MOTION:
            most = _STRONGEST
        for word in value.split() if key != "name" else ():
            try:
                number = float(word)
            except ValueError:
                continue
            if abs(number) > most:
                message = f"<{element.tag}> has {key}={value[:40]!r}: a number over {most:g}"
                raise self.fault(message, fix, self.lines[element])

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
                    mesh.set("file", self._mesh(Path(self.base, folder, file), mesh))

    def _urdf_meshes(self, root: Element, meshdir: str) -> None:
        for mesh in root.iter("mesh"):
            mesh.set("filename", self._in_folder(mesh.get("filename", ""), meshdir))
        for link in root.iter("link"):
            for visual in link.findall("visual"):
                if not self._is_drawn(visual):
                    link.remove(visual)
            for mesh in (mesh for each in link.findall("collision") for mesh in each.iter("mesh")):
                mesh.set("filename", self._mesh(Path(mesh.get("filename", "")), mesh))

    def _is_drawn(self, visual: Element) -> bool:
        """Read the mesh of what is seen of a link; where it cannot be read, say so in a note."""
        for mesh in visual.iter("mesh"):
            path = Path(mesh.get("filename", ""))
            try:
                mesh.set("filename", self._named(path, self._seen(path)))
            except FileNotFoundError:
                return self._without(path, ABSENT)
            except ValueError as error:
                return self._without(path, str(error))
        return True

    def _seen(self, path: Path) -> bytes:
        """Return a mesh that can be drawn.

        Raises:
            FileNotFoundError: there is none.
            ValueError: what is wrong with it.
        """
        suffix = path.suffix.lower()
        message = "" if suffix in {*_READ, SUFFIX} else "only STL, OBJ and COLLADA are read"
        if not message:
            content = self._content(path)
            faces = _count_of(content, suffix.replace(SUFFIX, ".stl"))
            total = sum(map(len, self.meshes.values())) + len(content)
            if faces <= FACES and total <= MESHES_BYTES and len(self.meshes) < MESHES:
                return content
            message = f"it has {faces} faces, or all meshes are too large or too many"
        raise ValueError(message)

    def _without(self, path: Path, why: str) -> bool:
        rest = "its link is drawn by its other meshes, or by its collision shapes"
        self.notes.append(f"visual mesh {str(path)!r} is not drawn: {why}; {rest}")
        return False

    def _mesh(self, path: Path, element: Element) -> str:
        """Read a mesh, and return the name that it has from now on."""
        # `../meshes/hip.stl` of a model in a folder below the robot's does not leave that.
        file, line = os.path.normpath(path), self.lines[element]
        try:
            content = self._content(file)
        except FileNotFoundError:
            message = f"mesh {file!r} is not in the folder"
            raise self.fault(message, _ABSENT, line) from None
        except ValueError as error:
            fix = _THINNER if "MiB, over" in str(error) else _ABSENT
            if isinstance(error, OutsideError):
                fix = "copy it into the folder, and name it by a path from the model file"
            elif path.suffix.lower() == SUFFIX:
                fix = _AGAIN
            raise self.fault(f"mesh {error}", fix, line) from None
        name = self._named(file, content)
        if len(self.meshes) > MESHES or sum(map(len, self.meshes.values())) > MESHES_BYTES:
            bound = f"{MESHES} meshes or {MESHES_BYTES // 2**20} MiB"
            raise self.fault(f"it has over {bound}", _THINNER, line)
        return name

    def _content(self, file: str | Path) -> bytes:
        """Return the bytes of a mesh, of COLLADA as STL.

        Raises:
            FileNotFoundError: there is none.
            ValueError: what is wrong with it.
        """
        content = self.read(str(file), MESH_BYTES)
        if Path(file).suffix.lower() != SUFFIX:
            return content
        try:
            return as_stl(content)
        except ValueError as error:
            raise ValueError(f"{str(file)!r}: {error}") from None

    def _in_folder(self, file: str, meshdir: str) -> str:
        """Return the path of a URDF's mesh within the folder, or the likeliest of one that is not.

        `package://name/meshes/hip.stl` names a folder of some machine: the robot's may lie at any
        place of that path, so that the longest end of it that is there is meant.
        """
        scheme = re.match(r"(?:package|model|file)://|\$\(find ([\w.-]+)\)/?", file)
        if scheme is None:
            tried = [Path(self.base, file), Path(self.base, meshdir, Path(file).name)]
            names = [os.path.normpath(path) for path in tried]
            return next(filter(self._has, names), names[0])
        rest = (scheme[1] or "", *PurePosixPath(os.path.normpath(file[scheme.end() :])).parts)
        parts = [part for part in rest if part not in {"", "/"}]
        ends = ["/".join(parts[at:]) for at in range(max(1, len(parts) - 1))]
        if len(parts) == 2:  # A mesh beside the package's own file.
            ends.append(parts[1])
        match = next(filter(self._has, ends), None)
        if match is None:
            return file if file.startswith("file:") else "/".join(parts[1:] or parts)
        if match not in {"/".join(parts), "/".join(parts[1:])}:
            self.account.passes(f"the beginning of {file[: -len(match)]}", "meshes lie in FOLDER")
        return match

    def _named(self, path: str | Path, content: bytes) -> str:
        """Keep a mesh, and return the name that it has from now on."""
        name = f"{len(self.meshes)}{Path(path).suffix.lower().replace(SUFFIX, '.stl')}"
        self.meshes[name], self.names[name] = content, str(path)
        return name


_TAG_LINES = 30  # that a tag may have, for its place to be told
ABSENT = "it is not in the folder"
"""Why a mesh that is only seen is not drawn; a draft then looks in the folder above."""
_AGAIN = "save it again as STL or OBJ, or leave it out"
_THINNER = "thin it out, or leave it out"
_ABSENT = "put it there, or remove the mesh and its geoms from the file"


def element_lines(content: bytes) -> Iterator[tuple[str, Element, int]]:
    """Yield starts and ends of the elements of an XML text, and on which line each begins.

    Raises:
        ParseError: it is no XML.
        ValueError, LookupError: its encoding is not known.
    """
    parser = XMLPullParser(("start", "end"))
    lines = content.splitlines(keepends=True)
    for number, line in enumerate(lines, start=1):
        parser.feed(line)
        for event, element in cast("Any", parser.read_events()):
            # A tag of several lines is told when its last one is read.
            tag, nearby = f"<{element.tag}".encode(), range(number, max(0, number - _TAG_LINES), -1)
            begin = next((n for n in nearby if tag in lines[n - 1]), number)
            yield event, element, begin
    parser.close()


def fill_meshes(model: Element, folder: RobotFolder) -> None:
    """Write vertices and faces into every <mesh> of an MJCF, in place of its file.

    Raises:
        RobotError: a file is not a mesh, or has too many faces.
    """
    count = 0
    for mesh in model.iter("mesh"):
        file = mesh.attrib.pop("file", None)
        if file is None:
            continue
        name, line = folder.names[file], folder.line_of(mesh.get("name", ""), "mesh")
        if twice := _OTHERWISE & set(mesh.attrib):
            fix = "remove one of them"
            raise folder.fault(f"mesh {name!r} has a file and {min(twice)}", fix, line)
        try:
            vertices, faces = triangles(folder.meshes[file], Path(file).suffix)
        except ValueError as error:
            raise folder.fault(f"mesh {name!r}: {error}", _AGAIN, line) from None
        count += len(faces)
        if len(faces) > FACES or count > ALL_FACES:
            bound = f"{FACES} faces, or all have over {ALL_FACES}"
            raise folder.fault(f"mesh {name!r} has over {bound}", _THINNER, line)
        mesh.set("vertex", " ".join(f"{value:.9g}" for value in vertices.ravel().tolist()))
        mesh.set("face", " ".join(map(str, faces.ravel().tolist())))


_counts: dict[tuple[bytes, str], int] = {}
"""Faces of meshes by their digests: a draft reads a folder several times, and a parser is slow."""


def _count_of(content: bytes, suffix: str) -> int:
    """Return how many faces a mesh has; raises as `triangles`."""
    key = (hashlib.sha256(content).digest(), suffix)
    if key not in _counts:
        if len(_counts) >= 10 * MESHES:
            _counts.clear()
        _counts[key] = len(triangles(content, suffix)[1])
    return _counts[key]


def triangles(content: bytes, suffix: str) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return vertices (V, 3) and faces (F, 3) of an STL or OBJ file.

    Raises:
        ValueError: it is neither, or damaged.
    """
    if suffix not in _READ:
        message = f"{suffix or 'a file without an ending'} cannot be read; give .stl or .obj"
        raise ValueError(message)
    import trimesh

    load: Any = trimesh.load_mesh  # pyright: ignore[reportUnknownMemberType]
    try:
        with np.errstate(all="ignore"):
            mesh = load(io.BytesIO(content), file_type=suffix[1:], skip_materials=True)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # noqa: BLE001 - whatever a damaged file makes of a parser.
        message = f"it cannot be read: {type(error).__name__}"
        raise ValueError(message) from None
    if not len(faces) or not np.isfinite(vertices).all() or np.abs(vertices).max() > _FARTHEST:
        message = "it has no faces, or numbers that are not lengths in metres"
        raise ValueError(message)
    return vertices, faces


def _lines_of(comment: re.Match[bytes]) -> bytes:
    """Return the line ends of a comment, so that what follows keeps its line."""
    return b"\n" * comment[0].count(b"\n")
