"""Why photographs could not be placed, in words that help whoever took them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from nw_eval.twin.calibrate.photographs import Photograph
from nw_eval.twin.calibrate.report import LeftOut
from nw_eval.twin.calibrate.solving.features import Matches

BLURRED, PLAIN = "blurred", "no texture"
APART, UNFIT = "too far from the others", "does not fit the others"
_FEW_FEATURES = 150
_FEW_MATCHES = 30
"""COLMAP's own least number of points by which a camera is placed."""
_BLURRED = 0.3
"""Of the sharpness of the others, their contrast allowed for."""
_SHAKEN = 0.02
"""Sharpness in squares of the contrast: what has edges at all has more."""


def why_not(
    photographs: Sequence[Photograph], placed: Iterable[str], matches: Matches
) -> list[LeftOut]:
    """Return each photograph that is not among the placed, with the likeliest reason.

    Blurred: far less fine detail than the others, though not less contrast; or few features, and
    none of what there is has an edge. No texture: few features. Too far: few matches with any that
    is placed, or with any at all if none is.
    """
    known = set(placed)
    files = {one.file for one in photographs if one.name in known}
    files = files or {one.file for one in photographs}
    left = [one for one in photographs if one.name not in known]
    good = [one for one in photographs if one.name in known] or photographs
    sharp = float(np.median([one.sharpness for one in good]))
    contrast = float(np.median([one.contrast for one in good]))
    most = {one.file: _most(one.file, files, matches) for one in left}
    return [_reason(one, sharp, contrast, most[one.file], matches) for one in left]


def _most(file: str, others: set[str], matches: Matches) -> int:
    found = [
        count
        for pair, count in matches.inliers.items()
        if file in pair and (pair[0] if pair[1] == file else pair[1]) in others
    ]
    return max(found, default=0)


def _reason(one: Photograph, sharp: float, contrast: float, most: int, matches: Matches) -> LeftOut:
    share = one.sharpness / max(sharp, 1e-9)
    features = matches.features.get(one.file, 0)
    if share < _BLURRED and one.contrast > 0.4 * contrast:
        reason, detail = BLURRED, f"{share:.0%} of the others' sharpness"
    elif features < _FEW_FEATURES and one.sharpness < _SHAKEN * one.contrast**2:
        reason, detail = BLURRED, f"{features} features, none of its edges is sharp"
    elif features < _FEW_FEATURES:
        reason, detail = PLAIN, f"{features} features"
    elif most < _FEW_MATCHES:
        reason, detail = APART, f"at most {most} matches with one of them"
    else:
        reason, detail = UNFIT, f"{most} matches with one of them, yet no place for it"
    return LeftOut(name=one.name, reason=reason, detail=detail)
