"""Which pictures are compared, and in which range of depths."""

import numpy as np
from twin_parts import captured, placed

from nw_splat.camera import Camera, look_at
from nw_twin.reconstruct.views import depth_range, neighbours_of


def capture_of(degrees, *, seen=40):
    """Shots that look at one cloud from 3 m, each from so many degrees along a circle."""
    rng, shots = np.random.default_rng(0), []
    for n, angle in enumerate(np.deg2rad(degrees)):
        T = look_at((3 * np.cos(angle), 3 * np.sin(angle), 0.0), (0.0, 0.0, 0.0))
        camera = Camera.from_fovy(width=64, height=48, fovy=1.0, T_world_camera=T)
        shots.append(placed(f"{n}.jpg", camera, range(seen)))
    return captured(shots, rng.uniform(-0.3, 0.3, (40, 3)))


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
