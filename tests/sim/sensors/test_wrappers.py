"""Noise and wrapper chains: what they do to samples, and whose randomness they use."""

import numpy as np
import pytest
from pydantic import TypeAdapter

from nw_base.errors import PolicyError
from nw_policies.cards.wrappers import Wrapper
from nw_sim.sensors import build_sensors, check_card
from nw_sim.sensors.wrappers import Chain, Spec, make_wrappers

COLOUR = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
DEPTH = {"sensor": "depth", "width": 16, "height": 9}


def chain(*listed, shape=COLOUR.shape, dtype=np.uint8):
    wraps = TypeAdapter(list[Wrapper]).validate_python(list(listed))
    return Chain("it", make_wrappers(wraps, code_from=None), Spec(shape, np.dtype(dtype)))


class Instant:
    def __init__(self, step=0):
        self.step = step


def through(sample, *listed, step=0, seed=0):
    made = chain(*listed, shape=sample.shape, dtype=sample.dtype)
    made.reset(seed)
    result = made(sample, Instant(step))
    assert (result.shape, result.dtype) == (made.spec.shape, made.spec.dtype)
    return result


def test_crop_cuts_borders():
    cut = through(COLOUR, {"wrapper": "crop", "top": 1, "left": 2, "right": 1})
    np.testing.assert_array_equal(cut, COLOUR[1:, 2:5])


def test_area_resize_by_a_whole_factor_is_the_mean_of_blocks():
    image = np.random.default_rng(0).normal(size=(6, 8)).astype(np.float32)
    small = through(image, {"wrapper": "resize", "width": 4, "height": 3})
    np.testing.assert_allclose(small, image.reshape(3, 2, 4, 2).mean(axis=(1, 3)), atol=1e-6)


def test_area_resize_by_a_broken_factor_shares_pixels():
    # Three pixels to two: each new one is one and a half old ones wide.
    row = np.array([[3.0, 6.0, 12.0]], dtype=np.float32)
    small = through(row, {"wrapper": "resize", "width": 2, "height": 1})
    np.testing.assert_allclose(small, [[(3 + 6 / 2) / 1.5, (6 / 2 + 12) / 1.5]], rtol=1e-6)


def test_bilinear_resize_by_16_is_the_published_two_by_two_mean():
    # Of the specification: floor((a + b + c + d + 2) / 4) of rows and columns 7 and 8 of a cell.
    image = np.random.default_rng(1).integers(0, 256, (32, 48, 3)).astype(np.uint8)
    request = {"wrapper": "resize", "width": 3, "height": 2, "method": "bilinear"}
    cells = image.reshape(2, 16, 3, 16, 3)[:, 7:9, :, 7:9].astype(int).sum(axis=(1, 3))
    difference = through(image, request).astype(int) - (cells + 2) // 4
    # Halves are rounded to the even number here, upwards there.
    assert np.abs(difference).max() <= 1
    assert (difference != 0).mean() < 0.25


def test_nearest_resize_takes_the_pixel_under_each_centre():
    row = np.arange(6, dtype=np.uint8)[np.newaxis]
    request = {"wrapper": "resize", "width": 2, "height": 1, "method": "nearest"}
    assert through(row, request).tolist() == [[1, 4]]


def test_grayscale_weighs_colours_as_the_eye_does():
    # ITU-R BT.601: 0.299 R + 0.587 G + 0.114 B.
    pixels = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]]], dtype=np.uint8)
    assert through(pixels, "grayscale").tolist() == [[76, 150, 29, 255]]


def test_normalize_has_one_number_or_one_for_each_colour():
    one = through(COLOUR, {"wrapper": "normalize", "mean": 127.5, "std": 255})
    np.testing.assert_allclose(one, (COLOUR - 127.5) / 255, rtol=1e-6)
    each = through(COLOUR, {"wrapper": "normalize", "mean": [1, 2, 3], "std": [1, 2, 4]})
    np.testing.assert_allclose(each[..., 2], (COLOUR[..., 2] - 3.0) / 4, rtol=1e-6)
    with pytest.raises(PolicyError, match=r"`it`: normalize has 2 numbers for a sample of shape"):
        chain({"wrapper": "normalize", "mean": [1, 2]})


