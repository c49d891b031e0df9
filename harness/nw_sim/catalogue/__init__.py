"""Scenes by name or path: a built-in place, a scene folder, a published one, or one of a hub.

A reference is looked up here (`get_scene`, `references`, `open_scene`); what lies elsewhere is
fetched (`brought`); which files a scene is made of is told to a process that may read no others,
or to another machine (`scene_paths`, `scene_files`); and all that is wrong or remarkable about a
scene is found (`inspect_scene`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from os.path import commonpath
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import PluginError, SceneError, UsageError, nearest
from nw_base.files.inside import what_is
from nw_base.plugins import LADDERS, imported, installed, subject
from nw_base.words import Collision
from nw_places.entries import ENTRIES, has_variants, parted, variant
from nw_places.ladders import FAMILIES, rung
from nw_places.splits import SPLITS, Split, split_of
from nw_scenes.folder import SCENE_FILE, folder_files, inspect_folder, load_folder
from nw_scenes.ladder_file import LADDER_FILE, FolderLadder, is_ladder, load_ladder
from nw_scenes.neverwhere import PREFIX, inspect_published, load_published, reference_path
from nw_scenes.neverwhere.files import PUBLISHED, find_places
from nw_scenes.real import REAL, fetched_scan, kept_scan, scan_of
from nw_scenes.scene import Scene

if TYPE_CHECKING:
    from nw_scenes.finding import SceneFinding
    from nw_scenes.hub.reference import Fetched, Reference
    from nw_sim.survey import Survey


_TRIANGLES = "triangles:"
"""What people write before a scene that is to collide by its mesh's own triangles."""


_BY_NAME = {entry.name: entry for entry in ENTRIES}


def names(split: Split | None = None) -> tuple[str, ...]:
    """Return the names of all built-in scenes, or of those of one split, sorted."""
    return tuple(name for name in sorted(_BY_NAME) if split is None or split_of(name) == split)


def parse_reference(text: str) -> tuple[str, Collision]:
    """Return what people write of a scene as its reference, and how its mesh is to collide."""
    reference = text.removeprefix(_TRIANGLES)
    return reference, "terrain" if reference == text else "triangles"


