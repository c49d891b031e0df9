"""The engine against an independent torch renderer (splat_reference.py)."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
import torch
from splat_reference import render
from splat_rooms import cloud, eye_camera, psnr, room

from nw_splat.files import read_splat
from nw_splat.portrait import framing_camera
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store

_FLIP = 4.5e-3
"""A splat at alpha = 1/255 exactly may be in or out by rounding: 1/255, and a little."""


def _compare(gaussians, cameras, *, antialiased=True, preset="gsplat-1.5", **reference):
    renderer = CpuRenderer(memory_store(gaussians), preset=preset, antialiased=antialiased)
    pairs = []
    for camera in cameras:
        image = renderer.render(camera)
        rgb, depth, alpha = render(gaussians, camera, antialiased=antialiased, **reference)
        pairs.append((image, rgb, depth, alpha))
    return pairs


@pytest.fixture(scope="module")
def room_100k():
    return room(100_000)


@pytest.mark.nightly
def test_a_room_of_100k_agrees_to_95_db(room_100k):
    pairs = _compare(room_100k, [eye_camera(i, 160, 90) for i in range(4)])
    assert psnr(*((image.rgb, rgb) for image, rgb, _, _ in pairs)) >= 95
    for image, rgb, _depth, alpha in pairs:
        assert np.abs(image.rgb - rgb).max() < _FLIP
        assert np.abs(image.alpha - alpha).max() < _FLIP


def test_expected_depth_agrees_where_something_is_seen(room_100k):
    ((image, _, depth, alpha),) = _compare(room_100k, [eye_camera(1, 160, 90)])
    seen = alpha > 0.5
    assert seen.mean() > 0.9
    assert np.abs(image.depth - depth)[seen].max() < 0.03
    assert np.median(np.abs(image.depth - depth)[seen]) < 1e-5


def test_classic_mode_agrees_to_95_db(room_100k):
    pairs = _compare(room_100k, [eye_camera(2, 160, 90)], antialiased=False)
    assert psnr(*((image.rgb, rgb) for image, rgb, _, _ in pairs)) >= 95


def test_a_larger_image_agrees_to_95_db(room_100k):
    pairs = _compare(room_100k, [eye_camera(3, 320, 180)])
    assert psnr(*((image.rgb, rgb) for image, rgb, _, _ in pairs)) >= 95


@pytest.mark.nightly
def test_a_room_of_500k_agrees_to_80_db():
    pairs = _compare(room(500_000, degree=1), [eye_camera(0, 160, 90)])
    assert psnr(*((image.rgb, rgb) for image, rgb, _, _ in pairs)) >= 80


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_degree_of_harmonics_agrees_with_float64(degree):
    gaussians = cloud(3000, degree=degree, seed=degree)
    camera = framing_camera(gaussians, width=96, height=64)
    ((image, rgb, _, _),) = _compare(gaussians, [camera], dtype=torch.float64)
    assert psnr((image.rgb, rgb)) >= (110 if degree == 0 else 90)


def test_preset_1_6_agrees_and_differs_from_1_5():
    soft = cloud(3000, seed=5)
    gaussians = dataclasses.replace(
        soft, opacity_logits=soft.opacity_logits + 6, log_scales=soft.log_scales + 3
    )
    camera = framing_camera(gaussians, width=96, height=64)
    ((new, rgb, _, _),) = _compare(
        gaussians, [camera], preset="gsplat-1.6", max_alpha=0.99, min_compensation=0.005
    )
    assert psnr((new.rgb, rgb)) >= 90
    old = CpuRenderer(memory_store(gaussians), preset="gsplat-1.5").render(camera)
    assert np.abs(new.rgb - old.rgb).max() > 4e-3


@pytest.mark.assets
def test_a_real_scan_agrees_to_100_db():
    assets = os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[3] / "shared" / "assets")
    path = Path(assets) / "splats" / "guitar.compressed.ply"
    if not path.exists():
        pytest.skip("set NW_EVAL_ASSETS to the folder of third-party files")
    guitar = read_splat(path)
    cameras = [framing_camera(guitar, width=160, height=120, azimuth=a) for a in (0.0, 2.0, 4.0)]
    pairs = _compare(guitar, cameras)
    assert psnr(*((image.rgb, rgb) for image, rgb, _, _ in pairs)) >= 100
