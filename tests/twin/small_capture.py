"""A place of a thousand Gaussians and photographs of it, for tests of training."""

import math

import numpy as np

from nw_splat.camera import Camera, look_at
from nw_splat.gaussians import SH0, Gaussians
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store
from nw_twin.gaussians.images import Photo
from nw_twin.gaussians.initial import gaussians_at
from nw_twin.gaussians.rasteriser import Rasteriser

_SIDE, _TILE = 26, 0.32
"""Tiles along each side of the floor, and metres of one."""


def _place():
    """A floor of coloured tiles with three balls on it."""
    rng = np.random.default_rng(7)
    grid = np.stack(np.meshgrid(np.arange(_SIDE), np.arange(_SIDE)), axis=-1).reshape(-1, 2)
    floor = np.column_stack([(grid - (_SIDE - 1) / 2) * _TILE, np.zeros(len(grid))])
    shade = 0.3 + 0.5 * ((grid // 3).sum(axis=1) % 2)[:, None]
    colours = [np.clip(shade * [1.0, 0.9, 0.7] + rng.normal(0, 0.08, (len(grid), 3)), 0, 1)]
    points, sizes = [floor], [np.tile([0.6 * _TILE, 0.6 * _TILE, 0.02], (len(grid), 1))]
    for x, y, colour in ((1.2, 0.3, (0.9, 0.2, 0.1)), (-0.8, 1.0, (0.1, 0.4, 0.9)), (0, -1.3, 0.1)):
        ball = rng.normal(size=(120, 3))
        ball *= 0.6 / np.linalg.norm(ball, axis=1, keepdims=True)
        colours.append(np.clip(np.ones((120, 3)) * colour + 0.3 * ball, 0, 1))
        points.append(ball + np.array([x, y, 0.6]))
        sizes.append(np.full((120, 3), 0.1))
    n = len(floor) + 360
    return Gaussians(
        means=np.concatenate(points),
        log_scales=np.log(np.concatenate(sizes)),
        quats=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        opacity_logits=np.full(n, 3.0),
        sh=((np.concatenate(colours) - 0.5) / SH0)[:, None],
    )


PLACE = _place()
"""Eight metres of floor; a ring of cameras looks at its middle."""


def camera(number, count, width=72, height=48):
    """Return one of a ring of cameras round the middle."""
    turn = 2 * math.pi * number / count
    eye = np.array([4 * math.cos(turn), 4 * math.sin(turn), 2.5 + 0.4 * math.sin(3 * turn)])
    T = look_at(eye, np.array([0.0, 0.0, 0.2]))
    return Camera.from_fovy(width=width, height=height, fovy=0.9, T_world_camera=T)


def photos(count=6, *, gains=None, depth=False, first=0.0, background=(1.0, 1.0, 1.0)):
    """Return photographs by the shipped renderer, each with a gain of its own if some are given."""
    renderer, found = CpuRenderer(memory_store(PLACE), projection="ray", background=background), []
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
    points = PLACE.means[rows] + rng.normal(0, 0.05, (count, 3))
    return gaussians_at(points, np.full((count, 3), 0.5), sh_degree=degree, **options)
