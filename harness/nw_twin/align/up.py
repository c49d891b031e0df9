"""Up by all cues together: a posterior over directions, and how far from its best one up may lie.

The residual of a cue says how well its pieces agree with each other, not how true it is: a bent
map, a ceiling without texture and a facade that leans are off as a whole. So each cue has two
terms besides its own scatter. `_TAUS` is by how much the cues of this place disagree; it is
unknown, and few cues leave it to its prior, which is of places whose up is known. And each cue may
be wrong altogether: a plane may be neither level nor upright, edges may be those of furniture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

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
_SLANTED, _LEAST_SLANTED = 0.1, 0.02
"""Share of the points that a plane of neither kind has, usually, and how much less probable a much
larger one is at most: streets and courtyards are level or slope a little, houses are upright."""
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
_MODES, _CLOSE = 6, 4000
"""Directions about which the posterior is looked at closely, and how many are tried about each."""
_EXACT = 1e-7
"""Radians to which the best direction is sought."""
_HELD = 0.95
"""Of the posterior, within the radius that is stated."""
_SAME = math.radians(2.0)
"""A floor that slopes more than this from the best direction is a slope, and not put level."""


@dataclass(frozen=True, kw_only=True)
class KnownUp:
    """A cue that names a direction for up: upright edges, a source of poses, or a file format.

    Attributes:
        name: of its cue.
        up: (3,) unit vector in the frame of the capture or the file.
        sigma: its standard deviation where it is right, radians.
        right: probability that it is.
        others: other directions that it may mean: (3,), its probability, and its sigma.
        exact: whether where it is right it is off by `sigma` alone, however the map is bent.
        reason: for people.
    """

    name: str
    up: Values
    sigma: float
    right: float = 0.9
    others: tuple[tuple[Values, float, float], ...] = ()
    exact: bool = False
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Up:
    """The posterior, by directions that hold it.

    Attributes:
        up: (3,) unit vector, the best direction.
        directions: (N, 3) unit vectors.
        mass: (N,) of the posterior near each; their sum is 1.
    """

    up: Values
    directions: Values
    mass: Values

    @property
    def uncertain(self) -> float:
        """Angle about the best direction within which up lies with 95 %, degrees."""
        return self.around(self.up)

    def around(self, direction: Values) -> float:
        """Return the angle about a direction (3,) within which up lies with 95 %, degrees."""
        angles = np.arccos(np.clip(self.directions @ direction, -1.0, 1.0))
        order = np.argsort(angles, kind="stable")
        index = int(np.searchsorted(np.cumsum(self.mass[order]), _HELD))
        return math.degrees(float(angles[order][min(index, len(order) - 1)]))

    def probability(self, direction: Values, radians: float) -> float:
        """Return the probability that up lies within an angle of a direction (3,)."""
        return float(self.mass[self.directions @ direction > math.cos(radians)].sum())

    def by_floor(self, normal: Values) -> Up:
        """Return the posterior with a floor's normal (3,) for up, if that is as likely true.

        That is where it lies within the stated angle, and is no slope.
        """
        angle = math.acos(min(1.0, float(normal @ self.up)))
        if angle <= min(_SAME, math.radians(self.uncertain)):
            return replace(self, up=normal)
        return self


def solve_up(
    horizon: Horizon | None,
    planes: Sequence[FittedPlane],
    doubts: Sequence[float],
    known: Sequence[KnownUp] = (),
    others: Callable[[Values], Values] = lambda ups: np.zeros(len(ups)),
) -> Up:
    """Return up by the cameras, by planes, and by cues that name a direction.

    The same cues in another rotation give the same answer, rotated.

    Args:
        horizon: of the cameras, by which up is known to 60 degrees; None = up may be anywhere, and
            `known` is not empty.
        planes: level, upright or neither.
        doubts: for each plane, how little it looks like a floor, see `doubt`.
        known: up as edges, a source of poses or a file format have it.
        others: log densities (N,) of further cues at directions (N, 3); they are broad.
    """
    if horizon is None:
        start, aside, cone, count = known[0].up, np.zeros(3), math.pi, 16_000
    else:
        sure = known and known[0].sigma < math.radians(1.0)
        start, aside, cone, count = known[0].up if sure else horizon.up, horizon.aside, _CONE, 4000
    kept = _distinct(planes)
    evidence = ([planes[i] for i in kept], [doubts[i] for i in kept], known)

    def density(ups: Values, blur: float = 0.0) -> Values:
        return _density(ups, horizon, *evidence, blur) + others(ups)

    wide = _around(start, aside, cone, count)
    far = density(wide, _BLUR)
    named = [way for cue in known for way in (cue.up, *(other for other, *_ in cue.others))]
    named += [sense * plane.normal for plane in evidence[0] for sense in (1.0, -1.0)]
    named = [way for way in named if way @ start >= math.cos(cone)]
    seeds = np.array([wide[int(np.argmax(far))], *named])
    modes: list[Values] = []
    for seed in seeds[np.argsort(-density(seeds), kind="stable")]:
        if len(modes) < _MODES and all(seed @ mode < math.cos(_NEAR) for mode in modes):
            modes.append(_climbed(seed, aside, density))
    # Blurred as they are on the wide grid, cues that agree lose more than those that do not, so
    # each of several directions is looked at closely.
    directions, logs = [], []
    for index, mode in enumerate(modes):
        near = _around(mode, aside, _NEAR, _CLOSE)
        near = near[_beyond(near, modes[:index])]
        directions.append(near)
        logs.append(density(near) + math.log((1.0 - math.cos(_NEAR)) / _CLOSE))
    beyond = _beyond(wide, modes)
    directions.append(wide[beyond])
    logs.append(far[beyond] + math.log((1.0 - math.cos(cone)) / count))
    joined = np.concatenate(logs)
    mass = np.exp(joined - joined.max())
    held = [float(mass[: sum(map(len, directions[: i + 1]))].sum()) for i in range(len(modes))]
    best = modes[int(np.argmax(np.diff(held, prepend=0.0)))]
    return Up(up=best, directions=np.concatenate(directions), mass=mass / mass.sum())


def _climbed(start: Values, aside: Values, density: Callable[[Values], Values]) -> Values:
    """Return the direction near another one at which a density is largest."""
    best, radius, tries = start, 0.25 * _NEAR, 800
    while radius > _EXACT:
        tried = np.vstack([best[None], _around(best, aside, radius, tries)])
        best = tried[int(np.argmax(density(tried)))]
        radius, tries = 0.15 * radius, 80
    return best


def _beyond(directions: Values, modes: Sequence[Values]) -> NDArray[np.bool_]:
    """Return which of directions (N, 3) lie near none of some others."""
    beyond = np.ones(len(directions), dtype=np.bool_)
    for mode in modes:
        beyond &= directions @ mode < math.cos(_NEAR)
    return beyond


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
    horizon: Horizon | None,
    planes: Sequence[FittedPlane],
    doubts: Sequence[float],
    known: Sequence[KnownUp],
    blur: float,
) -> Values:
    """Return the log of the posterior, up to a constant, at directions (N, 3)."""
    cameras = np.zeros(len(ups))
    if horizon is not None:
        off = np.einsum("ni,ij,nj->n", ups, horizon.form, ups)
        cameras = -(_NU + 2.0) / 2.0 * np.log1p(off / _NU)
    cosines = [np.clip(np.abs(ups @ plane.normal), 0.0, 1.0) for plane in planes]
    logs: list[Values] = []
    for tau, prior in zip(_TAUS, _PRIOR, strict=True):
        total = cameras + math.log(prior)
        for cosine, plane, doubt in zip(cosines, planes, doubts, strict=True):
            total = total + _plane(cosine, plane, doubt, math.hypot(tau, blur))
        for cue in known:
            total = total + _named(ups, cue, blur if cue.exact else math.hypot(tau, blur))
        logs.append(total)
    return np.logaddexp.reduce(logs, axis=0)


def _named(ups: Values, cue: KnownUp, shared: float) -> Values:
    """Return the log density at directions (N, 3) of a cue that names one, or one of some.

    `shared` is added to what each is off by.
    """
    ways = ((cue.up, cue.right, cue.sigma), *cue.others)
    density = np.full(len(ups), (1.0 - sum(right for _, right, _ in ways)) / (4.0 * math.pi))
    for way, right, sigma in ways:
        angle = np.arccos(np.clip(ups @ way, -1.0, 1.0))
        density = density + right * _along(angle, math.hypot(sigma, shared))
    return np.log(density)


def _plane(cosine: Values, plane: FittedPlane, doubt: float, shared: float) -> Values:
    """Return the log density of a plane's normal, on half a sphere, at cosines (N,) from up."""
    floor = _RAISED + (1.0 - _RAISED) * math.exp(-doubt)
    level = math.hypot(shared, LEVEL, plane.sigma)
    natural = math.hypot(shared, _SLOPES, plane.sigma)
    wall = math.hypot(shared, UPRIGHT, plane.sigma)
    angle, across = np.arccos(cosine), np.arcsin(cosine)
    other = _OTHER * max(math.exp(-plane.share / _SLANTED), _LEAST_SLANTED)
    density = (
        floor * (_BUILT * _along(angle, level) + _NATURAL * _along(angle, natural))
        + _WALL * _across(across, wall)
        + (other + (1.0 - floor) * (_BUILT + _NATURAL)) / (2.0 * math.pi)
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
