"""An MJCF scene file as placed geoms, bodies and mesh assets; robots are left out.

Of MJCF this reads what scene files use: includes, compiler angles and folders, default classes,
bodies and frames with poses, geoms, and mesh assets.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.plural import plural
from nw_scenes.limits import MESH_REACH, QUAT
from nw_scenes.mesh import rotation_matrix
from nw_scenes.neverwhere.files import Element, Places, read_xml

_DEPTH = 12
_INCLUDES = 200  # in all: files that include each other twice would be read without end
_CLASSES = 1000
_ROBOT_FILE = re.compile(r"(^|[/_-])go[12]([/_.-]|$)")
# What the robots' own files set for every geom and angle of the model that includes them.
_ROBOT_FRICTION = "1.0 0.3 0.3"

Matrix = NDArray[np.float64]

_ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedGeom:
    """A geom with its defaults filled in.

    Attributes:
        element: attributes, defaults included.
        T_world_geom: (4, 4).
        bodies: names of the bodies round it, outermost first.
    """

    element: Element
    T_world_geom: Matrix
    bodies: tuple[str, ...]

    @property
    def collides(self) -> bool:
        """Whether anything can touch it."""
        return (
            self.element.get("contype", "1") != "0" or self.element.get("conaffinity", "1") != "0"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Tree:
    """What a scene file places.

    Attributes:
        bodies: name -> T_world_body (4, 4).
        geoms: all geoms, in order.
        meshes: name -> asset element.
        angles: how the file writes angles.
        mesh_folder: what mesh files are relative to, beside the XML.
        has_robot: whether a robot's file was included.
    """

    bodies: dict[str, Matrix]
    geoms: list[PlacedGeom]
    meshes: dict[str, Element]
    angles: Angles
    mesh_folder: str
    has_robot: bool


def read_tree(places: Places) -> Tree:
    """Return the tree of a scene's XML.

    Raises:
        SceneError: naming file and line.
    """
    root = read_xml(places.xml)
    if root.tag != "mujoco":
        raise root.error("this is not MJCF", fix="the outermost element must be <mujoco>")
    sections = _Sections(places)
    sections.expand(root, (places.xml.resolve(),))
    angles, mesh_folder = _compiler(sections)
    walk = _BodyWalk(angles=angles, defaults=_Defaults(sections))
    for section in sections.worlds:
        walk.visit(section, np.eye(4), (), "main")
    meshes: dict[str, Element] = {}
    for section in sections.assets:
        for mesh in section.all("mesh"):
            name = mesh.get("name") or Path(mesh.get("file") or "").stem
            meshes[name] = mesh
    return Tree(
        bodies=walk.bodies,
        geoms=walk.geoms,
        meshes=meshes,
        angles=angles,
        mesh_folder=mesh_folder,
        has_robot=sections.has_robot,
    )


class _Sections:
    """The sections of a file and of what it includes."""

    def __init__(self, places: Places) -> None:
        self._places = places
        self._included = 0
        self.compilers: list[Element] = []
        self.defaults: list[Element] = []
        self.assets: list[Element] = []
        self.worlds: list[Element] = []
        self.has_robot = False
        self.robot_is_assumed = False

    def expand(self, root: Element, chain: tuple[Path, ...]) -> None:
        for child in root.children:
            if child.tag == "include":
                self._include(child, chain)
            elif child.tag == "compiler":
                self.compilers.append(child)
            elif child.tag == "default":
                self.defaults.append(child)
            elif child.tag == "asset":
                self.assets.append(child)
            elif child.tag == "worldbody":
                self.worlds.append(child)

    def _include(self, element: Element, chain: tuple[Path, ...]) -> None:
        try:
            path = self._places.resolve(element, "file")
        except SceneError as error:
            text = element.get("file") or ""
            # Robots are no scene data: their files stay in the code repository.
            if "there is no file" in str(error) and _ROBOT_FILE.search(text):
                self.has_robot = self.robot_is_assumed = True
                return
            raise
        if path.resolve() in chain or len(chain) > _DEPTH:
            raise element.error(f"{path} includes itself", fix="remove the circle")
        self._included += 1
        if self._included > _INCLUDES:
            raise element.error(f"more than {_INCLUDES} files are included", fix="merge them")
        root = read_xml(path)
        if _is_robot(root):
            self.has_robot = True
            self.compilers += root.all("compiler")
            self.defaults += root.all("default")
            return
        self.expand(root, (*chain, path.resolve()))


def _is_robot(root: Element) -> bool:
    def moves(element: Element) -> bool:
        return any(
            child.tag == "freejoint"
            or (child.tag == "joint" and child.get("type") == "free")
            or moves(child)
            for child in element.children
            if child.tag in {"body", "freejoint", "joint"}
        )

    return any(moves(world) for world in root.all("worldbody"))


def _compiler(sections: _Sections) -> tuple[Angles, str]:
    unit, sequence, folder = "degree", "xyz", ""
    if sections.robot_is_assumed:
        unit = "radian"
    for element in sections.compilers:
        unit = element.get("angle", unit) or unit
        sequence = element.get("eulerseq", sequence) or sequence
        # Robots keep their meshes elsewhere; only the scene's own files say where theirs are.
        if not _ROBOT_FILE.search(element.file.name):
            folder = element.get("meshdir") or element.get("assetdir") or folder
        if unit not in {"degree", "radian"}:
            raise element.error(f"angle={unit!r}", fix="give degree or radian")
        if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
            raise element.error(f"eulerseq={sequence!r}", fix="give three of x, y, z")
    return Angles(unit=1.0 if unit == "radian" else math.pi / 180, sequence=sequence), folder


class _Defaults:
    """Default attributes of geoms and meshes, by class."""

    def __init__(self, sections: _Sections) -> None:
        start = {"friction": _ROBOT_FRICTION} if sections.robot_is_assumed else {}
        self._classes: dict[str, dict[str, dict[str, str]]] = {"main": {"geom": start, "mesh": {}}}
        for section in sections.defaults:
            self._read(section, "main")

    def _read(self, element: Element, name: str) -> None:
        mine = self._classes[name]
        for tag in ("geom", "mesh"):
            for child in element.all(tag):
                mine[tag] = _filled(mine[tag], child.attributes)
        for child in element.all("default"):
            inner = child.get("class")
            if inner is None:
                raise child.error("a nested default has no class", fix="name it")
            if len(self._classes) > _CLASSES:
                raise child.error(f"more than {_CLASSES} default classes", fix="merge them")
            self._classes[inner] = {tag: dict(values) for tag, values in mine.items()}
            self._read(child, inner)

    def of(self, element: Element, inherited: str) -> Element:
        """Return an element with the defaults of its class filled in."""
        name = element.get("class") or inherited
        if name not in self._classes:
            raise element.error(f"there is no default class {name!r}")
        filled = _filled(self._classes[name].get(element.tag, {}), element.attributes)
        return Element(tag=element.tag, attributes=filled, file=element.file, line=element.line)


def _filled(default: dict[str, str], own: dict[str, str]) -> dict[str, str]:
    """Return attributes over defaults; a list given in part keeps the default's end."""
    filled = {**default, **own}
    for name in ("friction", "size"):
        if name in default and name in own:
            parts = own[name].split()
            filled[name] = " ".join([*parts, *default[name].split()[len(parts) :]])
    return filled