def get_scene(name_or_path: str | Path) -> Scene:
    """Return a built-in scene by its name, or the scene of a folder by its path.

    Args:
        name_or_path: a name, a folder, `neverwhere:<folder>`, or a scene that `brought` fetches;
            `triangles:` before a folder makes its mesh collide by its own triangles, slow and
            exact, to check the terrain with.

    Raises:
        SceneError: no such scene (with the nearest name), or the folder cannot be read.
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    reference, collision = parse_reference(str(name_or_path))
    return open_scene(brought(reference), collision)


def open_scene(reference: str, collision: Collision = "terrain") -> Scene:
    """Return the scene of a reference.

    Args:
        reference: a name, a folder or its `scene.yaml`, or `neverwhere:<folder>`.
        collision: how the mesh of a folder collides; boxes collide exactly as they are.

    Raises:
        SceneError: as `get_scene`.
    """
    if is_built_in(reference) or rung(reference) is not None:
        return _built_in(reference)
    if reference.startswith(PREFIX):
        return load_published(reference, collision=collision)
    folder = folder_of(reference)
    if folder is not None:
        if is_ladder(folder) and what_is(folder / SCENE_FILE) == "nothing":
            easiest, _ = load_ladder(folder).rungs[0]
            fix = f"name a rung, such as {reference}@{easiest:g}"
            raise SceneError(f"{reference} is a ladder and no scene", fix=fix)
        return load_folder(folder, collision=collision)
    raise SceneError(
        f"no built-in scene and no folder is called {reference!r}",
        fix=_hint(reference, _BY_NAME),
    )


def folder_of(reference: str) -> Path | None:
    """Return the folder that a reference names, itself or by its `scene.yaml`; None if it is none.

    The name of a built-in scene is not a folder's, whatever lies in the working folder.
    """
    if is_built_in(reference) or reference.startswith(PREFIX):
        return None
    path = Path(reference)
    if path.name == SCENE_FILE:
        path = path.parent
    return path if what_is(path) == "folder" else None


def from_folder(reference: str, folder: Path) -> str:
    """Return what names the same scene from another folder: a path in it starts there."""
    plain, collision = parse_reference(reference)
    begin = _TRIANGLES if collision == "triangles" else ""
    scene_folder = folder_of(plain) or _rung_folder(plain, None)
    if scene_folder is not None:
        return begin + Path(os.path.relpath(scene_folder, folder)).as_posix()
    if plain.startswith(PREFIX) and what_is(path := reference_path(plain)) != "nothing":
        return begin + PREFIX + Path(os.path.relpath(path, folder)).as_posix()
    return reference


def match_scenes(patterns: Sequence[str], base: Path | None = None) -> tuple[Scene, ...]:
    """Return the scenes that patterns name, in the order of `references`.

    Raises:
        SceneError: as `references` and `open_scene`.
    """
    return tuple(open_scene(*each) for each in references(patterns, base))


def references(
    patterns: Sequence[str], base: Path | None = None, *, collision: Collision | None = None
) -> tuple[tuple[str, Collision], ...]:
    """Return what `open_scene` takes for the scenes that patterns name; opens none of them.

    Args:
        patterns: names of built-in scenes, globs over those, `split:train`, `split:eval`, any of
            these with `~2` behind it for their second variants, rungs of ladders such as
            `hurdles/bar@0.34`, all published ones such as `hurdles/bar@*`, or paths of scene
            folders, `neverwhere:...`, `hub:...`; `triangles:` before any of them as in `get_scene`.
            What is not on this machine is fetched.
        base: folder that relative paths start from; the working folder by default.
        collision: how meshes collide, whatever the patterns say of it (default: as they say).

    Returns:
        By pattern, then by name, each once: a built-in name, the absolute path of a folder, or
        `neverwhere:` and such a path; and how its mesh collides.

    Raises:
        SceneError: a pattern matches nothing, with the nearest name.
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    scenes: dict[tuple[str, Collision], None] = {}
    for pattern in patterns:
        plain, written = parse_reference(pattern)
        way = written if collision is None else collision
        for reference in _match(plain, Path() if base is None else base):
            # Boxes collide exactly as they are.
            scenes[reference, "terrain" if is_built_in(reference) else way] = None
    return tuple(scenes)


def is_built_in(reference: str) -> bool:
    """Say whether a reference names a built-in scene, a variant or a rung, and no files."""
    if "@" in reference:
        try:
            return rung(reference) is not None
        except SceneError:
            return False  # Its ladder has no such rung.
    name, number = parted(reference)
    return name in _BY_NAME and (number is None or has_variants(name))


def is_meant(name: str, pattern: str) -> bool:
    """Say whether a glob over the names of scenes, or `split:train` or `split:eval`, means one."""
    among = _of_split(pattern)
    return fnmatchcase(name, pattern) if among is None else name in among


def _of_split(pattern: str) -> tuple[str, ...] | None:
    """Return the scenes of a split; None if the pattern is none."""
    return next((names(split) for split in SPLITS if pattern == f"split:{split}"), None)


def _match(pattern: str, base: Path) -> list[str]:
    if rungs := _rungs(pattern, base):
        return rungs
    plain, number = parted(pattern)
    among = _of_split(plain)
    matched = [name for name in names() if fnmatchcase(name, plain)] if among is None else among
    if number is not None:
        matched = [f"{name}~{number}" for name in matched if has_variants(name)]
    if matched:
        return list(matched)
    if not pattern:
        raise SceneError("a scene pattern is empty", fix=f"name one of: {', '.join(names())}")
    local = brought(pattern, base)
    if local.startswith(PREFIX):
        return [f"{PREFIX}{(base / reference_path(local)).resolve()}"]
    if local != pattern:
        return [local]
    folder = base / pattern
    if what_is(folder) == "folder":
        return [str(folder.resolve())]
    if any(mark in pattern for mark in "*?["):
        folders = _folders(folder)
        if folders:
            return [str(folder.resolve()) for folder in folders]
    known = [*names(), *(f"split:{split}" for split in SPLITS)]
    raise SceneError(f"no scene matches {pattern!r}", fix=_hint(pattern.replace("*", ""), known))


