"""Scenes by name or path: a built-in place, a scene folder, a published one, or one of a hub."""

from nw_eval.catalogue.brought import brought, fetch_scene
from nw_eval.catalogue.find import (
    get_scene,
    is_built_in,
    is_meant,
    match_scenes,
    names,
    open_scene,
    parse_reference,
    references,
)
from nw_eval.catalogue.found import FoundScene

__all__ = [
    "FoundScene",
    "brought",
    "fetch_scene",
    "get_scene",
    "is_built_in",
    "is_meant",
    "match_scenes",
    "names",
    "open_scene",
    "parse_reference",
    "references",
]
