"""Splats through a lens, against pinhole pictures that are bent afterwards by resampling."""

import dataclasses

import cv2
import numpy as np
import pytest
from splat_rooms import eye_camera, psnr, room

from nw_base.errors import UsageError
from nw_base.lens import Intrinsics
from nw_splat.camera import Camera, Pixels
from nw_splat.render import CpuRenderer, open_renderer
from nw_splat.store import memory_store

BARREL = ("radial_tangential", (-0.25, 0.08, 1e-3, -2e-3, -0.01), 150.0)
FISHEYE = ("fisheye", (-0.0046, 0.0397, -0.0374, 0.0062), 150.0)  # 125 degrees across
WIDTH, HEIGHT = 320, 180


@pytest.fixture(scope="module")
def store():
    return memory_store(room(30_000, degree=1))


def camera_of(model, coefficients, focal):
    lens = Intrinsics(
        width=WIDTH, height=HEIGHT, fx=focal, fy=focal, cx=158.0, cy=92.0,
        distortion={"model": model, "coefficients": coefficients},
    )  # fmt: skip
    return Camera.of(lens, eye_camera(1, WIDTH, HEIGHT).T_world_camera)


def resampled(store, camera, fine=4, across=6):
    """The mean over each pixel of a pinhole picture with `fine` times its focal length."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    slopes, focal = camera.lens.slopes(x, y), fine * camera.fx
    low, high = slopes.min((0, 1)) - 0.02, slopes.max((0, 1)) + 0.02
    width, height = (int(side) + 1 for side in (high - low) * focal)
    pinhole = Camera(
        width=width, height=height, fx=focal, fy=focal, cx=-low[0] * focal, cy=-low[1] * focal,
        T_world_camera=camera.T_world_camera,
    )  # fmt: skip
    picture = CpuRenderer(store, projection="ray").render(pinhole).rgb
    total = np.zeros((HEIGHT, WIDTH, 3))
    parts = (np.arange(across) + 0.5) / across - 0.5
    for i in parts:
        for j in parts:
            at = (camera.lens.slopes(x + i, y + j) - low) * focal - 0.5
            total += cv2.remap(picture, *np.float32(at).transpose(2, 0, 1), cv2.INTER_LINEAR)
    return total / across**2


@pytest.mark.parametrize("lens", [BARREL, FISHEYE])
def test_a_lens_drawn_directly_is_a_bent_pinhole_picture(store, lens):
    camera = camera_of(*lens)
    truth = resampled(store, camera)
    one = CpuRenderer(store).render(camera)  # The lens draws along the ray whatever is asked for.
    assert psnr((one.rgb, truth)) > 46
    four = CpuRenderer(store, samples=4).render(camera)
    assert psnr((four.rgb, truth)) > 58
    straight = dataclasses.replace(camera, distortion=None)
    assert psnr((CpuRenderer(store, projection="ray").render(straight).rgb, truth)) < 25


def test_a_lens_without_coefficients_is_a_pinhole(store):
    camera = camera_of("radial_tangential", (0.0,) * 5, 100.0)
    straight = dataclasses.replace(camera, distortion=None)
    bent, pinhole = (CpuRenderer(store, projection="ray").render(c) for c in (camera, straight))
    assert psnr((bent.rgb, pinhole.rgb)) > 95
    assert np.abs(bent.depth - pinhole.depth)[pinhole.alpha > 0.5].max() < 1e-2


@pytest.mark.parametrize("samples", [1, 4])
def test_pixel_sets_and_threads_draw_the_same_picture(store, samples):
    camera, options = camera_of(*FISHEYE), {"projection": "ray", "samples": samples}
    full = CpuRenderer(store, **options).render(camera)
    pixels = Pixels(stride=16, block=2, offset=7)
    part = CpuRenderer(store, **options).render(camera, pixels)
    assert psnr((part.rgb, pixels.crop(full.rgb))) > 95
    assert psnr((CpuRenderer(store, threads=3, **options).render(camera).rgb, full.rgb)) > 95
    again = CpuRenderer(store, **options).render(camera)
    assert np.array_equal(again.rgb, full.rgb)


def test_cuda_refuses_a_lens_by_name(store):
    cuda = pytest.importorskip("gsplat") and open_renderer(store, "cuda")
    with pytest.raises(UsageError, match="cuda cannot draw through a lens with distortion"):
        cuda.render(camera_of(*BARREL))
