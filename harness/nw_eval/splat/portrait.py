"""A picture or a turn of a splat, for people: what `nw-eval splat render` draws."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from nw_eval.splat.camera import Camera, look_at
from nw_eval.splat.files import read_splat
from nw_eval.splat.gaussians import Gaussians
from nw_eval.splat.image import Image
from nw_eval.splat.movie import save_mp4
from nw_eval.splat.store import Store, memory_store, open_store
from nw_eval.splat.turntable import Up, axes, framing_camera, orbit, save_gif, save_png

if TYPE_CHECKING:
    from nw_eval.splat.render import Renderer

SUFFIXES = (".png", ".gif", ".mp4")

Point = tuple[float, float, float]
_FOVY = math.radians(60.0)


@dataclass(frozen=True, kw_only=True)
class Subject:
    """What is drawn: Gaussians seen from outside, or a place in which the camera stands."""

    store: Store
    up: Up
    gaussians: Gaussians | None = None
    stand: Point | None = None

    def draw(
        self,
        path: Path,
        *,
        size: tuple[int, int],
        eye: Point | None = None,
        target: Point | None = None,
        frames: int = 48,
        backend: Literal["cpu", "cuda"] = "cpu",
    ) -> None:
        """Write a still (.png) or a turn (.gif, .mp4).

        Args:
            path: what to write; one of `SUFFIXES`.
            size: pixels across and down.
            eye: of a still, in the splat's own frame.
            target: of a still; what it looks at.
            frames: of a turn.
            backend: the renderer.

        Raises:
            SceneError, UsageError, PrerequisiteError: it cannot be drawn.
        """
        from nw_eval.splat.render import open_renderer

        renderer = open_renderer(self.store, backend)
        if path.suffix.lower() == ".png":
            save_png(path, renderer.render(self._still(size, eye, target)))
            return
        turn = self._turn(renderer, size, frames)
        (save_gif if path.suffix.lower() == ".gif" else save_mp4)(path, turn)

    def _still(self, size: tuple[int, int], eye: Point | None, target: Point | None) -> Camera:
        width, height = size
        upward, ahead, _ = axes(self.up)
        stand = self.stand if eye is None else eye
        if stand is None:
            assert self.gaussians is not None
            return framing_camera(self.gaussians, width=width, height=height, up=self.up)
        if target is None and self.gaussians is not None:
            target = _middle(self.gaussians)
        looked_at = np.asarray(stand) + ahead if target is None else np.asarray(target)
        T = look_at(stand, looked_at, upward)
        return Camera.from_fovy(width=width, height=height, fovy=_FOVY, T_world_camera=T)

    def _turn(self, renderer: Renderer, size: tuple[int, int], frames: int) -> Iterator[Image]:
        width, height = size
        if self.stand is None:
            assert self.gaussians is not None
            yield from orbit(
                renderer, self.gaussians, frames=frames, width=width, height=height, up=self.up
            )
            return
        upward, ahead, aside = axes(self.up)
        for index in range(frames):
            angle = 2.0 * math.pi * index / frames
            towards = np.asarray(self.stand) + math.cos(angle) * ahead + math.sin(angle) * aside
            T = look_at(self.stand, towards, upward)
            yield renderer.render(
                Camera.from_fovy(width=width, height=height, fovy=_FOVY, T_world_camera=T)
            )


def of_file(path: Path, *, up: Up) -> Subject:
    """Return the Gaussians of a file, seen from outside.

    Raises:
        SceneError: the file cannot be read.
    """
    gaussians = read_splat(path)
    return Subject(store=memory_store(gaussians), gaussians=gaussians, up=up)


def of_store(path: Path, *, stand: Point) -> Subject:
    """Return a compiled place whose z axis points up, seen from a point in it along x."""
    return Subject(store=open_store(path), stand=stand, up="+z")


def _middle(gaussians: Gaussians) -> Point:
    finite = gaussians.means[np.isfinite(gaussians.means).all(axis=1)]
    x, y, z = np.median(finite, axis=0).tolist()
    return x, y, z
