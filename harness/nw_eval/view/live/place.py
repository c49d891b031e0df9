"""A place as somebody changes it: boxes stand in it, and its trail ends elsewhere."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from nw_eval.scenes.mesh import merge
from nw_eval.scenes.scene import Box, Progress, Scene, SplatSource
from nw_eval.splat.files import read_splat
from nw_eval.splat.gaussians import ARRAYS, Gaussians
from nw_eval.splat.store import FORMAT, compile_store
from nw_eval.splat.transform import transformed
from nw_eval.view.live.boxes import mesh_of, painted


@dataclass(frozen=True, kw_only=True)
class ChangedPlace:
    """What was done to a place.

    Attributes:
        scene: as it was.
        folder: in which its Gaussians are put together; the changed place needs it.
        boxes: that stand in it.
        goal: x, y of the last waypoint, m; None where it was.
    """

    scene: Scene
    folder: Path
    boxes: tuple[Box, ...] = ()
    goal: tuple[float, float] | None = None

    @property
    def is_changed(self) -> bool:
        """Whether anything was."""
        return bool(self.boxes) or self.goal is not None

    def changed(self) -> Scene:
        """Return the place as it is now."""
        scene = self.scene
        if self.goal is not None:
            trail = scene.trail.copy()
            trail[-1, :2] = self.goal
            scene = replace(scene, trail=trail)
        if not self.boxes:
            return scene
        mesh = merge([scene.static_mesh, *map(mesh_of, self.boxes)])
        splat = scene.splat
        return replace(
            scene,
            solids=(*scene.solids, *self.boxes),
            static_mesh=mesh,
            splat=None if splat is None else SplatWithBoxes(scene, splat, self.boxes, self.folder),
        )


@dataclass(frozen=True)
class SplatWithBoxes:
    """The Gaussians of a place, and those of boxes in it."""

    scene: Scene
    source: SplatSource
    boxes: tuple[Box, ...]
    folder: Path

    @property
    def key(self) -> str:
        """Hex digest of everything that can change the Gaussians."""
        return self._key

    @cached_property
    def _key(self) -> str:
        words = [[*box.center, *box.half_size, *box.quat] for box in self.boxes]
        return hashlib.sha256(f"{self.source.key}{json.dumps(words)}".encode()).hexdigest()

    def store(self, progress: Progress | None = None) -> Path:
        """Return the compiled store, in the folder and not in the cache."""
        path = self.folder / f"{self.key[:32]}.nwsplat"
        if not path.exists():
            compile_store(self.gaussians(progress), path, key=f"{FORMAT}:{self.key}")
        return path

    def gaussians(self, progress: Progress | None = None) -> Gaussians:
        """Return them, in the splat's own frame."""
        place = read_splat(self.source.store(progress))
        own = np.linalg.inv(self.scene.T_world_splat).astype(np.float64)
        boxes = transformed(painted(self.boxes, place.sh.shape[1]), own)
        return Gaussians(
            **{
                name: np.concatenate([getattr(place, name), getattr(boxes, name)])
                for name in ARRAYS
            },
            rasterize_mode=place.rasterize_mode,
        )
