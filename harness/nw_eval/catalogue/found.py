"""A scene beside what finds it again."""

from __future__ import annotations

from dataclasses import dataclass

from nw_eval.catalogue.find import open_scene
from nw_eval.scenes.scene import Scene
from nw_eval.words import Collision


@dataclass(frozen=True, kw_only=True)
class FoundScene:
    """A scene, and what finds it again in any process: what `open_scene` takes."""

    scene: Scene
    reference: str
    """A built-in name, the absolute path of a folder, or `neverwhere:` and such a path."""
    collision: Collision = "terrain"

    @classmethod
    def at(cls, reference: str, collision: Collision = "terrain") -> FoundScene:
        """Return the scene of a reference; arguments and errors are those of `open_scene`."""
        scene = open_scene(reference, collision)
        return cls(scene=scene, reference=reference, collision=collision)
