from nw_scenes.mesh import TriangleMesh
from nw_scenes.scene import Box, Plane, Scene, Spawn

__all__ = [
    "Box",
    "Plane",
    "Scene",
    "Spawn",
    "TriangleMesh",
]
