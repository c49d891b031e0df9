"""Pictures of a splat without knowing the place: a camera that frames it, and an orbit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError
from nw_eval.files.cache import atomic_path, followed
from nw_eval.splat.cameras.camera import Camera, look_at
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.image import Image
from nw_eval.words import UpAxis

if TYPE_CHECKING:
    from nw_eval.splat.render import Renderer

_FOVY = math.radians(50.0)


def framing_camera(
    gaussians: Gaussians,
    *,
    width: int,
    height: int,
    up: UpAxis = "-y",
    azimuth: float = 0.6,
    elevation: float = 0.3,
    zoom: float = 1.0,
) -> Camera:
    """Return a camera that has the bulk of the Gaussians in view.

    Args:
        gaussians: what to look at.
        width: of the image, pixels.
        height: of the image, pixels.
        up: upward axis of their frame.
        azimuth: of the camera around the upward axis, radians.
        elevation: of the camera above the horizontal, radians.
        zoom: 2 halves the distance.

    Raises:
        SceneError: when no centre is finite.
    """
    centre, radius = _bulk(gaussians)
    upward, first, second = axes(up)
    flat = math.cos(azimuth) * first + math.sin(azimuth) * second
    direction = math.cos(elevation) * flat + math.sin(elevation) * upward
    narrow = 2 * math.atan(math.tan(_FOVY / 2) * min(1.0, width / height))
    distance = radius / math.sin(narrow / 2) / zoom
    T = look_at(centre + distance * direction, centre, upward)
    return Camera.from_fovy(width=width, height=height, fovy=_FOVY, T_world_camera=T)


def orbit(
    renderer: Renderer,
    gaussians: Gaussians,
    *,
    frames: int = 48,
    width: int = 480,
    height: int = 360,
    up: UpAxis = "-y",
    elevation: float = 0.3,
) -> Iterator[Image]:
    """Yield the frames of one turn around the bulk of the Gaussians."""
    for i in range(frames):
        camera = framing_camera(
            gaussians,
            width=width,
            height=height,
            up=up,
            azimuth=2 * math.pi * i / frames,
            elevation=elevation,
        )
        yield renderer.render(camera)


def save_png(path: Path, image: Image) -> None:
    """Write an image as PNG."""
    from PIL import Image as Picture

    with atomic_path(followed(path)) as temporary:
        Picture.fromarray(image.bytes()).save(temporary, format="PNG")


def save_gif(path: Path, images: Iterable[Image], *, rate: float = 12.0) -> None:
    """Write images as an endless GIF of `rate` frames a second.

    Raises:
        SceneError: when there is no image.
    """
    from PIL import Image as Picture

    pictures = [Picture.fromarray(image.bytes()) for image in images]
    if not pictures:
        raise SceneError(f"{path}: no frames to write", fix="ask for one at least")
    with atomic_path(followed(path)) as temporary:
        pictures[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=round(1000 / rate),
            loop=0,
        )


def _bulk(gaussians: Gaussians) -> tuple[NDArray[np.float64], float]:
    """Middle of the bulk, and the distance from it that nearly all centres keep."""
    centres = gaussians.means[np.isfinite(gaussians.means).all(axis=1)].astype(np.float64)
    if len(centres) == 0:
        raise SceneError("no Gaussian has a finite centre", fix="check the file")
    low, high = np.percentile(centres, [1, 99], axis=0)
    middle = (low + high) / 2
    distance = np.linalg.norm(centres - middle, axis=1)
    return middle, max(float(np.percentile(distance, 98)) * 1.05, 1e-6)


def axes(up: UpAxis) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(upward, and two axes of the horizontal plane)."""
    index = "xyz".index(up[1])
    upward = np.zeros(3)
    upward[index] = 1.0 if up[0] == "+" else -1.0
    first = np.zeros(3)
    first[(index + 1) % 3] = 1.0
    return upward, first, np.cross(upward, first)
