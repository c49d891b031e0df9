"""Gaussians at points, before any training."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nw_base.errors import SceneError
from nw_splat.camera import Camera, look_at
from nw_splat.gaussians import SH0
from nw_twin.gaussians.images import Photo, extent_of
from nw_twin.gaussians.initial import SKY_AWAY, gaussians_at, with_sky


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


UP = np.array([0.0, -1.0, 0.0])
"""As calibration often has it: y points down."""


def outdoors(turn, *, dark=1.0, depth=True):
    """Return a photograph of ground and sky, blue in the east, red in the west, and where the
    mesh leaves the view free: above the horizon."""
    eye = np.array([0.1 * turn, 0.0, 0.0])
    ahead = np.array([np.cos(turn), -0.1, np.sin(turn)])
    camera = Camera.from_fovy(
        width=60, height=40, fovy=0.9, T_world_camera=look_at(eye, eye + ahead, up=UP)
    )
    grey = np.full((40, 60, 3), 90, np.uint8)
    rays = Photo(name="rays", camera=camera, rgb=grey).rays()
    free = rays @ UP > 0.0
    sky = np.where(rays[..., :1] > 0.0, (60, 120, 220), (220, 120, 60)) * dark
    photo = Photo(
        name=f"{turn}.png",
        camera=camera,
        rgb=np.where(free[..., None], sky, grey).astype(np.uint8),
        inverse_depth=np.where(free, 0.0, 0.5).astype(np.float32) if depth else None,
        confidence=np.where(free, 0.0, 0.7).astype(np.float32) if depth else None,
    )
    return photo, free


def test_what_photographs_look_past_everything_at_is_sky_and_infinitely_far():
    photos, free = zip(*map(outdoors, (0.0, 0.1, 3.0, 3.1)), strict=True)
    known, sky, share = with_sky(photos, free, UP, most=800)
    assert share == pytest.approx(np.mean(free), rel=0.2)
    assert 600 < len(sky) < 1000
    for photo, before, above in zip(known, photos, free, strict=True):
        far = (photo.inverse_depth == 0.0) & (photo.confidence == 1.0)
        assert (far <= above).all()
        assert far.sum() > 0.75 * above.sum()  # What one photograph alone shows may be near.
        assert (photo.confidence[~far] == before.confidence[~far]).all()
    middle = np.mean([photo.camera.T_world_camera[:3, 3] for photo in photos], axis=0)
    away = sky.means - middle
    assert np.linalg.norm(away, axis=1) == pytest.approx(SKY_AWAY * extent_of(photos), rel=1e-3)
    heights = away @ UP / np.linalg.norm(away, axis=1)
    assert -0.09 < heights.min() < 0.0
    assert heights.max() > 0.99
    colours = 0.5 + SH0 * sky.sh[:, 0]
    east = away[:, 0] / np.linalg.norm(away, axis=1)
    blue = colours[:, 2] > colours[:, 0]
    assert blue[east > 0.3].all()  # The zenith too, which no photograph shows.
    assert not blue[east < -0.3].any()


def test_what_most_photographs_know_to_be_a_wall_is_no_sky():
    photos, free = zip(*(outdoors(0.01 * n) for n in range(3)), strict=True)
    wall = np.zeros((40, 60), dtype=bool)
    wall[:, :20] = True
    # The mesh has it in two of three photographs.
    some = [above & ~wall for above in free[:2]] + [free[2]]
    (*_, last), _, _ = with_sky(photos, some, UP, most=800)
    left = free[2][:, :15]
    assert ((last.confidence[:, :15] == 1.0) & left).sum() < 0.1 * left.sum()
    assert (last.confidence[:, 25:] == 1.0).sum() > 0.9 * free[2][:, 25:].sum()


def test_a_place_without_sky_gets_none_and_without_depths_photographs_stay_as_they_are():
    photo, free = outdoors(0.0)
    (same,), sky, share = with_sky([photo], [np.zeros_like(free)], UP, most=800)
    assert (same is photo, sky, share) == (True, None, 0.0)
    bare, free = outdoors(0.0, depth=False)
    (same, _), sky, _ = with_sky([bare, bare], [free, free], UP, most=800)
    assert same is bare
    assert len(sky) > 600


@pytest.mark.parametrize(("dark", "is_sky"), [(0.8, True), (0.4, False)])
def test_what_has_another_colour_in_each_photograph_is_near(dark, is_sky):
    photos, free = zip(outdoors(0.0), outdoors(0.05, dark=dark), strict=True)
    _, sky, _ = with_sky(photos, free, UP, most=800)
    assert (sky is not None) == is_sky