def _rungs(pattern: str, base: Path) -> list[str]:
    """Return the rungs that a pattern means, of built-in ladders or of a folder (`FOLDER@*`)."""
    if pattern.endswith("@*") and is_ladder(folder := base / pattern.removesuffix("@*")):
        return [str(each.resolve()) for _, each in load_ladder(folder).rungs]
    return rungs_meant(pattern)


def rungs_meant(pattern: str) -> list[str]:
    """Return the rungs of built-in ladders that a name or glob such as `hurdles/bar@*` means.

    Raises:
        SceneError: a ladder that it names has no such value or setting.
    """
    name, at, values = pattern.partition("@")
    if not at:
        return []
    plain, number = parted(values)
    if not any(mark in name + plain for mark in "*?["):
        entry = rung(pattern)
        return [] if entry is None else [entry.name]
    mine = [FAMILIES[each] for each in FAMILIES if fnmatchcase(each, name)]
    all_rungs = [each.entry(value, number).name for each in mine for value in each.rungs]
    wanted = f"{name}@{plain}" if number is None else f"{name}@{plain}~{number}"
    return [each for each in all_rungs if fnmatchcase(each, wanted)]


def _hint(reference: str, known: Iterable[str]) -> str:
    """Return what a reference may have meant: a rung of a ladder, or one of the known names."""
    name, at, _ = reference.partition("@")
    if name in FAMILIES:
        return f"{name} is a ladder; name a rung, such as {FAMILIES[name].reference_of_easiest}"
    if at:
        known = [each.reference_of_easiest for each in FAMILIES.values()]
    return nearest(reference, known)


def _folders(pattern: Path) -> list[Path]:
    """Return the scene folders that a pattern of paths matches, sorted."""
    start = Path(pattern.anchor)
    try:
        files = start.glob(str(pattern.relative_to(start) / SCENE_FILE))
        return sorted(file.parent for file in files)
    except (ValueError, OSError):
        return []  # Not a pattern that paths can have.


@cache
def _built_in(reference: str) -> Scene:
    name, number = parted(reference)
    entry = rung(reference)
    if entry is None:
        entry = _BY_NAME[name] if number is None else variant(name, number, _BY_NAME)
    return entry.scene()


@dataclass(frozen=True, kw_only=True)
class FoundScene:
    """A scene, and what finds it again in any process: what `open_scene` takes."""

    scene: Scene
    reference: str
    """A built-in name, the absolute path of a folder, or `neverwhere:` and such a path."""
    collision: Collision = "terrain"

    @classmethod
    def at(cls, reference: str, collision: Collision = "terrain") -> FoundScene:
        """Return the scene of a reference; arguments and errors are those of `open_scene`."""
        scene = open_scene(reference, collision)
        return cls(scene=scene, reference=reference, collision=collision)


HUB = "hub:"
_NUMBER = re.compile(r"-?[0-9]{1,9}(?:\.[0-9]{1,12})?")


def brought(reference: str, base: Path | None = None) -> str:
    """Return a reference to files on this machine, which are fetched if they are not here yet.

    Args:
        reference: any; `hub:org/name[@revision]`, `real:NAME`, `neverwhere:NAME` where NAME is a
            published scene and no path, and rungs `LADDER@VALUE` of folders and packages become
            folders, and all others stay as they are.
        base: folder that relative paths start from; the working folder by default.

    Raises:
        SceneError: there is no such place, or it is none; or a real one has not been fetched.
        FetchError: it is not here, and its hub cannot be reached.
        PrerequisiteError: it is not here, and the extra `hub` is not installed.
        StoreError: it cannot be kept.
    """
    if reference.startswith(REAL):
        return str(kept_scan(reference).folder)
    if (on_ladder := _rung_folder(reference, base)) is not None:
        return str(on_ladder)
    from_hub = elsewhere(reference, base)
    if from_hub is None:
        return reference
    from nw_scenes.hub.fetch import located

    return _opened_by(located(from_hub))