@dataclass(kw_only=True)
class _BodyWalk:
    """Goes through a world body and places what it finds."""

    angles: Angles
    defaults: _Defaults
    bodies: dict[str, Matrix] = field(default_factory=dict[str, Matrix])
    geoms: list[PlacedGeom] = field(default_factory=list[PlacedGeom])

    def visit(
        self, element: Element, T_world_parent: Matrix, path: tuple[str, ...], inherited: str
    ) -> None:
        for child in self._children(element):
            if child.tag == "geom":
                filled = self.defaults.of(child, inherited)
                placed = product(T_world_parent, pose(filled, self.angles))
                self.geoms.append(PlacedGeom(element=filled, T_world_geom=placed, bodies=path))
            elif child.tag in {"body", "frame"}:
                placed = product(T_world_parent, pose(child, self.angles))
                name = child.get("name") or ""
                if child.tag == "body":
                    if name in self.bodies:
                        raise child.error("a second body of that name", fix="rename one")
                    if name:
                        self.bodies[name] = placed
                    path_inside = (*path, name)
                else:
                    path_inside = path
                self.visit(child, placed, path_inside, child.get("childclass") or inherited)

    def _children(self, element: Element) -> Iterator[Element]:
        for child in element.children:
            if child.tag in {"replicate", "attach", "composite", "flexcomp", "include"}:
                raise child.error(f"<{child.tag}> inside a body is not read here", fix="expand it")
            yield child


@dataclass(frozen=True, kw_only=True)
class Angles:
    """How a file writes angles.

    Attributes:
        unit: radians in one unit of the file.
        sequence: axes of Euler angles; small letters turn with the body, capitals do not.
    """

    unit: float
    sequence: str = "xyz"


