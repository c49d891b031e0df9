"""How much of a frame the splat covers: the sign that a camera left the captured volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.splat.image import Image


@dataclass(frozen=True, kw_only=True)
class FrameCoverage:
    """What share of a frame is splat rather than background.

    Attributes:
        mean_alpha: mean coverage of the pixels, 0 to 1.
        covered: share of the pixels with alpha of at least 0.5.
        lower_half: the same for the lower half of the image, where the ground is.
    """

    mean_alpha: float
    covered: float
    lower_half: float


def measure_coverage(image: Image) -> FrameCoverage:
    """Return the coverage of a frame."""
    covered = image.alpha >= 0.5
    return FrameCoverage(
        mean_alpha=float(image.alpha.mean(dtype=np.float64)),
        covered=float(covered.mean()),
        lower_half=float(covered[covered.shape[0] // 2 :].mean()),
    )
