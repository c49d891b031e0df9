"""From a card's list of wrappers to the objects that do the work."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import assert_never

from nw_eval.cards.observations import wrappers
from nw_eval.sensors.wrappers import images, values
from nw_eval.sensors.wrappers.chain import NamedWrapper
from nw_eval.sensors.wrappers.foreign import foreign_wrapper
from nw_eval.sensors.wrappers.stack import Stack
from nw_eval.sensors.wrappers.wrapper import Wrapper


def make_wrappers(
    entries: Sequence[wrappers.AnyWrapper], *, code_from: Path | None
) -> list[NamedWrapper]:
    """Return the wrappers of an observation.

    Args:
        entries: from the card.
        code_from: folder beside whose files `module:Class` is looked for; None = no code.

    Raises:
        PolicyError: a plug-in is broken, or code is not allowed.
    """
    return [
        NamedWrapper(name=entry.wrapper, wrapper=_wrapper(entry, code_from)) for entry in entries
    ]


def _wrapper(  # noqa: C901, PLR0912 - one line for each wrapper.
    entry: wrappers.AnyWrapper, code_from: Path | None
) -> Wrapper:
    match entry:
        case wrappers.NoiseWrap():
            return values.AddNoise(entry)
        case wrappers.Crop():
            return images.Crop(entry)
        case wrappers.Resize():
            return images.Resize(entry)
        case wrappers.Normalize():
            return values.Normalize(entry)
        case wrappers.Scale():
            return values.Scale(entry)
        case wrappers.Clip():
            return values.Clip(entry)
        case wrappers.Grayscale():
            return images.Grayscale()
        case wrappers.Quantize():
            return values.Quantize(entry)
        case wrappers.Stack():
            return Stack(entry.steps, entry.axis)
        case wrappers.Channels():
            return images.Channels(entry)
        case wrappers.Flatten():
            return values.Flatten()
        case wrappers.PluginWrap():
            return foreign_wrapper(entry, code_from=code_from)
        case _:
            assert_never(entry)
