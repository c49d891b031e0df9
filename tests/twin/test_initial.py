"""Gaussians at points, before any training."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nw_eval.errors import SceneError
from nw_eval.twin.gaussians.initial import gaussians_at


def test_sizes_are_the_distances_to_the_three_nearest():
    points = np.random.default_rng(0).normal(size=(500, 3)) * (3.0, 1.0, 0.1)
    points[7] = points[8]  # Two in one place.
    colours = np.random.default_rng(1).random((500, 3))
    g = gaussians_at(points, colours, sh_degree=2, size=0.5)
    squares = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    wanted = 0.5 * np.sqrt(np.sort(squares, axis=1)[:, 1:4].mean(axis=1))
    assert np.exp(g.log_scales[:, 0]) == pytest.approx(wanted, rel=1e-4)
    assert (g.log_scales == g.log_scales[:, :1]).all()


def test_gaussians_of_a_surface_lie_flat_in_it():
    draw = np.random.default_rng(2)
    normals = draw.normal(size=(200, 3))
    normals[:2] = [(0, 0, -1), (1, 0, 0)]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = draw.normal(size=(200, 3))
    g = gaussians_at(points, np.full((200, 3), 0.5), normals)
    rotations = Rotation.from_quat(g.quats, scalar_first=True).as_matrix()
    squares = rotations @ (np.exp(2 * g.log_scales)[..., None] * rotations.transpose(0, 2, 1))
    round_ones = gaussians_at(points, np.full((200, 3), 0.5))
    across = np.einsum("ni,nij,nj->n", normals, squares, normals)
    assert np.sqrt(across) == pytest.approx(0.1 * np.exp(round_ones.log_scales[:, 0]), rel=1e-3)
    assert g.log_scales[:, :2] == pytest.approx(round_ones.log_scales[:, :2])


def test_each_has_its_points_colour_from_every_side():
    g = gaussians_at(np.eye(4)[:, :3], np.full((4, 3), 0.7), sh_degree=1, opacity=0.1)
    assert 0.5 + 0.28209479177387814 * g.sh[:, 0] == pytest.approx(0.7)
    assert g.sh.shape == (4, 4, 3)
    assert (g.sh[:, 1:] == 0).all()
    assert 1 / (1 + np.exp(-g.opacity_logits)) == pytest.approx(0.1, rel=1e-5)


@pytest.mark.parametrize(
    ("points", "colours", "words"),
    [
        (np.zeros((3, 3)), np.zeros((3, 3)), "at least 4 points"),
        (np.zeros((9, 3)), np.zeros((8, 3)), "as many colours"),
        (np.full((9, 3), np.nan), np.zeros((9, 3)), "not finite"),
    ],
)
def test_points_that_cannot_be_begun_with_are_refused(points, colours, words):
    with pytest.raises(SceneError, match=words):
        gaussians_at(points, colours)
