"""The built-in scenes by name, and scene folders by path."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

from nw_eval.errors import SceneError, nearest
from nw_eval.scenes.entries import ENTRIES
from nw_eval.scenes.folder import SCENE_FILE, load_folder
from nw_eval.scenes.neverwhere import PREFIX, load_published, reference_path
from nw_eval.scenes.scene import Scene
from nw_eval.scenes.splits import SPLITS, Split, split_of

_BY_NAME = {entry.name: entry for entry in ENTRIES}


def names(split: Split | None = None) -> tuple[str, ...]:
    """Return the names of all built-in scenes, or of those of one split, sorted."""
    return tuple(name for name in sorted(_BY_NAME) if split is None or split_of(name) == split)


def get_scene(name_or_path: str | Path) -> Scene:
    """Return a built-in scene by its name, or the scene of a folder by its path.

    Raises:
        SceneError: no such scene (with the nearest name), or the folder cannot be read.
    """
    if str(name_or_path) in _BY_NAME:
        return _built_in(str(name_or_path))
    if str(name_or_path).startswith(PREFIX):
        return load_published(name_or_path)
    path = Path(name_or_path)
    if path.name == SCENE_FILE:
        path = path.parent
    if path.is_dir():
        return load_folder(path)
    raise SceneError(
        f"no built-in scene and no folder is called {str(name_or_path)!r}",
        fix=nearest(str(name_or_path), _BY_NAME),
    )


def match_scenes(patterns: Sequence[str], base: Path | None = None) -> tuple[Scene, ...]:
    """Return the scenes that patterns name: by pattern, then by name, each once.

    Args:
        patterns: names of built-in scenes, globs over those, `split:train`, `split:eval`, or paths
            of scene folders.
        base: folder that relative paths start from; the working folder by default.

    Raises:
        SceneError: a pattern matches nothing, with the nearest name.
    """
    found: dict[str, Scene] = {}
    for pattern in patterns:
        for key in _match(pattern, Path() if base is None else base):
            if key not in found:
                found[key] = get_scene(key)
    return tuple(found.values())


def references(patterns: Sequence[str], base: Path | None = None) -> dict[str, str]:
    """Return, by name, what `get_scene` understands for the scenes that patterns name.

    Raises:
        SceneError: as `match_scenes`.
    """
    keys = [key for p in patterns for key in _match(p, Path() if base is None else base)]
    return {get_scene(key).name: key for key in keys}


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
    if (folder / SCENE_FILE).is_file() or folder.is_dir():
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
