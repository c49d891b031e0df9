"""Planes in a cloud of points: drawn, voted for, taken one after another, and fitted.

And the cameras' horizon, of the way that cameras are held: people tilt them up and down, hardly
ever sideways.
"""

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
        tolerance: how far off a point of it may be, in the points' unit.
    """

    normal: Values
    offset: float
    share: float
    sigma: float
    tolerance: float = 0.0

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
        offset: of the plane to begin with.
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
        tolerance=tolerance,
    )


def gram(vectors: Values, weights: Values) -> Values:
    """Return the weighted sum of v v' over (N, 3) vectors; the same for any number of threads."""
    return np.einsum("n,ni,nj->ij", weights, vectors, vectors)


def _settled(points: Values, plane: FittedPlane, tolerance: float) -> FittedPlane:
    """Return a plane fitted again as closely as its own points scatter: kerbs are not floor."""
    off = np.abs(plane.distances(points))
    spread = 3.0 * 1.4826 * float(np.median(off[off <= tolerance])) if plane.share else tolerance
    fine = fit_plane(points, *plane.equation, float(np.clip(spread, 0.2 * tolerance, tolerance)))
    return replace(fine, share=plane.share, tolerance=tolerance)


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


AGREES = math.radians(3.0)
"""Planes within this are taken for level, or for upright."""
LEVEL = math.radians(0.25)
"""How level floors are that were built level."""
UPRIGHT = math.radians(0.7)
"""How upright walls are; furniture is less."""

_ROLL = math.radians(1.0)
"""Least roll of a camera that is held by hand: none is assumed to be better."""
_INDEPENDENT = 8
"""Shots that count as such: one hand rolls all of them alike."""
_TILT = math.radians(2.0)
"""What all shots may have in common: a phone held askew."""
_DOWN, _PITCH = math.radians(15.0), math.radians(20.0)
"""By which cameras look down at what they show, all together: usually, and its scatter."""
_PAIRS = 400
_TURN = 0.95
"""Length of the mean of the sideways axes from which on the cameras hardly turn."""
_CLIPPED = math.sin(math.radians(12.0))
"""A sideways axis that points further up or down is no sideways axis."""


def smallest(form: Values, like: Values) -> Values:
    """Return the smallest eigenvector of a form, on the side of another direction."""
    up = np.linalg.eigh(form)[1][:, 0]
    return up if up @ like >= 0 else -up


def upwards(plane: FittedPlane, up: Values) -> FittedPlane:
    """Return a plane with its normal on the side of a direction."""
    if plane.normal @ up >= 0:
        return plane
    return replace(plane, normal=-plane.normal, offset=-plane.offset)


@dataclass(frozen=True, kw_only=True)
class Horizon:
    """Up as the cameras have it.

    Attributes:
        up: (3,) unit vector.
        form: (3, 3), the quadratic form that gravity.py explains.
        degrees: standard deviation along the direction that is known least.
        roll: standard deviation of the cameras' roll about it, degrees.
        sideways: whether the pictures lie on their sides, as those of phones held upright may.
        aside: (3,) sideways axis of the first camera.
    """

    up: Values
    form: Values
    degrees: float
    roll: float
    sideways: bool
    aside: Values


