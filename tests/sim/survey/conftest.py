"""A corridor as a scan, sound or damaged, and cameras that photographed it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from nw_scenes import Plane, Scene
from nw_scenes.mesh import TriangleMesh
from nw_scenes.scene import CaptureCameras
from nw_scenes.terrain import build_terrain

sys.path.insert(0, str(Path(__file__).parent))

from sample_corridor import START, TRAIL, FilledSplat, corridor, gaussians_on


@pytest.fixture
def place(tmp_path):
    """Returns a scan of a corridor as a scene; `means` replaces the Gaussians' places."""

    def make(shape=None, means=None, *, splat=True, **changes):
        shape = corridor() if shape is None else shape
        mesh = TriangleMesh(
            vertices=np.array(shape.vertices, dtype=np.float64),
            faces=np.array(shape.faces, dtype=np.int32),
            kinds=np.zeros(len(shape.faces), dtype=np.uint8),
        )
        terrain = build_terrain(mesh, trail=TRAIL, spawn=START)
        looks = None
        if splat:
            means = gaussians_on(shape) if means is None else means
            looks = FilledSplat(tmp_path / f"{len(list(tmp_path.iterdir()))}.nwsplat", means)
        words = {"task": "stairs", "trail": TRAIL} | changes
        return Scene(
            name="corridor",
            title="",
            solids=terrain.solids,
            ground=Plane(z=terrain.floor),
            static_mesh=mesh,
            splat=looks,
            **words,
        )

    return make


@pytest.fixture
def cameras():
    """Returns capture cameras that looked along the corridor from a height."""

    def make(height, turn=0.0):
        x = np.linspace(-0.5, 4.0, 10)
        positions = np.column_stack([x, 0 * x, 0 * x + height])
        axis = [np.cos(turn), np.sin(turn), 0.0]
        return CaptureCameras(positions=positions, axes=np.tile(axis, (10, 1)))

    return make
