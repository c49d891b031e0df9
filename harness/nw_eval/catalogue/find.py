"""The built-in scenes by name, and scene folders by path."""

from __future__ import annotations

import os
from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from nw_eval.built_in.entries import ENTRIES, has_variants, parted, variant
from nw_eval.built_in.splits import SPLITS, Split, split_of
from nw_eval.catalogue.brought import brought
from nw_eval.errors import SceneError, nearest
from nw_eval.files.inside import what_is
from nw_eval.scenes.folder import SCENE_FILE, load_folder
from nw_eval.scenes.neverwhere import PREFIX, load_published, reference_path
from nw_eval.scenes.scene import Scene
from nw_eval.words import Collision

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
        name_or_path: a name, a folder, `neverwhere:<folder>`, or a place that `brought` fetches;
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
    if is_built_in(reference):
        return _built_in(reference)
    if reference.startswith(PREFIX):
        return load_published(reference, collision=collision)
    folder = folder_of(reference)
    if folder is not None:
        return load_folder(folder, collision=collision)
    raise SceneError(
        f"no built-in scene and no folder is called {reference!r}",
        fix=nearest(reference, _BY_NAME),
    )


def folder_of(reference: str) -> Path | None:
    """Return the folder that a reference names, itself or by its `scene.yaml`; None if it is none.

    The name of a built-in scene is no folder's, whatever lies in the working folder.
    """
    if reference in _BY_NAME or reference.startswith(PREFIX):
        return None
    path = Path(reference)
    if path.name == SCENE_FILE:
        path = path.parent
    return path if what_is(path) == "folder" else None


def from_folder(reference: str, folder: Path) -> str:
    """Return what names the same scene from another folder: a path in it starts there."""
    plain, collision = parse_reference(reference)
    begin = _TRIANGLES if collision == "triangles" else ""
    here = folder_of(plain)
    if here is not None:
        return begin + Path(os.path.relpath(here, folder)).as_posix()
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
            these with `~2` behind it for their second variants, or paths of scene folders,
            `neverwhere:...`, `hub:...`; `triangles:` before any of them as in `get_scene`. What is
            not on this machine is fetched.
        base: folder that relative paths start from; the working folder by default.
        collision: how meshes collide, whatever the patterns say of it; as they say if None.

    Returns:
        By pattern, then by name, each once: a built-in name, the absolute path of a folder, or
        `neverwhere:` and such a path; and how its mesh collides.

    Raises:
        SceneError: a pattern matches nothing, with the nearest name.
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    found: dict[tuple[str, Collision], None] = {}
    for pattern in patterns:
        plain, written = parse_reference(pattern)
        way = written if collision is None else collision
        for reference in _match(plain, Path() if base is None else base):
            # Boxes collide exactly as they are.
            found[reference, "terrain" if is_built_in(reference) else way] = None
    return tuple(found)


def is_built_in(reference: str) -> bool:
    """Say whether a reference names a built-in scene, or a variant of one, and no files."""
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
    plain, number = parted(pattern)
    among = _of_split(plain)
    matched = [name for name in names() if fnmatchcase(name, plain)] if among is None else among
    if number is not None:
        matched = [f"{name}~{number}" for name in matched if has_variants(name)]
    if matched:
        return list(matched)
    if not pattern:
        raise SceneError("a scene pattern is empty", fix=f"name one of: {', '.join(names())}")
    here = brought(pattern, base)
    if here.startswith(PREFIX):
        return [f"{PREFIX}{(base / reference_path(here)).resolve()}"]
    if here != pattern:
        return [here]
    folder = base / pattern
    if what_is(folder) == "folder":
        return [str(folder.resolve())]
    if any(mark in pattern for mark in "*?["):
        folders = _folders(folder)
        if folders:
            return [str(folder.resolve()) for folder in folders]
    raise SceneError(
        f"no scene matches {pattern!r}",
        fix=nearest(pattern.replace("*", ""), [*names(), *(f"split:{split}" for split in SPLITS)]),
    )


def _folders(pattern: Path) -> list[Path]:
    """Return the scene folders that a pattern of paths matches, sorted."""
    start = Path(pattern.anchor)
    try:
        found = start.glob(str(pattern.relative_to(start) / SCENE_FILE))
        return sorted(file.parent for file in found)
    except (ValueError, OSError):
        return []  # Not a pattern that paths can have.


@cache
def _built_in(reference: str) -> Scene:
    name, number = parted(reference)
    entry = _BY_NAME[name] if number is None else variant(name, number, _BY_NAME)
    return entry.scene()
