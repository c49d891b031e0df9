"""The files of a published scene: where they are, and its XML, read without obeying it.

The XML is untrusted: no document type, no entities of its own, no external references. What
could expand, or open other files, is an error, and so are paths that it may not name. Sizes and
depths are limited, and every element knows its line.

The published table of scenes says the task, and by how much a trial may move waypoints. Source:
`scenes.txt` of ziyc/neverwhere, commit 5774a18; the misspelling `hurldes` is its own. The noise has
no effect in the published evaluation and acts under `strict`. LucidSim's terrains, which are XML
files of boxes, have theirs from its environments' registration, where it acts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from xml.parsers import expat

from nw_base.errors import SceneError
from nw_base.files.inside import OutsideError, inside, regular, what_is
from nw_base.words import ROBOTS, Task

_BYTES = 10_000_000
_DEPTH = 60
_ELEMENTS = 100_000
_ATTRIBUTES = 64  # of one element; MJCF's geom has 30


@dataclass(frozen=True, kw_only=True)
class Places:
    """The folders of one scene.

    Attributes:
        xml: the scene's XML.
        folder: the scene folder, which holds `geometry` and `3dgs`.
        name: of the scene, as the published table spells it.
    """

    xml: Path
    folder: Path
    name: str

    def resolve(self, element: Element, attribute: str, *, within: str = "") -> Path:
        """Return the existing file that an attribute names.

        Meshes are named relative to the folder of the XML, as `real_scenes/<scene>/...`; included
        files may name theirs relative to themselves. Within the scene folder alone, without the
        code repository round it, the leading `real_scenes/<scene>` falls away.

        Args:
            element: that names a file.
            attribute: in which it does.
            within: folder that the compiler section puts before it.

        Raises:
            SceneError: the path leaves the folder that it starts from, also by a link, or there is
                no such file.
        """
        text = element.get(attribute) or ""
        name = "/".join(part.replace("\\", "/") for part in (within, text) if part)
        candidates = [(self.xml.parent, name), (element.file.parent, name)]
        parts = PurePosixPath(name).parts
        if len(parts) > 2 and parts[0] == "real_scenes":
            candidates.append((self.folder, "/".join(parts[2:])))
        looked = ", ".join(dict.fromkeys(str(folder / below) for folder, below in candidates))
        missing = element.error(f"there is no file {text!r}", fix=f"looked at {looked}")
        for folder, below in candidates:
            try:
                path = inside(folder, below)
            except OutsideError as error:
                missing = element.error(
                    f"{attribute}={text!r}: {error}",
                    fix="no absolute path, no '..' and no link out of the scene is followed: copy "
                    "the file into it",
                )
            else:
                if what_is(path) == "file":
                    return path
        raise missing


def find_places(reference: Path, robot: str = "go1") -> Places:
    """Return the files of a scene.

    Args:
        reference: the scene folder, with the XML in it or two folders up (beside `real_scenes`), or
            the XML itself.
        robot: whose XML to take if there is one for each.

    Raises:
        SceneError: no XML is found.
    """
    if reference.suffix == ".xml":
        if what_is(reference) != "file":
            raise SceneError(f"{reference}: there is no such file")
        name = re.sub(r"^nw-go[12]-", "", reference.stem)
        beside = reference.parent / "real_scenes" / name
        folder = beside if what_is(beside) == "folder" else reference.parent
        return Places(xml=reference, folder=folder, name=name)
    if what_is(reference) != "folder":
        raise SceneError(f"{reference}: there is no such folder", fix="give a scene folder")
    name = reference.resolve().name
    order = (robot, *(other for other in ROBOTS if other != robot))
    for base in (reference, reference.parent.parent, reference.absolute().parent.parent):
        for each in order:
            xml = base / f"nw-{each}-{name}.xml"
            if what_is(xml) == "file":
                return Places(xml=xml, folder=reference, name=name)
    models = sorted(reference.glob("*.xml"))
    for each in order:
        named = [xml for xml in models if xml.name.startswith(f"nw-{each}-")]
        if len(named) == 1:
            return Places(xml=named[0], folder=reference, name=named[0].stem[len(f"nw-{each}-") :])
    named = [xml for xml in models if xml.stem == name]
    if named or len(models) == 1:
        return Places(xml=(named or models)[0], folder=reference, name=name)
    raise SceneError(
        f"{reference}: {len(models)} XML files and none is nw-{robot}-{name}.xml",
        fix="put the scene's XML there, or name the XML instead of the folder",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Element:
    """An element: its attributes as text, its children in order, and where it stands."""

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    children: list[Element] = field(default_factory=list["Element"])

    def get(self, name: str, default: str | None = None) -> str | None:
        """Return an attribute."""
        return self.attributes.get(name, default)

    def all(self, tag: str) -> list[Element]:
        """Return the children of one tag."""
        return [child for child in self.children if child.tag == tag]

    def error(self, message: str, fix: str | None = None) -> SceneError:
        """Return an error that names file, line and element."""
        name = self.get("name")
        label = self.tag if name is None else f"{self.tag} {name!r}"
        return SceneError(f"{self.file}:{self.line}: {label}: {message}", fix=fix)


def read_xml(path: Path) -> Element:
    """Return the root element of a file.

    Raises:
        SceneError: the file cannot be read, is not well formed, too large or too deep, or has a
            document type or entities.
    """
    try:
        size = regular(path).stat().st_size
        if size > _BYTES:
            raise SceneError(f"{path} has {size} bytes", fix=f"a scene XML has less than {_BYTES}")
        text = path.read_bytes()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror or error}") from None
    return _TreeBuilder(path).read(text)


class _TreeBuilder:
    """Builds the tree of one file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._open: list[Element] = []
        self._root: Element | None = None
        self._count = 0
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.EntityDeclHandler = self._refuse_entity
        parser.ExternalEntityRefHandler = self._refuse_external
        self._parser = parser

    def read(self, text: bytes) -> Element:
        try:
            self._parser.Parse(text, True)
        except expat.ExpatError as error:
            raise SceneError(f"{self._path}:{error.lineno}: not well formed: {error}") from None
        except (ValueError, LookupError) as error:  # A character set that expat does not read.
            raise SceneError(f"{self._path}: not readable: {error}", fix="write UTF-8") from None
        if self._root is None:
            raise SceneError(f"{self._path}: no element in it")
        return self._root

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        self._count += 1
        if len(self._open) >= _DEPTH or self._count > _ELEMENTS:
            raise SceneError(
                f"{self._path}:{line}: {self._count} elements, {len(self._open)} deep",
                fix=f"at most {_ELEMENTS} elements, {_DEPTH} deep",
            )
        if len(attributes) > _ATTRIBUTES:
            raise SceneError(
                f"{self._path}:{line}: {len(attributes)} attributes", fix=f"at most {_ATTRIBUTES}"
            )
        element = Element(tag=tag, attributes=attributes, file=self._path, line=line)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._root = element
        self._open.append(element)

    def _end(self, _tag: str) -> None:
        self._open.pop()

    def _refuse_doctype(self, *_: object) -> None:
        raise self._refused("a document type")

    def _refuse_entity(self, *_: object) -> None:
        raise self._refused("an entity")

    def _refuse_external(self, *_: object) -> bool:
        raise self._refused("an external reference")

    def _refused(self, what: str) -> SceneError:
        line = self._parser.CurrentLineNumber
        return SceneError(f"{self._path}:{line}: {what} is not read here", fix="remove it")