def numbers(element: Element, name: str, counts: tuple[int, ...]) -> list[float] | None:
    """Return the numbers of an attribute, None if it is absent.

    Raises:
        SceneError: it holds something else, numbers of no place, or not as many as `counts` allows.
    """
    text = element.get(name)
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        raise element.error(f"{name}={text!r} is not a list of numbers") from None
    if not all(math.isfinite(value) for value in values):
        raise element.error(f"{name}={text!r} is not finite")
    if any(abs(value) > MESH_REACH for value in values):
        raise element.error(f"{name}={text!r}", fix=f"nothing may be beyond {MESH_REACH:g}")
    if len(values) not in counts:
        raise element.error(
            f"{name}={text!r} has {plural(len(values), 'number')}",
            fix="give " + " or ".join(map(str, counts)),
        )
    return values


def product(first: Matrix, second: Matrix) -> Matrix:
    """Return the matrix product of two small matrices, with the same bits on every CPU.

    BLAS adds in an order of its own, and digests of scenes count every bit.
    """
    return (first[:, :, None] * second[None, :, :]).sum(axis=1)


def moved(points: Matrix, transform: Matrix) -> Matrix:
    """Return points (N, 3) under a (4, 4) transform, with the same bits on every CPU."""
    x, y, z = points[:, :1], points[:, 1:2], points[:, 2:]
    linear = transform[:3, :3]
    return x * linear[:, 0] + y * linear[:, 1] + z * linear[:, 2] + transform[:3, 3]


def inverse(transform: Matrix) -> Matrix:
    """Return the inverse of an affine (4, 4) transform, with the same bits on every CPU."""
    a, b, c = transform[:3, 0], transform[:3, 1], transform[:3, 2]
    rows = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    result = np.eye(4)
    result[:3, :3] = rows / (a * rows[0]).sum()
    result[:3, 3] = -(result[:3, :3] * transform[:3, 3]).sum(axis=1)
    return result


def pose(element: Element, angles: Angles) -> Matrix:
    """Return the (4, 4) transform from an element's frame to its parent's, metres."""
    transform = np.eye(4)
    position = numbers(element, "pos", (3,))
    if position is not None:
        transform[:3, 3] = position
    transform[:3, :3] = _rotation(element, angles)
    return transform


def _rotation(element: Element, angles: Angles) -> Matrix:
    named = [name for name in _ORIENTATIONS if element.get(name) is not None]
    if not named:
        return np.eye(3)
    if len(named) > 1:
        raise element.error(f"more than one orientation: {', '.join(named)}", fix="keep one")
    if named[0] == "quat":
        quat = numbers(element, "quat", (4,)) or []
        if sum(part * part for part in quat) * QUAT**2 < 1.0:
            raise element.error("quat is zero")
        return rotation_matrix(quat)
    if named[0] == "euler":
        return euler_rotation(numbers(element, "euler", (3,)) or [], angles)
    if named[0] == "axisangle":
        x, y, z, angle = numbers(element, "axisangle", (4,)) or []
        return _turn(np.array([x, y, z]), angle * angles.unit, element)
    if named[0] == "xyaxes":
        values = np.array(numbers(element, "xyaxes", (6,)))
        first = _unit(values[:3], element)
        second = _unit(values[3:] - (values[3:] @ first) * first, element)
        return np.column_stack([first, second, np.cross(first, second)])
    # The smallest turn that takes z to the given axis.
    axis = _unit(np.array(numbers(element, "zaxis", (3,))), element)
    about = np.cross([0.0, 0.0, 1.0], axis)
    angle = math.atan2(float(np.linalg.norm(about)), float(axis[2]))
    if not about.any():
        about = np.array([1.0, 0.0, 0.0])
    return _turn(about, angle, element)


def euler_rotation(values: list[float], angles: Angles) -> Matrix:
    """Return the (3, 3) rotation of three Euler angles: for `xyz`, Rx(a) Ry(b) Rz(c)."""
    rotation = np.eye(3)
    for value, axis in zip(values, angles.sequence, strict=True):
        c, s = math.cos(value * angles.unit), math.sin(value * angles.unit)
        i = "xyz".index(axis.lower())
        j, k = (i + 1) % 3, (i + 2) % 3
        turn = np.eye(3)
        turn[j, j] = turn[k, k] = c
        turn[k, j], turn[j, k] = s, -s
        rotation = product(rotation, turn) if axis.islower() else product(turn, rotation)
    return rotation


def _turn(axis: Matrix, angle: float, element: Element) -> Matrix:
    x, y, z = _unit(axis, element) * math.sin(angle / 2)
    return rotation_matrix((math.cos(angle / 2), float(x), float(y), float(z)))


def _unit(vector: Matrix, element: Element) -> Matrix:
    length = float(np.linalg.norm(vector))
    if length < 1e-12:
        raise element.error("an axis of its orientation is zero")
    return vector / length
