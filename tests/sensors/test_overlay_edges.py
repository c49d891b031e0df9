"""Outlines of drawn objects are soft: their pixels are covered in part."""

import numpy as np

from nw_eval.sensors.cones import Cones
from nw_eval.sensors.overlay import draw, ray_directions
from nw_eval.splat.camera import Camera, look_at
from nw_eval.splat.pixels import Pixels


def overlay(width, *, soft):
    T = look_at((0.0, 0.0, 0.15), (1.0, 0.05, 0.1))
    camera = Camera.from_fovy(width=width, height=width, fovy=0.9, T_world_camera=T)
    pitch = (1.0 / camera.fx, 1.0 / camera.fy) if soft else None
    cones = Cones(np.array([[0.6, 0.02, 0.0], [1.1, -0.1, 0.0]]))
    return draw(ray_directions(camera, Pixels()), T, cones=cones, robot=None, pitch=pitch)


def test_the_coverage_of_an_outline_is_that_of_many_rays():
    many = overlay(64 * 12, soft=False).coverage.reshape(64, 12, 64, 12).mean(axis=(1, 3))
    soft = overlay(64, soft=True).coverage
    hard = overlay(64, soft=False).coverage
    assert set(np.unique(hard)) == {0.0, 1.0}
    partly = (soft > 0.0) & (soft < 1.0)
    assert partly.sum() > 50
    # Nine rays cannot be off by more than about two of them, and mean far less.
    assert np.abs(soft - many)[partly].max() < 0.3
    assert np.abs(soft - many).mean() < 0.35 * np.abs(hard - many).mean()


def test_soft_edges_change_nothing_inside_and_nothing_outside():
    soft, hard = overlay(64, soft=True), overlay(64, soft=False)
    whole = soft.coverage == 1.0
    # A pixel spans up to 3 cm of a slanted cone: the mean of nine depths is not the middle one.
    np.testing.assert_allclose(soft.depth[whole], hard.depth[whole], atol=0.03)
    empty = soft.coverage == 0.0
    assert np.isinf(soft.depth[empty]).all()
    np.testing.assert_array_equal(soft.rgb[empty], 0.0)
