"""Which files a scene is made of: for a process that may read no others, or another machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os.path import commonpath
from pathlib import Path

from nw_eval.catalogue.find import is_built_in, parse_reference
from nw_eval.scenes.folder import SCENE_FILE, folder_files
from nw_eval.scenes.neverwhere import PREFIX, reference_path
from nw_eval.scenes.neverwhere.files import find_places


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
    found = [file for file in folder.rglob("*") if file.is_file()]
    found += [file for file in code.rglob("*.xml") if file.is_file()]
    return SceneFiles(
        files={file.relative_to(root).as_posix(): file for file in found},
        entry=path.relative_to(root).as_posix(),
        prefix=PREFIX,
    )
