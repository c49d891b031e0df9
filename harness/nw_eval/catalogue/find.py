"""The built-in scenes by name, and scene folders by path."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from nw_eval.built_in.entries import ENTRIES
from nw_eval.built_in.splits import SPLITS, Split, split_of
from nw_eval.errors import SceneError, nearest
from nw_eval.inside import what_is
from nw_eval.scenes.folder import SCENE_FILE, load_folder
from nw_eval.scenes.neverwhere import PREFIX, load_published, reference_path
from nw_eval.scenes.scene import Scene
from nw_eval.scenes.terrain.options import Collision

TRIANGLES = "triangles:"
"""Before a reference: collide by the mesh's own triangles."""

_BY_NAME = {entry.name: entry for entry in ENTRIES}


def names(split: Split | None = None) -> tuple[str, ...]:
    """Return the names of all built-in scenes, or of those of one split, sorted."""
    return tuple(name for name in sorted(_BY_NAME) if split is None or split_of(name) == split)


def get_scene(name_or_path: str | Path) -> Scene:
    """Return a built-in scene by its name, or the scene of a folder by its path.

    Args:
        name_or_path: a name, a folder, or `neverwhere:<folder>`; `triangles:` before a folder makes
            its mesh collide by its own triangles, slow and exact, to check the terrain with.

    Raises:
        SceneError: no such scene (with the nearest name), or the folder cannot be read.
    """
    reference = str(name_or_path)
    collision: Collision = "triangles" if reference.startswith(TRIANGLES) else "terrain"
    reference = reference.removeprefix(TRIANGLES)
    if reference in _BY_NAME:
        return _built_in(reference)  # Boxes collide exactly as they are.
    if reference.startswith(PREFIX):
        return load_published(reference, collision=collision)
    path = Path(reference)
    if path.name == SCENE_FILE:
        path = path.parent
    if what_is(path) == "folder":
        return load_folder(path, collision=collision)
    raise SceneError(
        f"no built-in scene and no folder is called {reference!r}",
        fix=nearest(reference, _BY_NAME),
    )


def match_scenes(
    patterns: Sequence[str], base: Path | None = None, *, collision: Collision = "terrain"
) -> tuple[Scene, ...]:
    """Return the scenes that patterns name: by pattern, then by name, each once.

    Args:
        patterns: names of built-in scenes, globs over those, `split:train`, `split:eval`, or paths
            of scene folders.
        base: folder that relative paths start from; the working folder by default.
        collision: how scan meshes collide; `triangles` is as `triangles:` before each.

    Raises:
        SceneError: a pattern matches nothing, with the nearest name.
    """
    return tuple(get_scene(key) for key in _keys(patterns, base, collision))


def references(
    patterns: Sequence[str], base: Path | None = None, *, collision: Collision = "terrain"
) -> dict[str, str]:
    """Return, by name, what `get_scene` understands for the scenes that patterns name.

    Raises:
        SceneError: as `match_scenes`.
    """
    return {_name(key): key for key in _keys(patterns, base, collision)}


def _name(key: str) -> str:
    """Return the name of the scene that a key means; a built-in one is not built for it."""
    return key if key in _BY_NAME else get_scene(key).name


def _keys(patterns: Sequence[str], base: Path | None, collision: Collision) -> list[str]:
    """Return what patterns match, each once."""
    keys: dict[str, None] = {}
    for pattern in patterns:
        plain = pattern.removeprefix(TRIANGLES)
        exact = TRIANGLES if collision == "triangles" or plain != pattern else ""
        for key in _match(plain, Path() if base is None else base):
            keys[key if key in _BY_NAME else f"{exact}{key}"] = None
    return list(keys)


def _match(pattern: str, base: Path) -> list[str]:
    for split in SPLITS:
        if pattern == f"split:{split}":
            return list(names(split))
    matched = [name for name in names() if fnmatchcase(name, pattern)]
    if matched:
        return matched
    if not pattern:
        raise SceneError("a scene pattern is empty", fix=f"name one of: {', '.join(names())}")
    if pattern.startswith(PREFIX):
        return [f"{PREFIX}{(base / reference_path(pattern)).resolve()}"]
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
def _built_in(name: str) -> Scene:
    return _BY_NAME[name].scene()
