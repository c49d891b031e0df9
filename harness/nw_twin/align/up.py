"""Up by all cues together: a posterior over directions, and how far from its best one up may lie.

The residual of a cue says how well its pieces agree with each other, not how true it is: a bent
map, a ceiling without texture and a facade that leans are off as a whole. So each cue has two
terms besides its own scatter. `_TAUS` is by how much the cues of this place disagree; it is
unknown, and few cues leave it to its prior, which is of places whose up is known. And each cue may
be wrong altogether: a plane may be neither level nor upright, edges may be those of furniture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_twin.align.planes import LEVEL, UPRIGHT, FittedPlane, Horizon

Values = NDArray[np.float64]

_TAUS = np.radians([0.2, 0.4, 0.7, 1.1, 1.7, 2.6, 4.0])
_PRIOR = np.array([0.06, 0.12, 0.2, 0.24, 0.2, 0.12, 0.06])
_NU = 3.0
"""Degrees of freedom of Student's t, for all cues."""
_BUILT, _NATURAL, _WALL, _OTHER = 0.22, 0.10, 0.38, 0.30
"""Shares of planes that are level, that slope as ground does, that are upright, and others."""
_RAISED = 0.35
"""Of planes with a floor below, the share that is as level as floors: tables, and not sofas."""
_SLOPES = math.radians(3.0)
_LARGE = 0.05
"""Share of the points from which on a plane is one whole piece of evidence."""
_ONE_PLANE = math.radians(2.0)
"""Planes that are as parallel and lie in one are one piece of evidence."""
_CONE, _NEAR = math.radians(60.0), math.radians(8.0)
_BLUR = math.radians(0.9)
"""Distance of the directions that are tried in the wide cone: cues are as broad there at least."""
_EXACT = 1e-7
"""Radians to which the best direction is sought."""
_HELD = 0.9
"""Of the posterior, within the radius that is stated."""


@dataclass(frozen=True, kw_only=True)
class KnownUp:
    """A cue that names a direction for up: upright edges, or a source of poses.

    Attributes:
        name: of its cue.
        up: (3,) unit vector in the capture's frame.
        sigma: its standard deviation where it is right, radians.
        right: probability that it is.
        reason: for people.
    """

    name: str
    up: Values
    sigma: float
    right: float = 0.9
    reason: str


@dataclass(frozen=True, kw_only=True)
class Up:
    """The best direction, and how well it is known.

    Attributes:
        up: (3,) unit vector in the capture's frame.
        uncertain: angle within which up lies with a probability of 0.9, degrees.
    """

    up: Values
    uncertain: float


def solve_up(
    horizon: Horizon,
    planes: Sequence[FittedPlane],
    doubts: Sequence[float],
    known: Sequence[KnownUp] = (),
) -> Up:
    """Return up by the cameras, by planes, and by cues that name a direction.

    The same cues in another rotation give the same answer, rotated.

    Args:
        horizon: of the cameras.
        planes: level, upright or neither.
        doubts: for each plane, how little it looks like a floor, see `doubt`.
        known: up as edges or a source of poses have it.
    """
    start = known[0].up if known and known[0].sigma < math.radians(1.0) else horizon.up
    kept = _distinct(planes)
    evidence = ([planes[i] for i in kept], [doubts[i] for i in kept])
    wide = _around(start, horizon.aside, _CONE, 4000)
    far = _density(wide, horizon, *evidence, known, _BLUR)
    seeds = np.array([wide[int(np.argmax(far))], *(cue.up for cue in known)])
    best = seeds[int(np.argmax(_density(seeds, horizon, *evidence, known, 0.0)))]
    radius, count = 0.25 * _NEAR, 800
    while radius > _EXACT:
        tried = np.vstack([best[None], _around(best, horizon.aside, radius, count)])
        best = tried[int(np.argmax(_density(tried, horizon, *evidence, known, 0.0)))]
        radius, count = 0.15 * radius, 80
    near = _around(best, horizon.aside, _NEAR, 4000)
    close = _density(near, horizon, *evidence, known, 0.0)
    beyond = wide @ best < math.cos(_NEAR)
    area = 2.0 * math.pi * (1.0 - np.cos([_NEAR, _CONE]))
    logs = np.concatenate(
        [close + math.log(area[0] / len(near)), far[beyond] + math.log(area[1] / len(wide))]
    )
    mass = np.exp(logs - logs.max())
    angles = np.arccos(np.clip(np.concatenate([near, wide[beyond]]) @ best, -1.0, 1.0))
    order = np.argsort(angles, kind="stable")
    held = np.cumsum(mass[order]) / mass.sum()
    place = min(int(np.searchsorted(held, _HELD)), len(order) - 1)
    return Up(up=best, uncertain=math.degrees(float(angles[order][place])))


