"""Observations of cameras as pictures, however a card lays them out."""

import numpy as np
import pytest
from pydantic import TypeAdapter

from nw_policies.cards import Card
from nw_policies.cards.observations import DepthObservation, SemanticsObservation
from nw_policies.cards.observations import SplatRgbObservation as Photo
from nw_policies.cards.wrappers import Wrapper
from nw_scenes.robots import get_robot
from nw_sim.rollout.observed import View, views_of
from nw_sim.sensors.splat_rgb import arrange
from nw_sim.sensors.wrappers import Chain, Shot, Spec, make_wrappers

SIZE = {"width": 10, "height": 8}


def view(spec):
    return View(observation="seen", topic="/camera/ego", mount="ego", spec=spec)


def wrapped(frames, wraps):
    """Return the last of some samples as a card's wrappers leave it."""
    chained = make_wrappers(TypeAdapter(list[Wrapper]).validate_python(wraps), code_from=None)
    chain = Chain("seen", chained, Spec(frames[0].shape, frames[0].dtype))
    for step, frame in enumerate(frames):
        sample = frame
        for named in chained:
            sample = named.wrapper(sample, Shot(step, None, lambda _: np.random.default_rng(0)))
    assert sample.shape == chain.spec.shape
    return sample


@pytest.mark.parametrize("axes", ["hwc", "chw"])
@pytest.mark.parametrize("stack_axis", ["new", "channel"])
@pytest.mark.parametrize("stack", [1, 3])
@pytest.mark.parametrize(
    ("dtype", "mean", "std"), [("uint8", 0.0, 255.0), ("float32", 127.5, 255.0)]
)
def test_the_newest_photograph_is_found_however_the_card_lays_it_out(
    axes, stack_axis, stack, dtype, mean, std
):
    layout = {"axes": axes, "stack": stack, "stack_axis": stack_axis}
    spec = Photo(sensor="splat_rgb", **SIZE, **layout, dtype=dtype, mean=mean, std=std)
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 256, (8, 10, 3), dtype=np.uint8) for _ in range(stack)]
    [(form, shown)] = view(spec).pictures(arrange(frames, spec))
    np.testing.assert_array_equal(shown, frames[-1])
    assert (form, shown.dtype) == ("photo", np.uint8)


@pytest.mark.parametrize(
    "wraps",
    [
        [{"wrapper": "stack", "steps": 4}],
        [{"wrapper": "stack", "steps": 4, "axis": "last"}],
        [{"wrapper": "stack", "steps": 4, "axis": "channel"}],
        [{"wrapper": "channels", "axis": "first"}, {"wrapper": "stack", "steps": 3}],
        [{"wrapper": "channels"}, {"wrapper": "stack", "steps": 3, "axis": "last"}],
    ],
)
def test_the_newest_photograph_of_a_wrapped_stack_is_found(wraps):
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 256, (8, 10, 3), dtype=np.uint8) for _ in range(6)]
    spec = Photo(sensor="splat_rgb", **SIZE, wrap=wraps)
    [(form, shown)] = view(spec).pictures(wrapped(frames, wraps))
    np.testing.assert_array_equal(shown, frames[-1])
    assert form == "photo"


def test_what_a_pixel_is_decides_how_it_is_kept():
    depth = np.full((8, 10), 2.5, np.float32)
    classes = np.ones((8, 10), np.uint8)

    def form(spec, array):
        [(found, _)] = view(spec).pictures(array)
        return found

    metres = {"sensor": "depth", **SIZE}
    assert form(DepthObservation(**metres), depth) == "metres"
    assert form(DepthObservation(**metres, wrap=["grayscale"]), depth) == "numbers"
    assert form(DepthObservation(**metres, mode="midas"), depth) == "numbers"
    assert form(SemanticsObservation(sensor="semantics", **SIZE), classes) == "classes"
    drawn = SemanticsObservation(sensor="semantics", **SIZE, values="colors")
    assert form(drawn, np.zeros((8, 10, 3), np.uint8)) == "drawing"
    grey = Photo(sensor="splat_rgb", **SIZE, wrap=["grayscale"])
    assert form(grey, classes) == "grey"


def test_each_image_that_a_foreign_wrapper_makes_of_one_is_shown():
    spec = DepthObservation(sensor="depth", **SIZE, wrap=["flatten"])
    several = np.arange(2 * 8 * 10, dtype=np.float32).reshape(2, 8, 10)
    shown = [image for _, image in view(spec).pictures(several)]
    np.testing.assert_array_equal(shown, several)
    assert view(spec).pictures(several.ravel()) == []


def test_cropping_and_resizing_move_the_camera_s_centre():
    wraps = [
        {"wrapper": "crop", "top": 2, "left": 4},
        {"wrapper": "resize", "width": 3, "height": 12},
    ]
    spec = DepthObservation(sensor="depth", **SIZE, wrap=wraps)
    seen = view(spec).lens(_ego())
    # 90 degrees from top to bottom: a focal length of half the height, 4 pixels.
    assert (seen.width, seen.height) == (3, 12)
    assert (seen.fx, seen.fy) == pytest.approx((4.0 * 3 / 6, 4.0 * 12 / 6))
    assert (seen.cx, seen.cy) == pytest.approx(((5 - 4) * 3 / 6, (4 - 2) * 12 / 6))
    assert view(DepthObservation(sensor="depth", wrap=["flatten"])).lens(_ego()) is None


def _ego():
    return get_robot("go1").cameras["ego"]


def test_names_that_are_no_plain_words_are_numbers_in_topics():
    names = ("depth", "calib", "a/b", "line\nbreak", "x" * 2000)
    observations = {name: {"sensor": "depth"} for name in names}
    control = {"action": "joint_position_offset"}
    card = Card.model_validate(
        {"nw-policy": 1, "name": "p", "robot": "go1", "adapter": "zero", "control": control}
        | {"observations": observations}
    )
    topics = [view.topic.removeprefix("/camera/ego/") for view in views_of(card)]
    assert topics == ["depth", "~1", "~2", "~3", "~4"]
