"""Pixels are those that were recorded, bit for bit, on every machine with a fused multiply-add.

The place is made of whole numbers and powers of two, so that nothing but the kernels rounds. The
digests are of the renderer as it was while it still drew eight pixels at a time; those along the
ray of the version that first agreed with float64 (test_along_the_ray.py).
"""

import hashlib

import numpy as np
import pytest

from nw_splat.camera import Camera, Pixels
from nw_splat.render import CpuRenderer
from nw_splat.store import BOUNDS, CHUNK, GROUP, Layout, Store

CHUNKS = 24
RECORDED = {
    "160x90, harmonics": "e8bd2ab383587d95",
    "320x180, no harmonics": "461c5bcf71f7b8e5",
    "67x41, preset 1.6": "a0a48c16740bad6e",
    "published pixels": "31156b1f58637025",
    "along the ray": "4d18b0536fbcd277",
    "four samples": "6597edb8ad3d061b",
}


def _groups(values):
    """(n, k) to the order of a layout."""
    return values.reshape(-1, GROUP, values.shape[1]).transpose(0, 2, 1).ravel()


def _place(sh_count):
    """Splats of all sizes before a camera at the origin that looks along z."""
    rng = np.random.default_rng(7)
    count = CHUNKS * CHUNK
    middle = np.repeat(rng.integers(-48, 49, (CHUNKS, 3)) / 16, CHUNK, axis=0)
    middle[:, 2] = np.repeat(np.arange(CHUNKS), CHUNK) / 4 + 1.5
    means = middle + rng.integers(-512, 513, (count, 3)) / 1024
    # Covariances L L', with L of whole 64ths, larger for every eighth splat and chunk.
    side = np.where(np.arange(count) % 8 == 0, 4, 1) * np.where(np.arange(count) % 2048 < 256, 4, 1)
    L = rng.integers(-4, 5, (count, 3, 3)) * side[:, None, None] / 64
    covariance = L @ L.transpose(0, 2, 1)
    covariance[:, range(3), range(3)] += 2.0**-14
    geometry = np.concatenate(
        [
            means,
            covariance[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]],
            -rng.integers(0, 1200, (count, 1)) / 256,
        ],
        axis=1,
    )
    boxes = means.reshape(CHUNKS, CHUNK, 3)
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    largest = np.sqrt(np.trace(covariance, axis1=1, axis2=2).reshape(CHUNKS, CHUNK).max(axis=1))
    bounds = np.zeros((CHUNKS, BOUNDS))
    bounds[:, :3], bounds[:, 3:6] = (low + high) / 2, (high - low) / 2 + 2.0**-10
    bounds[:, 6] = largest
    sh = rng.integers(-512, 513, (count, max(3 * (sh_count - 1), 1))) / 1024
    layout = Layout(
        count=count,
        sh_count=sh_count,
        geometry=_groups(geometry).astype(np.float32),
        dc=_groups(rng.integers(0, 257, (count, 3)) / 256).astype(np.float32),
        sh=_groups(sh).astype(np.float16).view(np.uint16)[: max(count * 3 * (sh_count - 1), 8)],
        bounds=bounds.ravel().astype(np.float32),
    )
    return Store(count=count, sh_count=sh_count, layout=layout, path=None, key="")


def _camera(width, height):
    return Camera(
        width=width, height=height, fx=width / 2, fy=width / 2, cx=width / 2, cy=height / 2,
        T_world_camera=np.eye(4),
    )  # fmt: skip


CASES = {
    "160x90, harmonics": (16, {}, (160, 90), Pixels()),
    "320x180, no harmonics": (1, {"antialiased": False}, (320, 180), Pixels()),
    "67x41, preset 1.6": (4, {"preset": "gsplat-1.6"}, (67, 41), Pixels()),
    "published pixels": (9, {}, (1280, 720), Pixels(stride=16, block=2, offset=7)),
    "along the ray": (4, {"projection": "ray"}, (160, 90), Pixels()),
    "four samples": (1, {"projection": "ray", "samples": 4}, (80, 45), Pixels()),
}


def _digest(sh_count, options, size, pixels):
    image = CpuRenderer(_place(sh_count), **options).render(_camera(*size), pixels)
    assert 0.2 < image.alpha.mean() < 1.0
    assert len(np.unique(image.rgb)) > 1000
    total = hashlib.sha256()
    for array in (image.rgb, image.depth, image.alpha):
        total.update(array.tobytes())
    return total.hexdigest()[:16]


@pytest.mark.parametrize("case", CASES)
def test_pixels_are_those_that_were_recorded(case):
    assert _digest(*CASES[case]) == RECORDED[case]
