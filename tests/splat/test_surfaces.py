"""Depth where rays meet Gaussians, against the plane that large flat ones lie on."""

import numpy as np
import pytest

from nw_base.lens import Intrinsics
from nw_splat.camera import Camera, Pixels, look_at
from nw_splat.gaussians import Gaussians
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store

WIDTH, HEIGHT = 80, 48
FISHEYE = {"model": "fisheye", "coefficients": (-0.0046, 0.0397, -0.0374, 0.0062)}
EYE = np.array([0.0, 0.0, 0.3])


@pytest.fixture(scope="module")
def ground():
    """Discs of 0.25 m on z = 0, as a baked floor or a trained lawn has them."""
    x, y = np.meshgrid(np.arange(-12.0, 12.0, 0.3), np.arange(-12.0, 12.0, 0.3))
    means = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)
    count = len(means)
    return memory_store(
        Gaussians(
            means=means,
            log_scales=np.log(np.tile([0.25, 0.25, 0.001], (count, 1))),
            quats=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            opacity_logits=np.full(count, 6.0),
            sh=np.zeros((count, 1, 3)),
        )
    )


def camera_of(distortion=None):
    lens = Intrinsics(
        width=WIDTH, height=HEIGHT, fx=40.0, fy=40.0, cx=41.0, cy=23.0, distortion=distortion
    )
    return Camera.of(lens, look_at(EYE, EYE + np.array([1.0, 0.2, -0.2])))


def to_the_ground(camera):
    """Depth along the axis at which pixels meet z = 0, (H, W) m; inf above the horizon."""
    x, y = np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5
    rays = np.concatenate([camera.lens.grid(x, y), np.ones((HEIGHT, WIDTH, 1))], axis=-1)
    down = rays @ -camera.T_world_camera[2, :3]
    return np.where(down > 0.0, EYE[2] / np.where(down > 0.0, down, 1.0), np.inf)


@pytest.mark.parametrize(
    "distortion",
    [None, pytest.param(FISHEYE, marks=pytest.mark.nightly)],  # Kernels of its own.
)
@pytest.mark.parametrize("samples", [1, 4])
def test_large_discs_are_met_where_the_ray_meets_their_plane(ground, distortion, samples):
    camera = camera_of(distortion)
    renderer = CpuRenderer(ground, samples=samples)
    depth, alpha = renderer.surface(camera)
    truth = to_the_ground(camera)
    seen = truth < 2.5  # Farther, a pixel is longer than a tenth of its distance.
    assert seen.sum() > 1500
    assert (alpha[seen] > 0.9).all()
    off = np.abs(depth[seen] - truth[seen]) / truth[seen]
    assert np.median(off) < 0.01
    assert np.percentile(off, 95) < 0.04
    centres = CpuRenderer(ground, projection="ray", samples=samples).render(camera).depth
    assert np.median(off) < 0.2 * np.median(np.abs(centres[seen] - truth[seen]) / truth[seen])
    assert np.isinf(depth[alpha == 0.0]).all()


def test_rows_of_a_picture_and_of_its_surfaces_have_the_bits_of_the_whole(ground):
    camera, pixels = camera_of(), Pixels(stride=2, block=1, offset=1)
    renderer = CpuRenderer(ground, projection="ray", samples=4, threads=2)
    whole, part = renderer.render(camera, pixels), renderer.render(camera, pixels, (7, 15))
    np.testing.assert_array_equal(part.rgb, whole.rgb[7:15])
    np.testing.assert_array_equal(part.depth, whole.depth[7:15])
    depth, alpha = renderer.surface(camera, pixels)
    some, covered = renderer.surface(camera, pixels, (7, 15))
    np.testing.assert_array_equal(some, depth[7:15])
    np.testing.assert_array_equal(covered, alpha[7:15])
    np.testing.assert_array_equal(alpha, whole.alpha)
