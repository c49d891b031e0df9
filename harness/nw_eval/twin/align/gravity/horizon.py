"""Up by the way that cameras are held: people tilt them up and down, hardly ever sideways."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_ROLL = math.radians(1.0)
"""Least roll of a camera that is held by hand: nobody is taken for better."""
_INDEPENDENT = 30
"""Shots that count as such: frames of a film are rolled alike."""
_TILT = math.radians(2.0)
"""What all shots may have in common: a phone held askew."""
_PITCH = math.radians(25.0)
"""Of the mean of all cameras' ups from up: cameras look down at what they show."""
_PAIRS = 400
_TURN = 0.95
"""Length of the mean of the sideways axes from which on the cameras hardly turn."""
_CLIPPED = math.sin(math.radians(12.0))
"""A sideways axis that points further up or down is no sideways axis."""


@dataclass(frozen=True, kw_only=True)
class Horizon:
    """Up as the cameras have it.

    Attributes:
        up: (3,) unit vector.
        form: (3, 3), the quadratic form of the package's docstring.
        degrees: standard deviation along the direction that is known least.
        roll: standard deviation of the cameras' roll about it, degrees.
        sideways: whether the pictures lie on their sides, as those of phones held upright may.
    """

    up: Values
    form: Values
    degrees: float
    roll: float
    sideways: bool


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
    # What the axes scatter no more than by their roll, twice over, shows nothing.
    values, vectors = np.linalg.eigh(independent * gram(level, weights) / roll**2)
    shown = np.clip(values - 2.0 * independent * weights.sum(), 0.0, None)
    form = np.einsum("ik,k,jk->ij", vectors, shown, vectors)
    mean = upright.mean(axis=0)
    if np.linalg.norm(mean) > 0.1:
        form = form + level_form(mean / np.linalg.norm(mean), _PITCH)
    # A tilt that they have in common is beyond what their own scatter shows.
    form = np.linalg.inv(np.linalg.inv(form + 1e-3 * np.eye(3)) + _TILT**2 * np.eye(3))
    values, vectors = np.linalg.eigh(form)
    up = vectors[:, 0]
    # Cameras stand upright and look down; only what lies on its side has but the second.
    sense = -forward.mean(axis=0) if sideways else -(down + forward).mean(axis=0)
    return Horizon(
        up=up if up @ sense >= 0 else -up,
        form=form,
        degrees=math.degrees(1.0 / math.sqrt(max(values[1] - values[0], 1e-3))),
        roll=math.degrees(roll),
        sideways=sideways,
    )


def gram(vectors: Values, weights: Values) -> Values:
    """Return the weighted sum of v v' over (N, 3) vectors; the same for any number of threads."""
    return np.einsum("n,ni,nj->ij", weights, vectors, vectors)


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
