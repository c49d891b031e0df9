"""Properties of the CPU renderer that need no reference renderer."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_rooms import cloud, eye_camera, room

from nw_base.errors import UsageError
from nw_splat import render as render_module
from nw_splat.camera import Camera, Pixels, look_at
from nw_splat.gaussians import Gaussians, concatenate, transformed
from nw_splat.render import CpuRenderer, open_renderer
from nw_splat.store import memory_store

PUBLISHED = Pixels(stride=16, block=2, offset=7)


@pytest.fixture(scope="module")
def store():
    return memory_store(room(30_000, degree=1))


def _one(mean=(0.0, 0.0, 2.0), *, scale=0.1, opacity=0.5, colour=(1.0, 0.5, 0.25)):
    return Gaussians(
        means=np.array([mean], dtype=np.float32),
        log_scales=np.full((1, 3), math.log(scale), dtype=np.float32),
        quats=np.array([[1, 0, 0, 0]], dtype=np.float32),
        opacity_logits=np.array([math.log(opacity / (1 - opacity))], dtype=np.float32),
        sh=((np.array([[colour]]) - 0.5) / 0.28209479177387814).astype(np.float32),
    )


def _ahead(width=33, height=33, focal=40.0, **options):
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=width / 2,
        cy=height / 2,
        T_world_camera=np.eye(4),
        **options,
    )


def _same(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("rgb", "depth", "alpha")
    )


def test_one_gaussian_has_the_colour_and_width_of_the_formula():
    # Variance on the screen: (40 * 0.1 / 2)^2 + 0.3 = 4.3 pixels squared; opacity 0.5 in classic
    # mode, so alpha = 0.5 exp(-r^2 / 8.6) at r pixels from the centre.
    image = CpuRenderer(memory_store(_one()), antialiased=False).render(_ahead())
    for r in range(5):
        alpha = 0.5 * math.exp(-r * r / 8.6)
        assert image.alpha[16, 16 + r] == pytest.approx(alpha, rel=2e-6)
        expected = alpha * np.array([1.0, 0.5, 0.25]) + (1 - alpha)
        assert image.rgb[16, 16 + r] == pytest.approx(expected, rel=2e-6)
        assert image.depth[16, 16 + r] == pytest.approx(2.0, rel=1e-6)


def test_antialiasing_takes_the_energy_of_the_blur_away():
    # sqrt(det before / det after) = 4 / 4.3 for a round splat of variance 4.
    image = CpuRenderer(memory_store(_one())).render(_ahead())
    assert image.alpha[16, 16] == pytest.approx(0.5 * 4.0 / 4.3, rel=2e-6)


def test_alpha_is_clamped_by_the_preset():
    opaque = memory_store(_one(opacity=1 - 1e-7))
    for preset, most in (("gsplat-1.5", 0.999), ("gsplat-1.6", 0.99)):
        image = CpuRenderer(opaque, antialiased=False, preset=preset).render(_ahead())
        assert image.alpha[16, 16] == pytest.approx(most, abs=1e-6)


def test_nearer_hides_farther_whatever_the_order_in_the_file():
    near = _one((0, 0, 1), opacity=0.999, colour=(1, 0, 0))
    far = _one((0, 0, 3), opacity=0.999, colour=(0, 0, 1), scale=0.5)
    for gaussians in (concatenate(near, far), concatenate(far, near)):
        image = CpuRenderer(memory_store(gaussians), antialiased=False).render(_ahead())
        # The far one would leave T below 1e-4, so it is not drawn and white shows through.
        assert image.rgb[16, 16] == pytest.approx([1.0, 0.001, 0.001], abs=1e-5)
        assert image.depth[16, 16] == pytest.approx(1.0, abs=0.01)


def test_nothing_in_view_leaves_the_background():
    renderer = CpuRenderer(memory_store(_one((0, 0, -2))), background=(0.1, 0.2, 0.3))
    image = renderer.render(_ahead())
    assert (image.rgb == np.array([0.1, 0.2, 0.3], dtype=np.float32)).all()
    assert not image.alpha.any()
    assert not image.depth.any()


@pytest.mark.parametrize(
    ("near", "far", "seen"), [(0.01, 10, True), (2.5, 10, False), (0.1, 1.5, False)]
)
def test_planes_drop_gaussians_by_their_centre(near, far, seen):
    image = CpuRenderer(memory_store(_one())).render(_ahead(near=near, far=far))
    assert bool(image.alpha.any()) is seen


def test_a_pixel_set_is_the_crop_of_the_full_image_bit_for_bit(store):
    camera = eye_camera(1, 1280, 720)
    renderer = CpuRenderer(store)
    full = renderer.render(camera)
    for pixels in (PUBLISHED, Pixels(stride=3, block=1, offset=2), Pixels(stride=7, block=3)):
        part = renderer.render(camera, pixels)
        assert part.rgb.shape[:2] == (pixels.count(720), pixels.count(1280))
        for name in ("rgb", "depth", "alpha"):
            assert np.array_equal(getattr(part, name), pixels.crop(getattr(full, name)))


def test_the_published_pixel_set_is_160_by_90_and_averages_to_80_by_45(store):
    image = CpuRenderer(store).render(eye_camera(1, 1280, 720), PUBLISHED)
    assert image.rgb.shape == (90, 160, 3)
    assert PUBLISHED.mean(image.rgb).shape == (45, 80, 3)


@pytest.mark.parametrize("threads", [2, 3, 5])
def test_threads_do_not_change_a_bit(store, threads):
    camera = eye_camera(2, 200, 96)
    alone = CpuRenderer(store).render(camera)
    assert _same(CpuRenderer(store, threads=threads).render(camera), alone)


@pytest.mark.parametrize("chunks", [1, 7, 10**6])
def test_the_size_of_a_slab_does_not_change_a_bit(store, chunks, monkeypatch):
    camera = eye_camera(3, 160, 90)
    usual = CpuRenderer(store).render(camera)
    monkeypatch.setattr(render_module, "_SLAB_CHUNKS", chunks)
    assert _same(CpuRenderer(store).render(camera), usual)


@pytest.mark.parametrize("projection", ["ewa", "ray"])
def test_chunks_behind_a_wall_are_skipped_and_change_nothing(projection, monkeypatch):
    rng = np.random.default_rng(3)
    n = 4000
    wall = Gaussians(
        means=(rng.uniform(-2, 2, (n, 3)) * [1, 1, 0] + [-1.8, 0, 1]).astype(np.float32),
        log_scales=np.full((n, 3), math.log(0.08), dtype=np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        opacity_logits=np.full(n, 6.0, dtype=np.float32),
        sh=rng.normal(0, 0.5, (n, 1, 3)).astype(np.float32),
    )
    behind = cloud(40_000, degree=0, centre=(-2.5, 0, 6), spread=(0.5, 0.5, 0.5))
    behind.log_scales[:] -= 2
    store = memory_store(concatenate(behind, wall))
    monkeypatch.setattr(render_module, "_SLAB_CHUNKS", 4)
    renderer = CpuRenderer(store, projection=projection)
    image, stages = renderer.render_timed(_ahead(96, 64, 60.0))
    assert stages.hidden_chunks > 0
    monkeypatch.setattr(render_module, "_SLAB_CHUNKS", 10**6)
    assert _same(renderer.render(_ahead(96, 64, 60.0)), image)


def test_moving_camera_and_splat_together_changes_nothing():
    gaussians = cloud(2000)
    T = look_at((3.0, -1.0, 2.0), (0.0, 0.5, 0.1))
    T[:3, :3] *= 2.0
    moved = transformed(gaussians, T)
    camera = Camera.from_fovy(
        width=64, height=48, fovy=1.0, T_world_camera=look_at((-4, -9, 1), (0.5, -1, 2))
    )
    other = Camera.from_fovy(
        width=64, height=48, fovy=1.0, T_world_camera=T @ camera.T_world_camera
    )
    a = CpuRenderer(memory_store(gaussians)).render(camera)
    b = CpuRenderer(memory_store(moved)).render(other)
    assert np.abs(a.rgb - b.rgb).max() < 5e-3
    # The scale stands in the camera's matrix, so depth stays in camera units.
    seen = a.alpha > 0.3
    assert np.abs(a.depth - b.depth)[seen].max() < 1e-2


@settings(max_examples=12, deadline=None)
@given(
    views=st.lists(
        st.tuples(st.integers(0, 7), st.sampled_from([(160, 90), (33, 17), (80, 45)])),
        min_size=2,
        max_size=5,
    )
)
def test_many_cameras_in_any_order_see_what_each_alone_would(store, views):
    shared = CpuRenderer(store)
    for number, size in views:
        camera = eye_camera(number, *size)
        assert _same(shared.render(camera), CpuRenderer(store).render(camera))


def test_an_image_belongs_to_the_caller(store):
    renderer = CpuRenderer(store)
    first = renderer.render(eye_camera(0, 64, 48))
    kept = first.rgb.copy()
    renderer.render(eye_camera(1, 64, 48))
    assert np.array_equal(first.rgb, kept)
    first.rgb[:] = 0


def test_one_renderer_serves_images_of_many_sizes(store):
    renderer = CpuRenderer(store)
    for width, height in ((1, 1), (8, 8), (9, 7), (161, 93), (17, 200), (1, 50)):
        image = renderer.render(eye_camera(4, width, height))
        assert image.rgb.shape == (height, width, 3)
        assert _same(image, CpuRenderer(store).render(eye_camera(4, width, height)))


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(-12, 12),
    place=st.floats(0.01, 1e6),
    width=st.integers(1, 70),
    height=st.integers(1, 40),
)
def test_no_gaussian_is_too_wild(seed, size, place, width, height):
    # Needles, giants, specks and far-off ones: the picture stays finite and alpha within 0..1.
    rng = np.random.default_rng(seed)
    gaussians = Gaussians(
        means=(rng.normal(size=(300, 3)) * place).astype(np.float32),
        log_scales=(rng.normal(size=(300, 3)) * 3 + size).astype(np.float32),
        quats=rng.normal(size=(300, 4)).astype(np.float32),
        opacity_logits=(rng.normal(size=300) * 5).astype(np.float32),
        sh=rng.normal(size=(300, 4, 3)).astype(np.float32) * 1e3,
    )
    gaussians.means[::50] = np.nan
    gaussians.log_scales[::60] = 100.0
    image = CpuRenderer(memory_store(gaussians)).render(_ahead(width, height))
    assert np.isfinite(image.rgb).all()
    assert image.alpha.min() >= 0
    assert image.alpha.max() <= 1
    assert np.isfinite(image.depth).all()


def test_a_camera_far_from_the_origin_sees_the_same():
    near, offset = cloud(1000), np.float32([4096, -8192, 512])
    far = Gaussians(
        means=near.means + offset,
        log_scales=near.log_scales,
        quats=near.quats,
        opacity_logits=near.opacity_logits,
        sh=near.sh,
    )
    T = look_at((-4, -9, 1), (0.5, -1, 2))
    moved = T.copy()
    moved[:3, 3] += offset
    a, b = (
        CpuRenderer(memory_store(g)).render(
            Camera.from_fovy(width=64, height=48, fovy=1.0, T_world_camera=pose)
        )
        for g, pose in ((near, T), (far, moved))
    )
    # Centres at 8192 are stored to 1/1024; the camera must not lose more than they did.
    assert np.abs(a.rgb - b.rgb).mean() < 2e-3


def test_bad_options_name_the_value_and_the_fix(store):
    with pytest.raises(UsageError, match=r"gsplat-1\.4.*did you mean"):
        CpuRenderer(store, preset="gsplat-1.4")
    with pytest.raises(UsageError, match="threads is 0"):
        CpuRenderer(store, threads=0)
    with pytest.raises(UsageError, match="unknown renderer 'cup'; did you mean 'cpu'"):
        open_renderer(store, "cup")
    with pytest.raises(UsageError, match="selects no pixel of 8x8"):
        CpuRenderer(store).render(_ahead(8, 8), PUBLISHED)
    with pytest.raises(UsageError, match="reaches beyond its cell"):
        Pixels(stride=4, block=3, offset=2)