@dataclass(frozen=True, kw_only=True)
class TableRow:
    """Task, and half widths in metres of the waypoint noise along x and y."""

    task: Task
    waypoint_noise: tuple[float, float]


_ROWS: tuple[tuple[Task, float, float, str], ...] = (
    ("gaps", 0.00, 0.30, "gaps_12in_226_blue_carpet_v2 gaps_16in_226_blue_carpet_v2"),
    ("gaps", 0.00, 0.30, "gaps_grassy_courtyard_v2 gaps_stata_v1"),
    ("gaps", 0.10, 0.15, "gaps_atkinson_back_12in gaps_center_12in gaps_fah_front_12in"),
    ("gaps", 0.10, 0.15, "gaps_fah_ll_indoor_12in gaps_jacobs_front_12in"),
    ("gaps", 0.10, 0.20, "gaps_geisel_12in gaps_jacobs_side_12in"),
    ("gaps", 0.00, 0.10, "gaps_fah_ll_gaps_15in_indoor_mixtex_v1"),
    ("hurdles", 0.00, 0.30, "hurdle_226_blue_carpet_v3 hurdle_one_dark_grassy_courtyard_v1"),
    ("hurdles", 0.00, 0.30, "hurdle_fah_ll_two_hurldes_wood_v1"),
    ("hurdles", 0.00, 0.30, "hurdle_fah_two_hurdle_gray_ground_v1 test_real_robot_sample_1"),
    ("hurdles", 0.00, 0.35, "hurdle_one_blue_carpet_v2 hurdle_stata_v1 hurdle_stata_v2"),
    ("hurdles", 0.00, 0.35, "hurdle_pfb_side hurdle_jacobs_side"),
    ("hurdles", 0.00, 0.40, "hurdle_black_stone_v1 hurdle_three_grassy_courtyard_v2"),
    ("hurdles", 0.00, 0.40, "real_hurdle_three_grassy_ally_v2 hurdle_pssl_side"),
    ("hurdles", 0.00, 0.40, "hurdle_fah_back_two_hurldes_wood_v1"),
    ("hurdles", 0.00, 0.40, "hurdle_fah_indoor_two_hurdle_rubber_v1"),
    ("hurdles", 0.00, 0.40, "hurdle_fah_indoor_two_hurdle_wood_v1"),
    ("hurdles", 0.00, 0.10, "lucidsim_real_hurdle_1 lucidsim_real_hurdle_2"),
    ("stairs", 0.00, 0.50, "building_31_stairs_v1 real_stair_02_bcs_v1 real_stair_04_bcs_dusk"),
    ("stairs", 0.00, 0.50, "real_stair_08_mc_afternoon_v1 stairs_4_stairs2up_v1"),
    ("stairs", 0.00, 0.50, "stairs_atkinson_back stairs_fah_back stairs_atkinson_side"),
    ("stairs", 0.00, 0.50, "stairs_ewc_front stairs_pc_fountain stairs_pfbh_front"),
    ("stairs", 0.00, 0.40, "stairs_36_backstairs_v2 stairs_48_v3"),
    ("stairs", 0.00, 0.30, "stairs_geisel_up stairs_jacobs_front stairs_pc_side stairs_pcw"),
    ("stairs", 0.00, 0.10, "lucidsim_real_stairs_2 lucidsim_real_stairs_3"),
    ("ramps", 0.00, 0.15, "wood_ramp_aligned_bricks_v1 wood_ramp_offset_bricks_v2"),
    ("ramps", 0.00, 0.15, "ramp_aligned_blue_carpet_v4 ramp_spread_blue_carpet_v5"),
    ("ramps", 0.15, 0.20, "wood_ramp_aligned_grass_v2"),
    ("ramps", 0.00, 0.30, "ramp_bricks_v2 ramp_grass_v3"),
    ("ramps", 0.15, 0.15, "ramp_atkinson_back ramp_fah_back ramp_fah_garden ramp_fah_side"),
    ("ramps", 0.15, 0.15, "ramp_fah_indoor_wood_4_ramp_v1 ramp_geisel ramp_jacobs_back"),
    ("ramps", 0.15, 0.15, "ramp_jacobs_front ramp_jacobs_indoor ramps_fah_ll_indoor"),
)

