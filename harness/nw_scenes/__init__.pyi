from nw_scenes.mesh import TriangleMesh as TriangleMesh
from nw_scenes.scene import Box as Box
from nw_scenes.scene import Plane as Plane
from nw_scenes.scene import Scene as Scene
from nw_scenes.scene import Spawn as Spawn
