"""Scenes: what physics touches, what rays meet, what cameras see, and the course through them."""

from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.scene import Box, Plane, Scene, Spawn

__all__ = ["Box", "Plane", "Scene", "Spawn", "TriangleMesh"]