def _rung_folder(reference: str, base: Path | None) -> Path | None:
    """Return the folder of a rung of a folder's or a package's ladder; None if it is none."""
    name, at, value = reference.rpartition("@")
    if not at or not _NUMBER.fullmatch(value) or name in FAMILIES or reference.startswith(HUB):
        return None
    if name in installed(LADDERS):
        return plugged_ladder(name).scene(float(value))
    folder = (Path() if base is None else base) / name
    return load_ladder(folder).scene(float(value)).resolve() if is_ladder(folder) else None


def plugged_ladder(name: str) -> FolderLadder:
    """Return the ladder of an installed package, whose entry point names its folder.

    Raises:
        PluginError: two packages claim the name, or it names no folder.
        SceneError: as `load_ladder`.
    """
    value = imported(LADDERS, name)
    if not isinstance(value, str | Path) or not is_ladder(Path(value)):
        raise PluginError(
            f"{subject(installed(LADDERS)[name][0])} is not a folder with a {LADDER_FILE}",
            fix=f"the entry point {name!r} must name the path of one",
        )
    return load_ladder(Path(value))


def fetch_scene(reference: str, *, file: Path | None = None) -> Fetched:
    """Return a scene as its hub has it now, fetched if it is not here.

    Args:
        reference: `hub:org/name[@revision]`, `neverwhere:NAME` or `real:NAME`.
        file: of `real:NAME`, the file itself, fetched on another machine.

    Raises:
        UsageError: a file of a scene that is not one file.
        SceneError: as `brought`; or a reference of nothing on a hub.
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    from nw_scenes.hub.fetch import fetch

    if reference.startswith(REAL):
        return fetched_scan(reference, scan_of(reference), file=file)
    if file is not None:
        raise UsageError(f"--file is of {REAL}NAME, not of {reference}", fix="remove it")
    # A folder of that name in the working folder is no reason to fetch nothing.
    from_hub = elsewhere(reference, Path("/nowhere"))
    if from_hub is None:
        name = reference.removeprefix(PREFIX)
        raise SceneError(
            f"{reference!r} is neither hub:org/name nor real:NAME nor a scene of the Neverwhere "
            "release",
            fix=nearest(name, PUBLISHED),
        )
    fetched = fetch(from_hub)
    _opened_by(fetched)
    return fetched


def elsewhere(reference: str, base: Path | None = None) -> Reference | None:
    """Return where a scene lies that is not on this machine; None of any other reference.

    Raises:
        SceneError: it begins with `hub:`, and names nothing on a hub.
    """
    if reference.startswith(HUB):
        from nw_scenes.hub.reference import parse

        return parse(reference, "scene")
    path = reference_path(reference)
    name = str(path)
    if reference.startswith(PREFIX) and name in PUBLISHED:
        from nw_scenes.hub.reference import published

        if what_is((Path() if base is None else base) / path) == "nothing":
            return published(name)
    return None


def _opened_by(fetched: Fetched) -> str:
    """Return what a fetched place is opened by."""
    if fetched.reference.startswith(PREFIX):
        return f"{PREFIX}{fetched.folder}"
    if what_is(fetched.folder / SCENE_FILE) != "file":
        raise SceneError(
            f"{fetched.reference}: its revision {fetched.revision[:12]} has no {SCENE_FILE}",
            fix="name a repository that is a scene folder",
        )
    return str(fetched.folder)


def scene_paths(reference: str) -> tuple[Path, ...]:
    """Return the folders that hold the files of a scene; none for a built-in one.

    Args:
        reference: what `get_scene` understands.

    Raises:
        SceneError: a published scene is not there.
    """
    plain, _ = parse_reference(reference)
    if is_built_in(plain):
        return ()
    if plain.startswith(PREFIX):
        places = find_places(Path(reference_path(plain)))
        return (places.folder.resolve(), places.xml.parent.resolve())
    path = Path(plain)
    return ((path.parent if path.name == SCENE_FILE else path).resolve(),)


@dataclass(frozen=True, kw_only=True)
class SceneFiles:
    """The files of a scene, as they lie beside each other."""

    files: Mapping[str, Path]
    """By name, relative to a folder above them all."""
    entry: str
    """What the scene is opened by, relative to that folder; empty = the folder itself."""
    prefix: str = ""
    """What a reference to it begins with, before the path."""


def scene_files(reference: str) -> SceneFiles | None:
    """Return the files that a scene is opened from; None for a built-in one, which has none.

    Args:
        reference: what `open_scene` understands.

    Raises:
        SceneError: the scene is not there, or its file cannot be read.
    """
    if is_built_in(reference):
        return None
    if not reference.startswith(PREFIX):
        path = Path(reference)
        folder = path.parent if path.name == SCENE_FILE else path
        return SceneFiles(files=folder_files(folder), entry="")
    path = Path(reference_path(reference)).resolve()
    places = find_places(path)
    folder, code = places.folder.resolve(), places.xml.parent.resolve()
    # The names of folder and XML say which scene it is, so they stay.
    root = Path(commonpath([folder, code])).parent
    files = [file for file in folder.rglob("*") if file.is_file()]
    files += [file for file in code.rglob("*.xml") if file.is_file()]
    return SceneFiles(
        files={file.relative_to(root).as_posix(): file for file in files},
        entry=path.relative_to(root).as_posix(),
        prefix=PREFIX,
    )


@dataclass(frozen=True, kw_only=True)
class InspectedScene:
    """What is known about a scene.

    Attributes:
        findings: all that is wrong or remarkable, errors first.
        survey: what was measured along its course; None where errors came before.
    """

    findings: tuple[SceneFinding, ...]
    survey: Survey | None


def inspect_scene(
    reference: str | Path, *, robot: str = "go1", read_splat: bool = True
) -> InspectedScene:
    """Return all that is wrong or remarkable about a scene for a robot, and its figures.

    Its course is gone along with eye and feet only where nothing else is an error.

    Args:
        reference: what `get_scene` understands.
        robot: whose stance, camera and length count.
        read_splat: look at the splat as well; a built-in scene generates it for that.

    Raises:
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    from nw_scenes.finding import has_errors, unreadable
    from nw_sim.survey import survey_scene
    from nw_sim.survey.course import course_findings

    try:
        scene, findings = _checked(reference, read_splat=read_splat)
        if scene is not None:
            findings = (*findings, *course_findings(scene, robot))
        surveyed = None
        if scene is not None and not has_errors(findings):
            surveyed = survey_scene(scene, robot=robot, read_splat=read_splat)
            findings = (*findings, *surveyed.findings)
    except SceneError as error:
        return InspectedScene(findings=unreadable(error), survey=None)
    order = ("error", "warning", "note")
    return InspectedScene(
        findings=tuple(sorted(findings, key=lambda finding: order.index(finding.severity))),
        survey=surveyed,
    )


def _checked(
    reference: str | Path, *, read_splat: bool
) -> tuple[Scene | None, tuple[SceneFinding, ...]]:
    """Return a scene, if it could be read, and what its files, start and waypoints are like."""
    from nw_scenes.check import check_scene

    plain, collision = parse_reference(str(reference))
    local = brought(plain)
    if local.startswith(PREFIX):
        published = inspect_published(local, collision=collision)
        return published.scene, published.findings
    folder = folder_of(local)
    if folder is not None:
        scene, findings = inspect_folder(folder, collision=collision)
    else:
        scene, findings = open_scene(local, collision), ()
    return scene, (*findings, *check_scene(scene, read_splat=read_splat))
