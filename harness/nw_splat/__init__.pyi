from nw_base.lens import Distortion
from nw_splat.camera import Camera, Pixels, look_at
from nw_splat.files import compiled_store, read_splat, write_splat
from nw_splat.gaussians import Gaussians, SplatFigures, describe, transformed
from nw_splat.image import Image
from nw_splat.portrait import framing_camera, save_png
from nw_splat.render import CpuRenderer, Renderer, open_renderer
from nw_splat.store import memory_store, open_store

__all__ = [
    "Camera",
    "CpuRenderer",
    "Distortion",
    "Gaussians",
    "Image",
    "Pixels",
    "Renderer",
    "SplatFigures",
    "compiled_store",
    "describe",
    "framing_camera",
    "look_at",
    "memory_store",
    "open_renderer",
    "open_store",
    "read_splat",
    "save_png",
    "transformed",
    "write_splat",
]
