"""Scenes by name or path: a built-in place, a scene folder, or a published one."""

from nw_eval.catalogue.find import (
    get_scene,
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
    "get_scene",
    "is_meant",
    "match_scenes",
    "names",
    "open_scene",
    "parse_reference",
    "references",
]
