"""Which files a scene is made of, for a process that may read no others."""

from __future__ import annotations

from pathlib import Path

from nw_eval.catalogue.find import names, parse_reference
from nw_eval.scenes.folder import SCENE_FILE
from nw_eval.scenes.neverwhere import PREFIX, reference_path
from nw_eval.scenes.neverwhere.places import find_places


def scene_paths(reference: str) -> tuple[Path, ...]:
    """Return the folders that hold the files of a scene; none for a built-in one.

    Args:
        reference: what `get_scene` understands.

    Raises:
        SceneError: a published scene is not there.
    """
    plain, _ = parse_reference(reference)
    if plain in names():
        return ()
    if plain.startswith(PREFIX):
        places = find_places(Path(reference_path(plain)))
        return (places.folder.resolve(), places.xml.parent.resolve())
    path = Path(plain)
    return ((path.parent if path.name == SCENE_FILE else path).resolve(),)