PUBLISHED: dict[str, TableRow] = {
    name: TableRow(task=task, waypoint_noise=(x, y))
    for task, x, y, names in _ROWS
    for name in names.split()
}

LUCIDSIM: dict[str, TableRow] = {
    "hurdle": TableRow(task="hurdles", waypoint_noise=(0.0, 0.1)),
    "gaps": TableRow(task="gaps", waypoint_noise=(0.0, 0.1)),
    "parkour": TableRow(task="ramps", waypoint_noise=(0.1, 0.1)),
    "stairs_v1": TableRow(task="stairs", waypoint_noise=(0.0, 0.1)),
    "stairs_v2": TableRow(task="stairs", waypoint_noise=(0.0, 0.1)),
}
"""By the name of the XML, without its suffix."""

_WORDS: tuple[tuple[str, Task], ...] = (
    ("hurdle", "hurdles"),
    ("hurlde", "hurdles"),
    ("stair", "stairs"),
    ("ramp", "ramps"),
    ("parkour", "ramps"),
    ("gap", "gaps"),
)


def row_of(name: str) -> tuple[TableRow, bool]:
    """Return the row of a scene and whether it is the published one, not guessed from the name."""
    for rows in (PUBLISHED, LUCIDSIM):
        if name in rows:
            return rows[name], True
    for word, task in _WORDS:
        if word in name.lower():
            return TableRow(task=task, waypoint_noise=(0.0, 0.1)), False
    return TableRow(task="hurdles", waypoint_noise=(0.0, 0.1)), False
