"""Lengths and heights that somebody measured, between points in space or picked in shots."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import UsageError, nearest
from nw_eval.scenes.scene import Vector
from nw_eval.twin.align.options import KnownLength, Pixel
from nw_eval.twin.align.scale.triangulate import triangulate
from nw_eval.twin.capture import Capture

Values = NDArray[np.float64]

_TOLERANCE = 8.0
"""Pixels that a picked point may be off: hands are less exact than detectors."""


def units_of(length: KnownLength, capture: Capture, up: Values) -> float:
    """Return how many of the capture's units a known length has.

    Args:
        length: with its two points.
        capture: in whose frame, or in whose shots, they are.
        up: (3,) unit vector, for heights.

    Raises:
        UsageError: a shot is not there, picks do not meet in a point, or the points coincide.
    """
    way = _point(length.second, capture) - _point(length.first, capture)
    units = abs(float(way @ up)) if length.vertical else float(np.linalg.norm(way))
    if units < 1e-9 * max(1.0, float(np.abs(capture.points).max(initial=0.0))):
        raise UsageError(
            f"the two points of a length of {length.metres:g} m coincide",
            fix="pick two points apart" + (" in height" if length.vertical else ""),
        )
    return units


def _point(where: Vector | Mapping[str, Pixel], capture: Capture) -> Values:
    if not isinstance(where, Mapping):
        return np.asarray(where, dtype=np.float64)
    shots = {shot.name: shot for shot in capture.shots}
    for name in where:
        if name not in shots:
            raise UsageError(
                f"a point was picked in {name!r}, which is no shot of the capture",
                fix=nearest(name, shots),
            )
    cameras = [shots[name].camera for name in where]
    pixels = np.array(list(where.values()), dtype=np.float64).reshape(-1, 1, 2)
    found = triangulate(cameras, pixels, tolerance=_TOLERANCE)
    if found is None:
        raise UsageError(
            f"the picks in {', '.join(where) or 'no shot'} do not meet in a point",
            fix="pick the same point in two shots or more, from places well apart",
        )
    return found.points[0]
