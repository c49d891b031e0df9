"""Scenes by name or path: a built-in place, a scene folder, or a published one."""

from nw_eval.catalogue.find import get_scene, match_scenes, names, references

__all__ = ["get_scene", "match_scenes", "names", "references"]
