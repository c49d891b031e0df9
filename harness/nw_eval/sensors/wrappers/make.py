"""From a card's list of wrappers to the objects that do the work."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import assert_never

from nw_eval.cards.observations import wraps
from nw_eval.sensors.wrappers import images, values
from nw_eval.sensors.wrappers.chain import Named
from nw_eval.sensors.wrappers.foreign import foreign_wrapper
from nw_eval.sensors.wrappers.link import Link
from nw_eval.sensors.wrappers.stack import Stack


def make_wrappers(listed: Sequence[wraps.AnyWrap], *, code_from: Path | None) -> list[Named]:
    """Return the wrappers of an observation.

    Args:
        listed: from the card.
        code_from: folder beside whose files `module:Class` is looked for; None = no code.

    Raises:
        PolicyError: a plug-in is broken, or code is not allowed.
    """
    return [
        Named(
            name=wrap.wrapper,
            link=foreign_wrapper(wrap, code_from=code_from)
            if isinstance(wrap, wraps.PluginWrap)
            else _built_in(wrap),
        )
        for wrap in listed
    ]


def _built_in(wrap: wraps.BuiltInWrap) -> Link:  # noqa: C901 - one line for each wrapper.
    match wrap:
        case wraps.NoiseWrap():
            return values.AddNoise(wrap)
        case wraps.Crop():
            return images.Crop(wrap)
        case wraps.Resize():
            return images.Resize(wrap)
        case wraps.Normalize():
            return values.Normalize(wrap)
        case wraps.Scale():
            return values.Scale(wrap)
        case wraps.Clip():
            return values.Clip(wrap)
        case wraps.Grayscale():
            return images.Grayscale()
        case wraps.Quantize():
            return values.Quantize(wrap)
        case wraps.Stack():
            return Stack(wrap.steps, wrap.axis)
        case wraps.Channels():
            return images.Channels(wrap)
        case wraps.Flatten():
            return values.Flatten()
        case _:
            assert_never(wrap)
