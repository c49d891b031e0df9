"""A corridor with a step and a ramp, as boxes or as a scan, with a splat that fits it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

START = np.zeros(3)
TRAIL = np.array([[2.0, 0.0, 0.1], [4.0, 0.0, 0.0]])


class FilledSplat:
    """Gaussians at given places, flat on the surface that they were sampled from."""

    key = "filled"

    def __init__(self, path: Path, means):
        self.path, self.means = path, means

    def store(self, _progress=None):
        from nw_splat.gaussians import Gaussians
        from nw_splat.store import compile_store

        count = len(self.means)
        gaussians = Gaussians(
            means=self.means,
            log_scales=np.full((count, 3), np.log(0.02)),
            quats=np.tile([1.0, 0, 0, 0], (count, 1)),
            opacity_logits=np.full(count, 5.0),
            sh=np.zeros((count, 1, 3)),
        )
        compile_store(gaussians, self.path)
        return self.path


def box(low, high):
    low, high = np.array(low, float), np.array(high, float)
    shape = trimesh.creation.box(high - low)
    shape.apply_translation((low + high) / 2)
    return shape


def corridor(floor=None):
    """Floor, a step of 10 cm from 1.5 to 2.5 m, walls at 1 m to both sides and at the end."""
    parts = [
        box((-1.5, -1.0, -0.2), (5.5, 1.0, 0.0)) if floor is None else floor,
        box((1.5, -1.0, -0.1), (2.5, 1.0, 0.1)),
        box((-1.5, 1.0, -0.2), (5.5, 1.2, 2.0)),
        box((-1.5, -1.2, -0.2), (5.5, -1.0, 2.0)),
        box((5.5, -1.2, -0.2), (5.7, 1.2, 2.0)),
    ]
    return trimesh.util.concatenate(parts)


def gaussians_on(shape, count=120_000):
    points, _ = trimesh.sample.sample_surface(shape, count, seed=0)
    inside = (points[:, 0] > -1.4) & (points[:, 2] > -0.15)
    return points[inside]


def floor_with_hole(x0, x1, y0, y1):
    return trimesh.util.concatenate(
        [
            box((-1.5, -1.0, -0.2), (x0, 1.0, 0.0)),
            box((x1, -1.0, -0.2), (5.5, 1.0, 0.0)),
            box((x0, -1.0, -0.2), (x1, y0, 0.0)),
            box((x0, y1, -0.2), (x1, 1.0, 0.0)),
        ]
    )
