"""A picture or a turn of a splat, for people: what `nw-eval splat render` draws.

Where nothing says where to stand, a camera frames the bulk of the Gaussians, and a turn goes round
it. MP4 goes through the ffmpeg that the user has.
"""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PrerequisiteError, SceneError, UsageError
from nw_base.files.cache import atomic_path, followed
from nw_base.words import Backend, Projection, UpAxis
from nw_splat.camera import Camera, look_at
from nw_splat.gaussians import Gaussians
from nw_splat.image import Image
from nw_splat.store import memory_store

if TYPE_CHECKING:
    from nw_splat.render import Renderer

SUFFIXES = (".png", ".gif", ".mp4")

Point = tuple[float, float, float]
Circuit = Callable[[int], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Given a number, as many places for a camera (N, 3) on a way round, and what it looks at (3,)."""

_FOVY = math.radians(60.0)

_FRAMING_FOVY = math.radians(50.0)

_BACKDROP = 5.0
"""Median distances from the middle, beyond which Gaussians are a sky, and not framed."""


def check(path: Path, eye: Point | None, target: Point | None) -> None:
    """Refuse a picture that cannot be drawn, before anything is read.

    Raises:
        UsageError: its name has no known ending, or `target` is given without `eye`.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise UsageError(f"{path}: cannot draw {suffix or 'nothing'!r}", fix=f"name one of {known}")
    if target is not None and eye is None:
        raise UsageError("--target needs --eye", fix="give the camera's position, too")


@dataclass(frozen=True, kw_only=True)
class Subject:
    """Subject of a picture: Gaussians seen from outside, or a scene with the camera in it.

    Attributes:
        gaussians: all of them.
        up: upward axis of their frame.
        stand: where the camera of a scene stands for a still, looking ahead.
        circuit: the camera's way around a scene.
    """

    gaussians: Gaussians
    up: UpAxis
    stand: Point | None = None
    circuit: Circuit | None = None

    def draw(
        self,
        path: Path,
        *,
        size: tuple[int, int],
        eye: Point | None = None,
        target: Point | None = None,
        frames: int = 48,
        backend: Backend = "cpu",
        projection: Projection = "ray",
    ) -> None:
        """Write a still (.png), or a turn round the subject (.gif, .mp4).

        Args:
            path: what to write; one of `SUFFIXES`.
            size: pixels across and down.
            eye: where the camera stands, in the Gaussians' frame; a turn looks round from there.
            target: of a still; the point that the camera looks at.
            frames: of a turn.
            backend: the renderer.
            projection: how Gaussians become pixels.

        Raises:
            SceneError, UsageError, PrerequisiteError: it cannot be drawn.
        """
        from nw_splat.render import open_renderer

        renderer = open_renderer(memory_store(self.gaussians), backend, projection=projection)
        if path.suffix.lower() == ".png":
            save_png(path, renderer.render(self._still(size, eye, target)))
            return
        turn = self._turn(renderer, size, frames, eye)
        (save_gif if path.suffix.lower() == ".gif" else _save_mp4)(path, turn)

    def _still(self, size: tuple[int, int], eye: Point | None, target: Point | None) -> Camera:
        stand = self.stand if eye is None else eye
        if stand is None:
            width, height = size
            return framing_camera(self.gaussians, width=width, height=height, up=self.up)
        if target is not None:
            looked_at = np.asarray(target)
        elif self.stand is not None:
            looked_at = np.asarray(stand) + _axes(self.up)[1]
        else:
            looked_at = _middle(self.gaussians)
        return self._camera(size, np.asarray(stand), looked_at)

    def _turn(
        self, renderer: Renderer, size: tuple[int, int], frames: int, eye: Point | None
    ) -> Iterator[Image]:
        if eye is not None:
            _, ahead, aside = _axes(self.up)
            for angle in np.arange(frames) * (2.0 * math.pi / frames):
                towards = math.cos(angle) * ahead + math.sin(angle) * aside
                yield renderer.render(self._camera(size, np.asarray(eye), eye + towards))
        elif self.circuit is not None:
            eyes, looked_at = self.circuit(frames)
            for stand in eyes:
                yield renderer.render(self._camera(size, stand, looked_at))
        else:
            width, height = size
            yield from orbit(
                renderer, self.gaussians, frames=frames, width=width, height=height, up=self.up
            )

    def _camera(
        self, size: tuple[int, int], eye: NDArray[np.float64], target: NDArray[np.float64]
    ) -> Camera:
        width, height = size
        T = look_at(eye, target, _axes(self.up)[0])
        return Camera.from_fovy(width=width, height=height, fovy=_FOVY, T_world_camera=T)


def _middle(gaussians: Gaussians) -> NDArray[np.float64]:
    finite = gaussians.means[np.isfinite(gaussians.means).all(axis=1)]
    return np.median(finite, axis=0).astype(np.float64)


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
    upward, first, second = _axes(up)
    flat = math.cos(azimuth) * first + math.sin(azimuth) * second
    direction = math.cos(elevation) * flat + math.sin(elevation) * upward
    narrow = 2 * math.atan(math.tan(_FRAMING_FOVY / 2) * min(1.0, width / height))
    distance = radius / math.sin(narrow / 2) / zoom
    T = look_at(centre + distance * direction, centre, upward)
    return Camera.from_fovy(width=width, height=height, fovy=_FRAMING_FOVY, T_world_camera=T)


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


def _bulk(gaussians: Gaussians) -> tuple[NDArray[np.float64], float]:
    """Middle of the bulk, and the distance from it that nearly all centres keep."""
    centres = gaussians.means[np.isfinite(gaussians.means).all(axis=1)].astype(np.float64)
    if len(centres) == 0:
        raise SceneError("no Gaussian has a finite centre", fix="check the file")
    away = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
    centres = centres[away <= _BACKDROP * np.median(away)]
    low, high = np.percentile(centres, [1, 99], axis=0)
    middle = (low + high) / 2
    distance = np.linalg.norm(centres - middle, axis=1)
    return middle, max(float(np.percentile(distance, 98)) * 1.05, 1e-6)


def _axes(up: UpAxis) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(upward, and two _axes of the horizontal plane)."""
    index = "xyz".index(up[1])
    upward = np.zeros(3)
    upward[index] = 1.0 if up[0] == "+" else -1.0
    first = np.zeros(3)
    first[(index + 1) % 3] = 1.0
    return upward, first, np.cross(upward, first)


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


def _save_mp4(path: Path, images: Iterable[Image], *, rate: float = 24.0) -> None:
    """Write images of one size as H.264 video of `rate` frames a second.

    Raises:
        PrerequisiteError: there is no ffmpeg.
        SceneError: there is no image, or ffmpeg cannot write the file.
    """
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise PrerequisiteError(
            f"writing {path} needs ffmpeg", fix="install ffmpeg, or name a .gif instead"
        )
    frames = iter(images)
    first = next(frames, None)
    if first is None:
        raise SceneError(f"{path}: no frame to write", fix="ask for at least one frame")
    height, width, _ = first.bytes().shape
    with atomic_path(followed(path)) as temporary:
        command = [ffmpeg, "-loglevel", "error", "-y"]
        command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        command += ["-r", f"{rate:g}", "-i", "-", "-an", "-c:v", "libx264"]
        # Players want even sides and 4:2:0.
        command += ["-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2", "-pix_fmt", "yuv420p"]
        data = b"".join(image.bytes().tobytes() for image in chain([first], frames))
        done = subprocess.run(  # noqa: S603 - fixed arguments, no shell.
            [*command, "-f", "mp4", str(temporary)], input=data, capture_output=True, check=False
        )
        if done.returncode != 0:
            lines = done.stderr.decode(errors="replace").strip().splitlines()
            raise SceneError(
                f"{path}: ffmpeg failed: {lines[-1] if lines else done.returncode}",
                fix="name a .gif instead",
            )
