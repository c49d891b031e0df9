"""Frames for the log, from the observations of cards."""

import numpy as np
import pytest

from nw_eval.policies.observations import SplatRgbObservation
from nw_eval.rollout.cameras import newest_frame
from nw_eval.sensors.splat_image import arrange


@pytest.mark.parametrize("axes", ["hwc", "chw"])
@pytest.mark.parametrize("stack_axis", ["new", "channel"])
@pytest.mark.parametrize("stack", [1, 3])
@pytest.mark.parametrize(
    ("dtype", "mean", "std"), [("uint8", 0.0, 255.0), ("float32", 127.5, 255.0)]
)
def test_the_newest_frame_is_found_however_the_card_lays_it_out(
    axes, stack_axis, stack, dtype, mean, std
):
    spec = SplatRgbObservation(
        sensor="splat_rgb",
        width=10,
        height=8,
        axes=axes,
        stack=stack,
        stack_axis=stack_axis,
        dtype=dtype,
        mean=mean,
        std=std,
    )
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 256, (8, 10, 3), dtype=np.uint8) for _ in range(stack)]
    shown = newest_frame(arrange(frames, spec), spec)
    np.testing.assert_array_equal(shown, frames[-1])
    assert shown.dtype == np.uint8
