"""A picture or a turn of a splat, for people: what `nw-eval splat render` draws."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.splat.cameras.camera import Camera, look_at
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.image import Image
from nw_eval.splat.movies.movie import save_mp4
from nw_eval.splat.movies.turntable import axes, framing_camera, orbit, save_gif, save_png
from nw_eval.splat.store import memory_store
from nw_eval.words import Backend, UpAxis

if TYPE_CHECKING:
    from nw_eval.splat.render import Renderer

SUFFIXES = (".png", ".gif", ".mp4")

Point = tuple[float, float, float]
Circuit = Callable[[int], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""Given a number, as many places for a camera (N, 3) on a way round, and what it looks at (3,)."""

_FOVY = math.radians(60.0)


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What is drawn: Gaussians seen from outside, or a place with the camera in it.

    Attributes:
        gaussians: all of them.
        up: upward axis of their frame.
        stand: where the camera of a place stands for a still, looking ahead.
        circuit: the camera's way round a place.
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
    ) -> None:
        """Write a still (.png), or a turn round the subject (.gif, .mp4).

        Args:
            path: what to write; one of `SUFFIXES`.
            size: pixels across and down.
            eye: where the camera stands, in the Gaussians' frame; a turn looks round from there.
            target: of a still; what it looks at.
            frames: of a turn.
            backend: the renderer.

        Raises:
            SceneError, UsageError, PrerequisiteError: it cannot be drawn.
        """
        from nw_eval.splat.render import open_renderer

        renderer = open_renderer(memory_store(self.gaussians), backend)
        if path.suffix.lower() == ".png":
            save_png(path, renderer.render(self._still(size, eye, target)))
            return
        turn = self._turn(renderer, size, frames, eye)
        (save_gif if path.suffix.lower() == ".gif" else save_mp4)(path, turn)

    def _still(self, size: tuple[int, int], eye: Point | None, target: Point | None) -> Camera:
        stand = self.stand if eye is None else eye
        if stand is None:
            width, height = size
            return framing_camera(self.gaussians, width=width, height=height, up=self.up)
        if target is not None:
            looked_at = np.asarray(target)
        elif self.stand is not None:
            looked_at = np.asarray(stand) + axes(self.up)[1]
        else:
            looked_at = _middle(self.gaussians)
        return self._camera(size, np.asarray(stand), looked_at)

    def _turn(
        self, renderer: Renderer, size: tuple[int, int], frames: int, eye: Point | None
    ) -> Iterator[Image]:
        if eye is not None:
            _, ahead, aside = axes(self.up)
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
        T = look_at(eye, target, axes(self.up)[0])
        return Camera.from_fovy(width=width, height=height, fovy=_FOVY, T_world_camera=T)


def _middle(gaussians: Gaussians) -> NDArray[np.float64]:
    finite = gaussians.means[np.isfinite(gaussians.means).all(axis=1)]
    return np.median(finite, axis=0).astype(np.float64)
