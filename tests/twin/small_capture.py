"""A place of a few hundred Gaussians and photographs of it, for tests of training."""

import math

import numpy as np
from splat_rooms import room

from nw_eval.splat import Camera, CpuRenderer, look_at, memory_store
from nw_eval.twin.gaussians.initial import gaussians_at
from nw_eval.twin.gaussians.photo import Photo
from nw_eval.twin.gaussians.raster.rasteriser import Rasteriser

PLACE = room(1500, degree=0)
"""Twenty metres of room; a ring of cameras looks at its middle."""


def camera(number, count, width=72, height=48):
    """Return one of a ring of cameras round the middle of the room."""
    turn = 2 * math.pi * number / count
    eye = np.array([7 * math.cos(turn), 7 * math.sin(turn), 1.5 + 0.5 * math.sin(3 * turn)])
    T = look_at(eye, np.array([0.0, 0.0, 0.5]))
    return Camera.from_fovy(width=width, height=height, fovy=1.1, T_world_camera=T)


def photos(count=6, *, gains=None, depth=False, first=0.0):
    """Return photographs by the shipped renderer, each with a gain of its own if some are given."""
    renderer, found = CpuRenderer(memory_store(PLACE)), []
    for i in range(count):
        view = camera(i + first, count)
        rgb = renderer.render(view).rgb * (1.0 if gains is None else gains[i % len(gains)])
        known = Rasteriser().render(PLACE, view).inverse_depth if depth else None
        found.append(
            Photo(
                name=f"{i:02d}.png",
                camera=view,
                rgb=(np.clip(rgb, 0, 1) * 255).astype(np.uint8),
                inverse_depth=known,
            )
        )
    return found


def beginning(count=700, *, degree=0, seed=1, **options):
    """Return Gaussians at some of the place's own centres, a hand's breadth off, all grey."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(PLACE), count, replace=False)
    points = PLACE.means[rows] + rng.normal(0, 0.1, (count, 3))
    return gaussians_at(points, np.full((count, 3), 0.5), sh_degree=degree, **options)
