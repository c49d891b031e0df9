"""Planes in a cloud of points: drawn, voted for, taken one after another, and fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_VOTERS = 4000
"""Points that vote; all of them take part in the fits."""
_DRAWS = 400
"""For each plane, from the points that are left."""
_OTHERS = 32
"""Points from which a draw takes its second and third, the nearer ones: planes are local."""
_RANKS = (4, 9)
_ROUNDS = 12
"""Of fitting, weighing anew in each."""
_LEAST = 12
"""Points that make a plane."""


@dataclass(frozen=True, kw_only=True)
class FittedPlane:
    """The points x of which `normal @ x` = `offset`.

    Attributes:
        normal: (3,) unit vector, either way.
        offset: in the points' unit.
        share: of all points, which lies on it.
        sigma: standard deviation of its normal by the scatter of its points, radians.
    """

    normal: Values
    offset: float
    share: float
    sigma: float

    @property
    def equation(self) -> tuple[Values, float]:
        """Normal and offset."""
        return self.normal, self.offset

    def distances(self, points: Values) -> Values:
        """Return the signed distances of (N, 3) points, (N,)."""
        return np.einsum("ni,i->n", points, self.normal) - self.offset


def find_planes(
    points: Values, tolerance: float, rng: np.random.Generator, *, most: int = 10
) -> list[FittedPlane]:
    """Return the planes on which most points lie, those with more first.

    Each takes its points away before the next is drawn. Any rotation, translation or change of
    unit of points and tolerance gives the same planes, rotated, moved or scaled.

    Args:
        points: (N, 3).
        tolerance: how far off a point may be, in their unit.
        rng: of the draws.
        most: planes at most.
    """
    if len(points) < _LEAST:
        return []
    voters = points
    if len(points) > _VOTERS:
        voters = points[np.sort(rng.choice(len(points), _VOTERS, replace=False))]
    planes: list[FittedPlane] = []
    left = voters
    least = max(_LEAST, 0.02 * len(voters))
    while len(planes) < most and len(left) >= least:
        normals, offsets = _drawn(left, rng)
        votes = _votes(left, normals, offsets, tolerance)
        if not len(votes) or votes.max() < least:
            break
        best = int(np.argmax(votes))
        plane = fit_plane(left, normals[best], float(offsets[best]), tolerance)
        first = np.abs(np.einsum("ni,i->n", left, normals[best]) - offsets[best])
        left = left[(np.abs(plane.distances(left)) > 2.0 * tolerance) & (first > tolerance)]
        planes.append(_settled(points, fit_plane(points, *plane.equation, tolerance), tolerance))
    return planes


def fit_plane(
    points: Values,
    normal: Values,
    offset: float,
    tolerance: float,
    weights: Values | None = None,
) -> FittedPlane:
    """Return the plane near another one, by least squares with Tukey's weights.

    Args:
        points: (N, 3); most of them may lie elsewhere.
        normal: (3,) of the plane to begin with.
        offset: as above.
        tolerance: beyond twice this a point has no weight; in the points' unit.
        weights: (N,) of the points, such as areas; None = 1.
    """
    prior = np.ones(len(points)) if weights is None else weights
    values = np.ones(3)
    weight = np.zeros(len(points))
    for _ in range(_ROUNDS):
        off = np.einsum("ni,i->n", points, normal) - offset
        weight = prior * np.clip(1.0 - (off / (2.0 * tolerance)) ** 2, 0.0, None) ** 2
        total = weight.sum()
        if np.count_nonzero(weight) < 3:
            break
        middle = np.einsum("n,ni->i", weight, points) / total
        values, vectors = np.linalg.eigh(gram(points - middle, weight / total))
        normal, offset = vectors[:, 0], float(vectors[:, 0] @ middle)
    off = np.einsum("ni,i->n", points, normal) - offset
    count = np.count_nonzero(weight)
    scatter = max(float(values[0]), 1e-18) / max(float(values[1]), 1e-18)
    return FittedPlane(
        normal=normal,
        offset=offset,
        share=float(prior[np.abs(off) <= tolerance].sum() / prior.sum()),
        sigma=math.sqrt(scatter / max(count, 1)),
    )


def gram(vectors: Values, weights: Values) -> Values:
    """Return the weighted sum of v v' over (N, 3) vectors; the same for any number of threads."""
    return np.einsum("n,ni,nj->ij", weights, vectors, vectors)


def _settled(points: Values, plane: FittedPlane, tolerance: float) -> FittedPlane:
    """Return a plane fitted again as closely as its own points scatter: kerbs are not floor."""
    off = np.abs(plane.distances(points))
    spread = 3.0 * 1.4826 * float(np.median(off[off <= tolerance])) if plane.share else tolerance
    fine = fit_plane(points, *plane.equation, float(np.clip(spread, 0.2 * tolerance, tolerance)))
    return replace(fine, share=plane.share)


def _drawn(points: Values, rng: np.random.Generator) -> tuple[Values, Values]:
    """Return normals (D, 3) and offsets (D,) of planes through three points that lie together."""
    first = rng.integers(len(points), size=_DRAWS)
    others = rng.integers(len(points), size=(_DRAWS, _OTHERS))
    away = ((points[others] - points[first, None]) ** 2).sum(axis=2)
    order = np.take_along_axis(others, np.argsort(away, axis=1, kind="stable"), axis=1)
    corner = points[first]
    normal = np.cross(points[order[:, _RANKS[0]]] - corner, points[order[:, _RANKS[1]]] - corner)
    length = np.linalg.norm(normal, axis=1)
    whole = length > 1e-12 * max(float(length.max()), 1e-300)
    normal = normal[whole] / length[whole, None]
    return normal, (normal * corner[whole]).sum(axis=1)


def _votes(points: Values, normals: Values, offsets: Values, tolerance: float) -> NDArray[np.int64]:
    """Return how many points (N, 3) lie on each of D planes, (D,)."""
    votes = np.zeros(len(normals), dtype=np.int64)
    x, y, z = np.ascontiguousarray(points.T)
    for row, ((a, b, c), offset) in enumerate(zip(normals.tolist(), offsets.tolist(), strict=True)):
        votes[row] = np.count_nonzero(np.abs(a * x + b * y + c * z - offset) <= tolerance)
    return votes
