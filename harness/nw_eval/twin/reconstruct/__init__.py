"""From a capture to depth maps with confidence and a mesh.

By default all of it is done here: a plane sweep with semi-global matching measures the depth of
each shot, a truncated signed distance joins them, and marching cubes cut its surface. OpenMVS does
the same where its programs are installed and it is chosen.
"""

from nw_eval.twin.reconstruct.depth import array_file, depth_maps, depth_of, read_depth
from nw_eval.twin.reconstruct.mesh import ColourMesh, read_colour_mesh, write_mesh
from nw_eval.twin.reconstruct.options import DepthOptions, ReconstructOptions
from nw_eval.twin.reconstruct.reconstruct import ReconstructReport, reconstruct

__all__ = [
    "ColourMesh",
    "DepthOptions",
    "ReconstructOptions",
    "ReconstructReport",
    "array_file",
    "depth_maps",
    "depth_of",
    "read_colour_mesh",
    "read_depth",
    "reconstruct",
    "write_mesh",
]
