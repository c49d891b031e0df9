"""What a splat file holds, in numbers that a person wants first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.splat.files.quantise import sigmoid
from nw_eval.splat.gaussians import Gaussians
from nw_eval.words import RasterizeMode


@dataclass(frozen=True, kw_only=True)
class SplatFigures:
    """Figures of a set of Gaussians.

    Attributes:
        count: all of them.
        visible: those with opacity of at least 1/255 and finite values.
        not_finite: those with a value that is not finite.
        sh_degree: degree of the harmonics, 0 to 3.
        rasterize_mode: what the file says that they were trained for; None: nothing.
        bounds: (low, high) corners of all finite centres, x y z each.
        bulk: the same for the middle 98 % along each axis: floaters left out.
        scale_percentiles: 1, 50 and 99 % of the largest standard deviation, in file units.
        opacity_histogram: how many have opacity in each tenth of 0..1.
    """

    count: int
    visible: int
    not_finite: int
    sh_degree: int
    rasterize_mode: RasterizeMode | None
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    bulk: tuple[tuple[float, ...], tuple[float, ...]]
    scale_percentiles: tuple[float, float, float]
    opacity_histogram: tuple[int, ...]


def describe(gaussians: Gaussians) -> SplatFigures:
    """Return the figures of a set of Gaussians."""
    finite = np.isfinite(gaussians.means).all(axis=1)
    centres = gaussians.means[finite]
    if len(centres) == 0:
        centres = np.zeros((1, 3), dtype=np.float32)
    for values in (gaussians.log_scales, gaussians.quats):
        finite &= np.isfinite(values).all(axis=1)
    finite &= np.isfinite(gaussians.opacity_logits) & np.isfinite(gaussians.sh).all(axis=(1, 2))
    opacity = sigmoid(gaussians.opacity_logits[finite])
    largest = np.exp(np.clip(gaussians.log_scales[finite].max(axis=1, initial=-80.0), -80.0, 80.0))
    percentiles = np.percentile(largest, [1, 50, 99]) if len(largest) else np.zeros(3)
    return SplatFigures(
        count=len(gaussians),
        visible=int((opacity >= 1.0 / 255.0).sum()),
        not_finite=int((~finite).sum()),
        sh_degree=gaussians.sh_degree,
        rasterize_mode=gaussians.rasterize_mode,
        bounds=(_point(centres.min(axis=0)), _point(centres.max(axis=0))),
        bulk=(
            _point(np.percentile(centres, 1, axis=0)),
            _point(np.percentile(centres, 99, axis=0)),
        ),
        scale_percentiles=(float(percentiles[0]), float(percentiles[1]), float(percentiles[2])),
        opacity_histogram=tuple(np.histogram(opacity, bins=10, range=(0.0, 1.0))[0].tolist()),
    )


def _point(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(v) for v in values)
