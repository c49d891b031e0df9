"""Where one walked: the cameras from above, without what hands do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import SceneError

Values = NDArray[np.float64]

STEP = 0.02
"""Between samples of a way, metres."""

_SMOOTH = 0.6
"""Length over which a way is rounded off, metres: hands and steps swing by less."""
_LEAST = 1.0
"""Of a way that can be a trail, metres."""
_FAR = 0.9
"""Share of the farthest camera's distance: the first time that the walk is so far, it is there."""


def way_of(centres: Values) -> Values:
    """Return the way there, (S, 2) metres, `STEP` apart: from the first camera to the walk's end.

    Who walked back took the same way twice; only the way there counts. So does it where somebody
    then went around the place, and half a step farther: the end is the farthest camera of the first
    time that the walk came near its greatest distance.

    Args:
        centres: (V, 3) of the cameras in the order of the walk, metres, z up.

    Raises:
        SceneError: the cameras went less than a metre.
    """
    flat = centres[:, :2]
    away = np.linalg.norm(flat - flat[:1], axis=1)
    if not len(flat) or away.max() < _LEAST:
        gone = float(away.max(initial=0.0))
        raise SceneError(
            f"the cameras went {gone:.2f} m from the first one, which is no trail",
            fix=f"photograph a walk of {_LEAST:g} m or more, or write the trail by hand",
        )
    walked = _even(flat[: _end(away) + 1])
    half = max(1, round(_SMOOTH / STEP / 2))
    # The ends are mirrored at themselves, so that the way still begins and ends where it did.
    before, after = (
        2 * walked[0] - walked[half:0:-1],
        2 * walked[-1] - walked[-2 : -half - 2 : -1],
    )
    padded = np.concatenate([before, walked, after])
    sums = np.cumsum(np.concatenate([np.zeros((1, 2)), padded]), axis=0)
    width = 2 * half + 1
    return _even((sums[width:] - sums[:-width]) / width)


def _end(away: Values) -> int:
    """Return the camera at which the walk, at such distances from its first one, turned back."""
    near = away >= _FAR * away.max()
    first = int(np.argmax(near))
    back = np.flatnonzero(~near[first:])
    last = first + int(back[0]) if len(back) else len(away)
    return first + int(np.argmax(away[first:last]))


def _even(points: Values) -> Values:
    """Return points `STEP` apart along a polyline."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    stations = np.arange(0.0, along[-1] + 1e-9, STEP)
    return np.column_stack([np.interp(stations, along, axis) for axis in points.T])
