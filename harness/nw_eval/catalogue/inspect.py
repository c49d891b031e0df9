"""The findings about any scene that a suite can name: built in, a folder, or published."""

from __future__ import annotations

from pathlib import Path

from nw_eval.catalogue.brought import brought
from nw_eval.catalogue.find import get_scene
from nw_eval.errors import SceneError
from nw_eval.scenes.health.check import check_scene
from nw_eval.scenes.health.finding import SceneFinding, unreadable
from nw_eval.scenes.neverwhere import PREFIX, inspect_published


def inspect_scene(reference: str | Path, *, read_splat: bool = True) -> tuple[SceneFinding, ...]:
    """Return all that is wrong or remarkable about a scene, errors first.

    Args:
        reference: what `get_scene` understands.
        read_splat: look into the splat as well; a built-in scene generates it for that.

    Raises:
        FetchError, PrerequisiteError, StoreError: as `brought`.
    """
    try:
        here = brought(str(reference))
        if here.startswith(PREFIX):
            return inspect_published(here).findings
        found = check_scene(get_scene(here), read_splat=read_splat)
    except SceneError as error:
        return unreadable(error)
    order = ("error", "warning", "note")
    return tuple(sorted(found, key=lambda finding: order.index(finding.severity)))
