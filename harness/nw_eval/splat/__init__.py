"""Gaussian splats: files in and out, a compiled store, and renderers for CPU and CUDA.

    image = CpuRenderer(open_store(compiled_store(read_splat(path)))).render(camera)

Bottom layer: imports nothing of nw_eval but errors and cache. Importing this package is cheap;
Numba is loaded when a renderer is first asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from nw_eval.splat.cameras.camera import Camera, look_at
from nw_eval.splat.cameras.camera_model import CameraModel
from nw_eval.splat.cameras.pixels import Pixels
from nw_eval.splat.cameras.presets import PRESETS, Preset, PresetName
from nw_eval.splat.compiled import compiled_store
from nw_eval.splat.composite import composite, paste
from nw_eval.splat.describe import SplatFigures, describe
from nw_eval.splat.files import RestOrder, read_splat, write_splat
from nw_eval.splat.gaussians import Gaussians, concatenate
from nw_eval.splat.image import Image
from nw_eval.splat.movies.turntable import framing_camera, orbit, save_gif, save_png
from nw_eval.splat.store import Store, compile_store, memory_store, open_store
from nw_eval.splat.transform import transformed
from nw_eval.splat.warmup import warmup

if TYPE_CHECKING:
    from nw_eval.splat.render import CpuRenderer, Renderer, Stages, open_renderer

__all__ = [
    "PRESETS",
    "Camera",
    "CameraModel",
    "CpuRenderer",
    "Gaussians",
    "Image",
    "Pixels",
    "Preset",
    "PresetName",
    "Renderer",
    "RestOrder",
    "SplatFigures",
    "Stages",
    "Store",
    "compile_store",
    "compiled_store",
    "composite",
    "concatenate",
    "describe",
    "framing_camera",
    "look_at",
    "memory_store",
    "open_renderer",
    "open_store",
    "orbit",
    "paste",
    "read_splat",
    "save_gif",
    "save_png",
    "transformed",
    "warmup",
    "write_splat",
]

_LAZY = {
    "CpuRenderer": "render",
    "Renderer": "render",
    "Stages": "render",
    "open_renderer": "render",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
