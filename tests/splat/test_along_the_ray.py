"""Gaussians evaluated along each pixel's ray: against float64, and what must not change a bit."""

import dataclasses
import math

import numpy as np
import pytest
import torch
from splat_reference import render
from splat_rooms import cloud, eye_camera, psnr, room

from nw_base.errors import UsageError
from nw_splat import render as render_module
from nw_splat.camera import Camera, Pixels, look_at
from nw_splat.gaussians import concatenate
from nw_splat.render import SAMPLED_EPS2D, CpuRenderer, open_renderer
from nw_splat.store import memory_store

PUBLISHED = Pixels(stride=16, block=2, offset=7)


def _near_camera(width, height, *, eye=(0.0, 0.0, 0.25)):
    """121 degrees wide, low over the ground, as the camera of a robot."""
    focal = width / 2 / math.tan(math.radians(60.5))
    return Camera(
        width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2,
        T_world_camera=look_at(eye, np.add(eye, (1.0, 0.2, -0.25))),
    )  # fmt: skip


@pytest.fixture(scope="module")
def near():
    """Discs on the ground and needles around the camera, large against their distance."""
    rng = np.random.default_rng(4)
    ground = cloud(800, degree=1, seed=2, spread=(1.5, 1.5, 0.02), centre=(0.8, 0.0, -0.05))
    discs = rng.normal(-2.0, 0.4, (800, 3))
    discs[:, 2] -= 3.0
    ground = dataclasses.replace(
        ground,
        log_scales=discs.astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (800, 1)),
    )
    return concatenate(ground, cloud(300, degree=1, seed=3, centre=(0.5, 0.0, 0.5)))


def _same(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("rgb", "depth", "alpha")
    )


@pytest.mark.parametrize("antialiased", [True, False])
def test_pictures_agree_with_the_least_distance_along_the_ray_in_float64(near, antialiased):
    camera = _near_camera(64, 36)
    renderer = CpuRenderer(memory_store(near), antialiased=antialiased, projection="ray")
    rgb, depth, alpha = render(near, camera, antialiased=antialiased, dtype=torch.float64, ray=True)
    image = renderer.render(camera)
    assert psnr((image.rgb, rgb)) >= 90
    assert np.abs(image.rgb - rgb).max() < 4.5e-3
    assert np.abs(image.alpha - alpha).max() < 4.5e-3
    assert np.abs(image.depth - depth)[alpha > 0.5].max() < 0.03
    tangent = CpuRenderer(memory_store(near), antialiased=antialiased).render(camera)
    assert psnr((tangent.rgb, rgb)) < 30, "which EWA does not, so near to a wide camera"


def test_four_samples_are_the_mean_of_smaller_pixels_with_hardly_any_low_pass(near):
    camera = _near_camera(32, 18)
    fine = _near_camera(64, 36)
    image = CpuRenderer(memory_store(near), projection="ray", samples=4).render(camera)
    rgb, depth, alpha = (
        values.reshape(18, 2, 32, 2, -1)
        for values in render(
            near, fine, antialiased=True, dtype=torch.float64, ray=True, eps2d=SAMPLED_EPS2D
        )
    )
    assert psnr((image.rgb, rgb.mean(axis=(1, 3)))) >= 90
    covered = alpha.mean(axis=(1, 3))[..., 0]
    assert np.abs(image.alpha - covered).max() < 4.5e-3
    mean = (depth * alpha).mean(axis=(1, 3))[..., 0] / np.maximum(covered, 1e-10)
    assert np.median(np.abs(image.depth - mean)[covered > 0.5]) < 1e-4


def test_far_and_small_gaussians_look_as_with_ewa():
    gaussians = cloud(2000, degree=0, spread=(3.0, 3.0, 1.0), centre=(0.0, 0.0, 30.0))
    camera = Camera(
        width=96, height=64, fx=200.0, fy=200.0, cx=48.0, cy=32.0, T_world_camera=np.eye(4)
    )
    store = memory_store(gaussians)
    ewa, ray = (CpuRenderer(store, projection=each).render(camera) for each in ("ewa", "ray"))
    assert psnr((ewa.rgb, ray.rgb)) > 50


@pytest.fixture(scope="module")
def store():
    return memory_store(room(30_000, degree=1))


@pytest.mark.parametrize("samples", [1, 4])
def test_pixel_sets_threads_and_slabs_change_no_bit(store, samples, monkeypatch):
    options = {"projection": "ray", "samples": samples}
    camera = eye_camera(1, 320, 180)
    full = CpuRenderer(store, **options).render(camera)
    for pixels in (PUBLISHED, Pixels(stride=3, block=1, offset=2), Pixels(stride=7, block=3)):
        part = CpuRenderer(store, **options).render(camera, pixels)
        for name in ("rgb", "depth", "alpha"):
            assert np.array_equal(getattr(part, name), pixels.crop(getattr(full, name)))
    assert _same(CpuRenderer(store, threads=3, **options).render(camera), full)
    monkeypatch.setattr(render_module, "_SLAB_CHUNKS", 2)
    assert _same(CpuRenderer(store, **options).render(camera), full)


def test_near_drops_gaussians_by_their_centre(store):
    camera = eye_camera(1, 80, 45)
    moved = dataclasses.replace(camera, near=1.0)
    assert _same(CpuRenderer(store, near=1.0).render(camera), CpuRenderer(store).render(moved))
    assert not _same(CpuRenderer(store, near=1.0).render(camera), CpuRenderer(store).render(camera))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"projection": "rays"}, "unknown projection 'rays'"),
        ({"samples": 2}, "samples is 2"),
        ({"near": 0.0}, "near is 0.0"),
    ],
)
def test_what_cannot_be_drawn_is_refused(store, options, message):
    with pytest.raises(UsageError, match=message):
        CpuRenderer(store, **options)


@pytest.mark.parametrize("options", [{"projection": "ray"}, {"samples": 4}, {"near": 0.2}])
def test_the_cuda_backend_refuses_other_pictures_than_the_published_by_name(store, options):
    ((name, value),) = options.items()
    with pytest.raises(UsageError, match=f"--render cuda cannot draw with {name} {value}"):
        open_renderer(store, "cuda", **options)
