"""Places that lie elsewhere: on this machine once they have been fetched."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.errors import SceneError, nearest
from nw_eval.files.inside import what_is
from nw_eval.scenes.folder import SCENE_FILE
from nw_eval.scenes.neverwhere import PREFIX as NEVERWHERE
from nw_eval.scenes.neverwhere import reference_path
from nw_eval.scenes.neverwhere.table import PUBLISHED

if TYPE_CHECKING:
    from nw_eval.hub.fetched import Fetched
    from nw_eval.hub.reference import Reference

HUB = "hub:"


def brought(reference: str, base: Path | None = None) -> str:
    """Return a reference to files on this machine, which are fetched if they are not here yet.

    Args:
        reference: any; `hub:org/name[@revision]`, and `neverwhere:NAME` where NAME is a published
            scene and no path, become folders, and all others stay as they are.
        base: folder that relative paths start from; the working folder by default.

    Raises:
        SceneError: there is no such place, or it is none.
        FetchError: it is not here, and its hub cannot be reached.
        PrerequisiteError: it is not here, and the extra `hub` is not installed.
        StoreError: it cannot be kept.
    """
    from_hub = elsewhere(reference, base)
    if from_hub is None:
        return reference
    from nw_eval.hub.fetch import located

    return _opened_by(located(from_hub))


def fetch_scene(reference: str) -> Fetched:
    """Return a place as its hub has it now, fetched if it is not here.

    Raises:
        SceneError: as `brought`; or a reference of nothing on a hub.
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    from nw_eval.hub.fetch import fetch

    # A folder of that name in the working folder is no reason to fetch nothing.
    from_hub = elsewhere(reference, Path("/nowhere"))
    if from_hub is None:
        name = reference.removeprefix(NEVERWHERE)
        raise SceneError(
            f"{reference!r} is neither hub:org/name nor a scene of the Neverwhere release",
            fix=nearest(name, PUBLISHED),
        )
    fetched = fetch(from_hub)
    _opened_by(fetched)
    return fetched


def elsewhere(reference: str, base: Path | None = None) -> Reference | None:
    """Return where a place lies that is not on this machine; None of any other reference.

    Raises:
        SceneError: it begins with `hub:`, and names nothing on a hub.
    """
    if reference.startswith(HUB):
        from nw_eval.hub.reference import parse

        return parse(reference, "scene")
    path = reference_path(reference)
    name = str(path)
    if reference.startswith(NEVERWHERE) and name in PUBLISHED:
        from nw_eval.hub.reference import published

        if what_is((Path() if base is None else base) / path) == "nothing":
            return published(name)
    return None


def _opened_by(fetched: Fetched) -> str:
    """Return what a fetched place is opened by."""
    if fetched.reference.startswith(NEVERWHERE):
        return f"{NEVERWHERE}{fetched.folder}"
    if what_is(fetched.folder / SCENE_FILE) != "file":
        raise SceneError(
            f"{fetched.reference}: its revision {fetched.revision[:12]} has no {SCENE_FILE}",
            fix="name a repository that is a scene folder",
        )
    return str(fetched.folder)
