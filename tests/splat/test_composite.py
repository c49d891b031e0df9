"""Objects drawn into a splat's image, coverage, and the camera model."""

import numpy as np
import pytest

from nw_base.errors import UsageError
from nw_splat.image import CameraModel, Image, composite, paste

WHITE, RED = (1.0, 1.0, 1.0), np.float32([1, 0, 0])


def _image(colour=0.2, depth=2.0, alpha=1.0):
    """A 4x4 image of a splat of one colour, over white."""
    a = np.full((4, 4), alpha, dtype=np.float32)
    rgb = a[..., None] * np.float32(colour) + (1 - a)[..., None]
    return Image(
        rgb=np.broadcast_to(rgb, (4, 4, 3)).astype(np.float32),
        depth=np.full((4, 4), depth, dtype=np.float32),
        alpha=a,
    )


def _object(depth, coverage):
    shape = (4, 4)
    return (
        np.broadcast_to(RED, (*shape, 3)),
        np.full(shape, depth, dtype=np.float32),
        np.full(shape, coverage, dtype=np.float32),
    )


def test_an_object_in_front_hides_the_splat():
    out = composite(_image(), *_object(1.0, 1.0))
    assert np.allclose(out.rgb, RED)
    assert np.allclose(out.depth, 1.0)


def test_an_object_behind_an_opaque_splat_is_hidden():
    out = composite(_image(), *_object(3.0, 1.0))
    assert np.allclose(out.rgb, 0.2)
    assert np.allclose(out.depth, 2.0)


def test_an_object_behind_a_thin_splat_shows_through_instead_of_the_background():
    out = composite(_image(alpha=0.25), *_object(3.0, 1.0))
    assert np.allclose(out.rgb, 0.25 * 0.2 + 0.75 * RED)
    assert np.allclose(out.alpha, 1.0)
    assert np.allclose(out.depth, 0.25 * 2 + 0.75 * 3)


def test_half_covered_pixels_mix():
    out = composite(_image(), *_object(1.0, 0.5))
    assert np.allclose(out.rgb, 0.5 * 0.2 + 0.5 * RED)
    assert np.allclose(out.depth, 1.5)


def test_an_object_over_nothing_is_drawn_over_the_background():
    out = composite(_image(alpha=0.0, depth=0.0), *_object(5.0, 0.5))
    assert np.allclose(out.rgb, 0.5 + 0.5 * RED)
    assert np.allclose(out.depth, 5.0)
    assert np.allclose(out.alpha, 0.5)


def test_where_there_is_no_object_nothing_changes():
    image = _image(alpha=0.6)
    out = composite(image, *_object(np.inf, 1.0))
    for name in ("rgb", "depth", "alpha"):
        assert np.allclose(getattr(out, name), getattr(image, name), atol=1e-6)


def test_the_published_paste_replaces_whole_pixels_whatever_the_depth():
    mask = np.zeros((4, 4), dtype=bool)
    mask[1, 2] = True
    out = paste(_image(), np.broadcast_to(RED, (4, 4, 3)), mask)
    assert np.array_equal(out.rgb[1, 2], RED)
    assert np.allclose(out.rgb[0], 0.2)


def test_shapes_that_differ_are_refused():
    rgb, depth, coverage = _object(1.0, 1.0)
    with pytest.raises(UsageError, match=r"depth has shape \(3, 4\)"):
        composite(_image(), rgb, depth[:3], coverage)


def test_a_perfect_camera_changes_nothing_and_draws_no_numbers():
    generator = np.random.default_rng(0)
    state = generator.bit_generator.state
    rgb = _image().rgb
    assert CameraModel().apply(rgb, generator) is rgb
    assert generator.bit_generator.state == state


def test_a_stop_doubles_the_light():
    # sRGB 0.5 is 0.21404 of light (IEC 61966-2-1); twice that is sRGB 0.68594.
    rgb = np.full((2, 2, 3), 0.5, dtype=np.float32)
    out = CameraModel(exposure=1.0).apply(rgb, np.random.default_rng(0))
    assert out == pytest.approx(0.68594, abs=2e-4)


def test_gain_changes_one_channel():
    rgb = np.full((2, 2, 3), 0.5, dtype=np.float32)
    out = CameraModel(gain=(1.0, 0.5, 1.0)).apply(rgb, np.random.default_rng(0))
    assert out[..., 0] == pytest.approx(0.5, abs=1e-5)
    assert out[..., 1] == pytest.approx(0.36079, abs=2e-5)


def test_blur_keeps_the_mean_and_spreads_a_point_by_its_deviation():
    rgb = np.zeros((41, 41, 3), dtype=np.float32)
    rgb[20, 20] = 1.0
    out = CameraModel(blur=2.0).apply(rgb, np.random.default_rng(0))
    x = np.arange(41) - 20
    assert out.sum() == pytest.approx(3.0, rel=1e-5)
    assert (out[..., 0].sum(axis=0) * x**2).sum() == pytest.approx(4.0, rel=0.03)


def test_noise_has_its_deviation_and_repeats_with_the_seed():
    rgb = np.full((200, 200, 3), 0.49, dtype=np.float32)
    model = CameraModel(shot_noise=0.1, read_noise=0.02)
    out = model.apply(rgb, np.random.default_rng(3))
    assert out.std() == pytest.approx(np.sqrt(0.1**2 * 0.49 + 0.02**2), rel=0.02)
    assert np.array_equal(out, model.apply(rgb, np.random.default_rng(3)))


@pytest.mark.parametrize(
    "field", [{"blur": -1.0}, {"read_noise": float("nan")}, {"gain": (1.0, -1.0, 1.0)}]
)
def test_impossible_cameras_are_refused(field):
    with pytest.raises(UsageError, match=f"camera model {next(iter(field))}"):
        CameraModel(**field)
