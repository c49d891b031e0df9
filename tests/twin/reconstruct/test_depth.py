"""Which pictures are compared, and how costs are smoothed."""

import numpy as np
import pytest

from nw_eval.splat.camera import Camera, look_at
from nw_eval.twin.capture import Capture, PlacedShot
from nw_eval.twin.reconstruct.sweep_kernels import smooth, winners
from nw_eval.twin.reconstruct.views import depth_range, neighbours_of


def capture_of(degrees, *, seen=40):
    """Shots that look at one cloud from 3 m, each from so many degrees along a circle."""
    rng, shots = np.random.default_rng(0), []
    for n, angle in enumerate(np.deg2rad(degrees)):
        T = look_at((3 * np.cos(angle), 3 * np.sin(angle), 0.0), (0.0, 0.0, 0.0))
        camera = Camera.from_fovy(width=64, height=48, fovy=1.0, T_world_camera=T)
        shown = np.arange(seen, dtype=np.int32)
        shots.append(PlacedShot(name=f"{n}.jpg", file=f"{n}.png", camera=camera, seen=shown))
    return Capture(
        shots=tuple(shots),
        points=rng.uniform(-0.3, 0.3, (40, 3)),
        colours=np.zeros((40, 3), np.uint8),
        errors=np.zeros(40, np.float32),
    )


def test_neighbours_stand_neither_too_near_nor_too_far():
    capture = capture_of([0.0, 1.0, 12.0, 40.0, 80.0])
    assert neighbours_of(capture, 3)[0] == [2, 3, 4]
    assert neighbours_of(capture, 2)[4] == [3, 2]


def test_shots_that_share_few_points_are_no_neighbours():
    assert neighbours_of(capture_of([0.0, 12.0], seen=7), 5) == [[], []]
    assert depth_range(capture_of([0.0, 12.0], seen=7), 0) is None


def test_the_range_of_depths_is_that_of_the_points_and_some_more():
    near, far = depth_range(capture_of([0.0]), 0)
    assert 2.7 / 1.15 < near < 2.8 / 1.15
    assert 3.2 * 1.15 < far < 3.3 * 1.15


def along(costs, step, jumps):
    """Hirschmueller's recursion along one row of pixels, as the paper writes it."""
    path = [costs[0].astype(float)]
    for cost, jump in zip(costs[1:], jumps, strict=True):
        last, least = path[-1], path[-1].min()
        padded = np.pad(last, 1, constant_values=np.inf)
        best = np.minimum.reduce(
            [last, padded[:-2] + step, padded[2:] + step, last * 0 + least + jump]
        )
        path.append(cost + best - least)
    return np.array(path)


@pytest.mark.parametrize("planes", [8, 13])
def test_costs_are_summed_along_four_paths(planes):
    rng = np.random.default_rng(1)
    volume = rng.integers(0, 1001, (6, 5, planes)).astype(np.uint16)
    total = np.zeros_like(volume)
    smooth(volume, np.zeros((6, 5), np.float32), 40, 300, total)
    right = np.zeros(volume.shape)
    for y in range(6):
        right[y] += along(volume[y], 40, [300] * 4)
        right[y] += along(volume[y, ::-1], 40, [300] * 4)[::-1]
    for x in range(5):
        right[:, x] += along(volume[:, x], 40, [300] * 5)
        right[:, x] += along(volume[::-1, x], 40, [300] * 5)[::-1]
    assert (total == right).all()


def test_depth_jumps_at_less_cost_where_the_picture_changes():
    volume = np.full((1, 8, 16), 500, np.uint16)
    volume[0, :4, 3] = volume[0, 4:, 12] = 300
    volume[0, 3:5] = 500  # What lies at the edge is not clear.
    grey, total = np.zeros((1, 8), np.float32), np.zeros_like(volume)
    grey[0, 4:] = 100.0
    smooth(volume, grey, 40, 300, total)
    plane, likeness, unique = (np.empty((1, 8), np.float32) for _ in range(3))
    winners(volume, total, plane, likeness, unique)
    assert np.round(plane[0]).tolist() == [3] * 4 + [12] * 4
    assert likeness[0, 0] == pytest.approx(0.4)
    assert (unique > 0).all()
