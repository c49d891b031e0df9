"""A splat alone, to points on its surface, through which a mesh is drawn like through any cloud.

A trained splat has its opaque Gaussians in surfaces, flat along them, so points are spread over
the Gaussians, as many as each covers. What is much larger than usual is sky or far background, and
what is nearly clear is haze.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import SceneError
from nw_base.plural import plural
from nw_splat.files import read_splat
from nw_splat.gaussians import SH0, drawable, sigmoid, unit_quats

Values = NDArray[np.float64]

SPLAT_SUFFIXES = (".spz", ".sog", ".splat")
"""Of files that hold Gaussians alone; a PLY may hold them, too."""
_LEAST_OPACITY = 0.2
_LARGEST = 8.0
"""Times the usual size from which on a Gaussian is no surface near by."""
_POINTS, _EACH = 300_000, 6
"""Points at most, and for each Gaussian."""
_R3 = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
_WIDE = 1.0
"""Standard deviations from a Gaussian's middle within which its points are."""


def points_of_splat(source: Path) -> tuple[Values, Values, list[str]]:
    """Return points (N, 3) on the surfaces of a splat, their colours (N, 3), and what is left out.

    The same file gives the same points.

    Raises:
        SceneError: it cannot be read, or has no opaque Gaussians.
    """
    gaussians = read_splat(source)
    gaussians = gaussians.take(drawable(gaussians))
    scales = np.exp(gaussians.log_scales.astype(np.float64))
    opacity = sigmoid(gaussians.opacity_logits)
    order = np.argsort(scales, axis=1)
    rows = np.arange(len(scales))
    middle, large = scales[rows, order[:, 1]], scales[rows, order[:, 2]]
    solid = opacity >= _LEAST_OPACITY
    if not solid.any():
        raise SceneError(f"{source}: no Gaussian is opaque", fix="give another splat")
    usual = float(np.median(large[solid]))
    near = large <= _LARGEST * usual
    kept = np.flatnonzero(solid & near)
    shares = (opacity * np.minimum(middle * large, usual**2))[kept]
    # Each Gaussian in turn has its share of evenly spaced numbers.
    ends = np.cumsum(shares) / shares.sum()
    count = min(_POINTS, _EACH * len(kept))
    number = (np.arange(count) + 0.5) / count
    of = kept[np.minimum(np.searchsorted(ends, number), len(kept) - 1)]
    # The R3 sequence (Roberts 2018) spreads points evenly over each disc, and through it: what
    # lies in a plane to the last digit has no volume, in which neighbours are looked for.
    place = np.arange(count)
    radius, turn, through = ((0.5 + place[:, None] * _R3) % 1.0).T
    radius, turn = _WIDE * np.sqrt(radius), 2.0 * np.pi * turn
    axes = _axes(gaussians.quats[of])
    first = axes[place, :, order[of, 2]] * (large[of] * radius * np.cos(turn))[:, None]
    second = axes[place, :, order[of, 1]] * (middle[of] * radius * np.sin(turn))[:, None]
    third = axes[place, :, order[of, 0]] * (scales[of, order[of, 0]] * (through - 0.5))[:, None]
    points = gaussians.means[of].astype(np.float64) + first + second + third
    colours = np.clip(0.5 + SH0 * gaussians.sh[of, 0].astype(np.float64), 0.0, 1.0)
    left = [
        plural(n, "Gaussian") + why
        for n, why in (
            (int((~solid).sum()), f" of an opacity below {_LEAST_OPACITY:g}"),
            (int((solid & ~near).sum()), f" over {_LARGEST:g} times as large as usual"),
        )
        if n
    ]
    return points, colours, left


def _axes(quats: NDArray[np.float32]) -> Values:
    """Return rotations (N, 3, 3) of quaternions wxyz."""
    w, x, y, z = unit_quats(quats).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