def test_scale_clip_and_quantize_do_what_they_say():
    row = np.array([[-1.0, 0.26, 2.0, np.nan]], dtype=np.float32)
    assert through(row, {"wrapper": "scale", "scale": 2, "offset": 1})[0, :3].tolist() == [
        -1.0,
        pytest.approx(1.52),
        5.0,
    ]
    limited = through(row, {"wrapper": "clip", "limits": [0, 1], "nan": 0.5})
    assert limited[0].tolist() == [0.0, pytest.approx(0.26), 1.0, 0.5]
    steps = through(row[:, :3], {"wrapper": "quantize", "step": 0.5})
    assert steps[0].tolist() == [-1.0, 0.5, 2.0]


def test_channels_move_and_repeat():
    assert through(COLOUR, "channels").shape == (3, 4, 6)
    flat = COLOUR[..., 0]
    three = through(flat, {"wrapper": "channels", "repeat": 3})
    assert three.shape == (3, 4, 6)
    np.testing.assert_array_equal(three[2], flat)


def test_a_stack_is_oldest_first_and_remembers():
    made = chain({"wrapper": "stack", "steps": 3}, "flatten", shape=(1,), dtype=np.float32)
    made.reset(0)
    seen = [made(np.array([step], dtype=np.float32), Instant(step)).tolist() for step in range(4)]
    assert seen == [[0, 0, 0], [0, 0, 1], [0, 1, 2], [1, 2, 3]]
    other = chain({"wrapper": "stack", "steps": 3}, "flatten", shape=(1,), dtype=np.float32)
    other.reset(0)
    other.restore(made.state())
    assert other(np.array([4], dtype=np.float32), Instant(4)).tolist() == [2, 3, 4]


def test_noise_has_the_size_that_the_card_says():
    sample = np.full((200, 200), 4.0, dtype=np.float32)
    noisy = through(sample, {"wrapper": "noise", "gaussian": 0.3})
    assert (noisy - 4.0).std() == pytest.approx(0.3, rel=0.02)
    assert (noisy - 4.0).mean() == pytest.approx(0.0, abs=0.006)
    noisy = through(sample, {"wrapper": "noise", "proportional": 0.05})
    assert noisy.std() == pytest.approx(0.2, rel=0.02)
    lost = through(sample, {"wrapper": "noise", "dropout": 0.1, "lost": "nan"})
    assert np.isnan(lost).mean() == pytest.approx(0.1, abs=0.006)


def test_a_lost_pixel_loses_all_its_colours_and_bytes_do_not_wrap_around():
    white = np.full((100, 100, 3), 250, dtype=np.uint8)
    lost = through(white, {"wrapper": "noise", "dropout": 0.2})
    assert set(np.unique(lost.sum(axis=-1))) == {0, 750}
    noisy = through(white, {"wrapper": "noise", "gaussian": 10})
    assert noisy.min() > 200
    assert noisy.max() == 255


def test_noise_follows_the_seed_the_place_and_the_step_and_nothing_else():
    sample = np.zeros((3, 3), dtype=np.float32)
    noise = {"wrapper": "noise", "gaussian": 1.0}
    first = through(sample, noise, seed=5, step=7)
    np.testing.assert_array_equal(first, through(sample, noise, seed=5, step=7))
    assert (first != through(sample, noise, seed=6, step=7)).all()
    assert (first != through(sample, noise, seed=5, step=8)).all()
    twice = through(sample, noise, {"wrapper": "scale"}, seed=5, step=7)
    np.testing.assert_array_equal(first, twice)
    # Whoever continues a trial from its middle sees the noise of that moment.
    made = chain(noise, shape=(3, 3), dtype=np.float32)
    made.reset(5)
    for step in range(7):
        made(sample, Instant(step))
    np.testing.assert_array_equal(made(sample, Instant(7)), first)


