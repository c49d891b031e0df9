"""Up by all cues together: which planes are level, which are walls, and which are neither."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.twin.align.gravity.horizon import Horizon, level_form, upright_form
from nw_eval.twin.align.gravity.planes import FittedPlane

Values = NDArray[np.float64]

_WIDEST = math.radians(30.0)
"""Between a plane's normal and the cameras' up, for it to be tried as a floor."""
_WIDENED = 1.8
"""The cone is this many standard deviations wide where the cameras know up badly."""
_LIKE = math.radians(1.5)
"""Planes this far from level or upright still speak for an up, with a weight of exp(-1/2)."""
AGREES = math.radians(3.0)
"""Planes within this are taken for level, or for upright."""
_BASE = 0.02
"""Share of points that the cameras' own up is worth where no plane agrees with it."""
LEVEL = math.radians(0.25)
"""How level floors are that were built level."""
UPRIGHT = math.radians(0.7)
"""How upright walls are; furniture is less."""
_CAUTIOUS = math.radians(2.0)
"""How well any source of poses is taken to know up, before planes are looked at."""
_LEAST_WALL = 0.03
"""Share of points of a plane that counts as a wall."""


@dataclass(frozen=True, kw_only=True)
class Consensus:
    """Up by all cues that agree.

    Attributes:
        up: (3,) unit vector.
        level: planes that are level to within `AGREES`, normals upwards.
        walls: planes that are upright to within it.
        form: (3, 3) of all of them together.
    """

    up: Values
    form: Values
    level: tuple[FittedPlane, ...]
    walls: tuple[FittedPlane, ...]


def consensus(
    horizon: Horizon,
    planes: Sequence[FittedPlane],
    doubts: Sequence[float],
    known: Sequence[tuple[Values, float]] = (),
) -> Consensus:
    """Return up by cameras, planes, and directions that a source of poses knows.

    Tried as up are the cameras' own up, the known ones, and each plane's normal near it. The best
    is the one that the cameras find likely and that makes most points lie on planes that are level
    or upright; so a ramp does not win because it is large. The cues that agree with it then give
    the answer together.

    Args:
        horizon: of the cameras.
        planes: in the sparse points.
        doubts: for each plane, how little it looks like a floor, see `doubt`.
        known: (3,) unit vectors, each with its standard deviation in radians.
    """
    cautious = [(up, max(sigma, _CAUTIOUS)) for up, sigma in known]
    prior = _sum(horizon.form, cautious)
    likely = smallest(prior, horizon.up if not known else known[0][0])
    cone = math.cos(max(_WIDEST, min(_WIDENED * math.radians(horizon.degrees), 2.0 * _WIDEST)))
    turned = [_upwards(plane, likely).normal for plane in planes]
    tried = [(likely, 0.0), *zip(turned, doubts, strict=True)]
    least = float(likely @ prior @ likely)
    scores = [
        math.log(_BASE + _agreement(up, planes)) - 0.5 * (float(up @ prior @ up) - least) - doubt
        if up @ likely >= cone
        else -math.inf
        for up, doubt in tried
    ]
    up = tried[int(np.argmax(scores))][0]
    level: list[FittedPlane] = []
    walls: list[FittedPlane] = []
    form = prior
    # A source that is off by more than planes may be takes no part.
    agree = [one for one in known if one[0] @ up > math.cos(AGREES)]
    prior = _sum(horizon.form, agree)
    for _ in range(3):
        level = [_upwards(p, up) for p in planes if abs(p.normal @ up) > math.cos(AGREES)]
        walls = [
            p for p in planes if abs(p.normal @ up) < math.sin(AGREES) and p.share > _LEAST_WALL
        ]
        form = prior.copy()
        for plane in level:
            form += level_form(plane.normal, math.hypot(LEVEL / _voice(plane), plane.sigma))
        for plane in walls:
            form += upright_form(plane.normal, math.hypot(UPRIGHT / _voice(plane), plane.sigma))
        up = smallest(form, up)
    return Consensus(up=up, form=form, level=tuple(level), walls=tuple(walls))


def smallest(form: Values, like: Values) -> Values:
    """Return the smallest eigenvector of a form, on the side of another direction."""
    up = np.linalg.eigh(form)[1][:, 0]
    return up if up @ like >= 0 else -up


def _sum(form: Values, known: Sequence[tuple[Values, float]]) -> Values:
    return sum((level_form(*one) for one in known), form)


def _agreement(up: Values, planes: Sequence[FittedPlane]) -> float:
    """Return the share of points on planes that are level or upright if that is up."""
    total = 0.0
    for plane in planes:
        sine = min(1.0, abs(float(plane.normal @ up)))
        off = min(math.acos(sine), math.asin(sine))
        total += plane.share * math.exp(-0.5 * (off / _LIKE) ** 2)
    return total


def _voice(plane: FittedPlane) -> float:
    """Return how much a plane has to say, 0 to 1: a table is less than a floor."""
    return min(1.0, math.sqrt(plane.share / 0.25))


def _upwards(plane: FittedPlane, up: Values) -> FittedPlane:
    if plane.normal @ up >= 0:
        return plane
    return FittedPlane(
        normal=-plane.normal, offset=-plane.offset, share=plane.share, sigma=plane.sigma
    )