def horizon(rotations: Values, rng: np.random.Generator) -> Horizon:
    """Return up by the cameras' sideways axes: all of them are perpendicular to it.

    Args:
        rotations: (N, 3, 3) from camera to capture, OpenCV axes.
        rng: of the pairs of axes that are tried.
    """
    right, down, forward = np.moveaxis(rotations, 2, 0)
    sideways = _lie_on_their_sides(right, down)
    level = down if sideways else right
    upright = right if sideways else -down
    weights, roll = _level_weights(level, upright, rng)
    independent = min(1.0, _INDEPENDENT / len(level))
    if np.linalg.norm(level.mean(axis=0)) > _TURN:  # How each is rolled says nothing more.
        level = np.broadcast_to(level.mean(axis=0), level.shape)
    # What the axes scatter no more than by their roll, twice over, shows nothing.
    values, vectors = np.linalg.eigh(independent * gram(level, weights) / roll**2)
    shown = np.clip(values - 2.0 * independent * weights.sum(), 0.0, None)
    form = np.einsum("ik,k,jk->ij", vectors, shown, vectors)
    # Hands hold cameras pitched down, rather than up.
    mean = math.cos(_DOWN) * upright.mean(axis=0) - math.sin(_DOWN) * forward.mean(axis=0)
    if np.linalg.norm(mean) > 0.1:
        form = form + level_form(mean / np.linalg.norm(mean), _PITCH)
    # A tilt that they have in common is beyond what their own scatter shows.
    form = np.linalg.inv(np.linalg.inv(form + 1e-3 * np.eye(3)) + _TILT**2 * np.eye(3))
    up = np.linalg.eigh(form)[1][:, 0]
    # Cameras stand upright and look down; only what lies on its side has but the second.
    sense = -forward.mean(axis=0) if sideways else -(down + forward).mean(axis=0)
    return Horizon(
        up=up if up @ sense >= 0 else -up,
        form=form,
        degrees=known_to(form),
        roll=math.degrees(roll),
        sideways=sideways,
        aside=rotations[0, :, 0],
    )


def known_to(form: Values) -> float:
    """Return the standard deviation of a form's direction where it is known least, degrees."""
    values = np.linalg.eigvalsh(form)
    return math.degrees(1.0 / math.sqrt(max(float(values[1] - values[0]), 1e-3)))


def level_form(normal: Values, sigma: float) -> Values:
    """Return the form of a direction that is up to within `sigma` radians."""
    return (np.eye(3) - np.outer(normal, normal)) / sigma**2


def upright_form(normal: Values, sigma: float) -> Values:
    """Return the form of a direction that is perpendicular to up to within `sigma` radians."""
    return np.outer(normal, normal) / sigma**2


def _lie_on_their_sides(right: Values, down: Values) -> bool:
    """Return whether the cameras turn about their x axes, where others turn about their y axes."""
    ones = np.full(len(right), 1.0 / len(right))
    across = np.linalg.eigvalsh(gram(right, ones))
    along = np.linalg.eigvalsh(gram(down, ones))
    return bool(across[1] < 0.05 and along[1] > 0.15 and along[0] < 0.25 * along[1])


def _level_weights(axes: Values, upright: Values, rng: np.random.Generator) -> tuple[Values, float]:
    """Return the weight of each axis as one that is level, and their scatter in radians."""
    mean = axes.mean(axis=0)
    if np.linalg.norm(mean) > _TURN:  # Any direction across is as level: roll is what is upright.
        across = upright.mean(axis=0) - (upright.mean(axis=0) @ mean) * mean / (mean @ mean)
        off = np.einsum("ni,i->n", axes, across / np.linalg.norm(across))
        return np.ones(len(axes)), max(_ROLL, 1.4826 * float(np.median(np.abs(off))))
    first, second = rng.integers(len(axes), size=(2, _PAIRS))
    tried = np.cross(axes[first], axes[second])
    length = np.linalg.norm(tried, axis=1)
    tried = tried[length > 1e-3] / length[length > 1e-3, None]
    up = np.linalg.eigh(gram(axes, np.ones(len(axes))))[1][:, 0]
    if len(tried):
        cost = np.minimum(np.abs(np.einsum("ni,pi->pn", axes, tried)), _CLIPPED).sum(axis=1)
        up = tried[np.argmin(cost)]
    roll, weights = _ROLL, np.ones(len(axes))
    for _ in range(10):
        off = np.einsum("ni,i->n", axes, up)
        roll = max(_ROLL, 1.4826 * float(np.median(np.abs(off))))
        weights = 1.0 / (1.0 + (off / (2.0 * roll)) ** 2) ** 2
        up = np.linalg.eigh(gram(axes, weights))[1][:, 0]
    return weights, roll