def _distinct(planes: Sequence[FittedPlane]) -> list[int]:
    """Return the numbers of planes, largest first, without the lesser pieces of a larger one."""
    kept: list[int] = []
    for i in sorted(range(len(planes)), key=lambda one: -planes[one].share):
        if all(_apart(planes[i], planes[k]) for k in kept):
            kept.append(i)
    return kept


def _apart(plane: FittedPlane, other: FittedPlane) -> bool:
    cosine = float(plane.normal @ other.normal)
    if abs(cosine) < math.cos(_ONE_PLANE):
        return True
    away = abs(plane.offset * math.copysign(1.0, cosine) - other.offset)
    return away > 3.0 * max(plane.tolerance, other.tolerance)


def _density(
    ups: Values,
    horizon: Horizon,
    planes: Sequence[FittedPlane],
    doubts: Sequence[float],
    known: Sequence[KnownUp],
    blur: float,
) -> Values:
    """Return the log of the posterior, up to a constant, at directions (N, 3)."""
    off = np.einsum("ni,ij,nj->n", ups, horizon.form, ups)
    cameras = -(_NU + 2.0) / 2.0 * np.log1p(off / _NU)
    cosines = [np.clip(np.abs(ups @ plane.normal), 0.0, 1.0) for plane in planes]
    angles = [np.arccos(np.clip(ups @ cue.up, -1.0, 1.0)) for cue in known]
    logs: list[Values] = []
    for tau, prior in zip(_TAUS, _PRIOR, strict=True):
        total = cameras + math.log(prior)
        for cosine, plane, doubt in zip(cosines, planes, doubts, strict=True):
            total = total + _plane(cosine, plane, doubt, math.hypot(tau, blur))
        for angle, cue in zip(angles, known, strict=True):
            sigma = math.hypot(cue.sigma, math.hypot(tau, blur))
            total = total + np.log(cue.right * _along(angle, sigma) + (1 - cue.right) / math.pi / 4)
        logs.append(total)
    return np.logaddexp.reduce(logs, axis=0)


def _plane(cosine: Values, plane: FittedPlane, doubt: float, shared: float) -> Values:
    """Return the log density of a plane's normal, on half a sphere, at cosines (N,) from up."""
    floor = _RAISED + (1.0 - _RAISED) * math.exp(-doubt)
    level = math.hypot(shared, LEVEL, plane.sigma)
    natural = math.hypot(shared, _SLOPES, plane.sigma)
    wall = math.hypot(shared, UPRIGHT, plane.sigma)
    angle, across = np.arccos(cosine), np.arcsin(cosine)
    density = (
        floor * (_BUILT * _along(angle, level) + _NATURAL * _along(angle, natural))
        + _WALL * _across(across, wall)
        + (_OTHER + (1.0 - floor) * (_BUILT + _NATURAL)) / (2.0 * math.pi)
    )
    return min(1.0, math.sqrt(plane.share / _LARGE)) * np.log(density)


def _along(angle: Values, sigma: float) -> Values:
    """Return the density, Student's, of a direction at angles from another; per sr."""
    tail = np.power(1.0 + np.square(angle / sigma) / _NU, -(_NU + 2.0) / 2.0)
    return tail / (2.0 * math.pi * sigma**2)


def _across(angle: Values, sigma: float) -> Values:
    """Return the density, Student's, of an axis at angles from the plane across another; per sr."""
    norm = 2.0 / (math.pi * math.sqrt(_NU)) / (math.pi * sigma)
    return norm * np.power(1.0 + np.square(angle / sigma) / _NU, -(_NU + 1.0) / 2.0)


def _around(up: Values, aside: Values, radius: float, count: int) -> Values:
    """Return directions within a radius of another, evenly spread, (count, 3)."""
    first = aside - (aside @ up) * up
    if np.linalg.norm(first) < 0.1:
        first = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    first = first / np.linalg.norm(first)
    second = np.cross(up, first)
    place = np.arange(count) + 0.5
    cosine = 1.0 - (1.0 - math.cos(radius)) * place / count
    turn = math.pi * (1.0 + math.sqrt(5.0)) * place
    sine = np.sqrt(1.0 - np.square(cosine))
    directions = (
        cosine[:, None] * up
        + (sine * np.cos(turn))[:, None] * first
        + (sine * np.sin(turn))[:, None] * second
    )
    return np.asarray(directions, dtype=np.float64)
