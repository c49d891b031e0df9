"""The numerical choices that differ between versions of gsplat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from nw_eval.errors import UsageError, nearest

PresetName = Literal["gsplat-1.5", "gsplat-1.6"]


@dataclass(frozen=True, kw_only=True)
class Preset:
    """What a version of gsplat does where versions differ.

    Attributes:
        max_alpha: a splat's alpha is clamped to it.
        min_compensation: floor of the antialiased factor on opacity.
        eps2d: variance added to every footprint, in pixels squared.
    """

    max_alpha: float
    min_compensation: float
    eps2d: float = 0.3


PRESETS: dict[PresetName, Preset] = {
    # gsplat 1.5.3, rasterize_to_pixels and add_blur.
    "gsplat-1.5": Preset(max_alpha=0.999, min_compensation=0.0),
    # gsplat 1.6.0, gsplat/cuda/_constants.py.
    "gsplat-1.6": Preset(max_alpha=0.99, min_compensation=0.005),
}


def get_preset(name: str) -> Preset:
    """Return a preset by name.

    Raises:
        UsageError: for an unknown name, with the nearest known one.
    """
    if name not in PRESETS:
        raise UsageError(f"unknown splat preset {name!r}", fix=nearest(name, PRESETS))
    return PRESETS[name]