def test_noise_of_a_depth_camera_is_that_of_its_metres(world, card_of, moment_of):
    noisy = DEPTH | {"mode": "linear", "noise": {"dropout": 0.3}}
    card = card_of({"clean": DEPTH | {"mode": "linear"}, "noisy": noisy})
    sensors = build_sensors(card, world)
    for sensor in sensors.values():
        sensor.reset(3)
    clean, noisy = (sensor.read(moment_of(world)) for sensor in sensors.values())
    changed = clean != noisy
    assert 0.1 < changed.mean() < 0.4
    # A lost depth sees nothing, which is as far as it gets.
    assert (noisy[changed] == 1.0).all()


def test_noise_of_a_lidar_acts_along_its_rays(world, card_of, moment_of):
    request = {"sensor": "lidar", "channels": 4, "columns": 30, "elevation": [-0.5, -0.2]}
    card = card_of({"clean": request, "noisy": request | {"noise": {"gaussian": 0.05}}})
    sensors = build_sensors(card, world)
    for sensor in sensors.values():
        sensor.reset(3)
    clean, noisy = (sensor.read(moment_of(world)) for sensor in sensors.values())
    found = np.isfinite(clean).all(axis=-1) & np.isfinite(noisy).all(axis=-1)
    clean, noisy = clean[found], noisy[found]
    assert np.abs(np.cross(clean, noisy)).max() < 1e-4
    assert 0.03 < (np.linalg.norm(noisy, axis=1) - np.linalg.norm(clean, axis=1)).std() < 0.07


def test_a_sensor_with_noise_and_a_stack_goes_back_to_its_state(world, card_of, moment_of):
    request = DEPTH | {
        "rate": 25,
        "latency": 0.04,
        "noise": {"gaussian": 0.1},
        "wrap": [{"wrapper": "stack", "steps": 3}],
    }
    first, second = (build_sensors(card_of({"o": request}), world)["o"] for _ in range(2))
    first.reset(9)
    second.reset(9)
    for step in range(9):
        first.read(moment_of(world, step=step))
    second.restore(first.state())
    for step in range(9, 20):
        expected = first.read(moment_of(world, step=step)).tobytes()
        assert second.read(moment_of(world, step=step)).tobytes() == expected


def test_the_noise_of_one_observation_does_not_move_that_of_another(world, card_of, moment_of):
    noisy = {"sensor": "direction", "noise": {"gaussian": 0.1}}

    def seen(observations):
        sensor = build_sensors(card_of(observations), world)["way"]
        sensor.reset(4)
        return sensor.read(moment_of(world))

    np.testing.assert_array_equal(
        seen({"way": noisy}), seen({"other": DEPTH | {"noise": {"gaussian": 1}}, "way": noisy})
    )


def test_a_chain_shapes_what_a_check_reports(card_of):
    wrap = ["channels", {"wrapper": "normalize"}]
    rgb = {"sensor": "splat_rgb", "width": 32, "height": 18, "wrap": wrap}
    (spec,) = check_card(card_of({"eye": rgb}))
    assert (spec.shape, spec.dtype) == ((3, 18, 32), np.float32)


@pytest.mark.parametrize(
    ("wrap", "said"),
    [
        (["flatten", "crop"], "`eye`: crop takes an image (H, W) or (H, W, C), not (144,)"),
        ([{"wrapper": "crop", "top": 9}], "crop leaves nothing of 9 x 16"),
        (["grayscale"], "grayscale takes (H, W, 3), not (9, 16)"),
    ],
)
def test_wrappers_that_do_not_fit_are_found_before_any_physics(card_of, wrap, said):
    with pytest.raises(PolicyError) as caught:
        check_card(card_of({"eye": DEPTH | {"wrap": wrap}}))
    assert said in str(caught.value)
