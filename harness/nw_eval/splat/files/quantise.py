"""What lossy formats share: opacities as bytes and bytes as opacities."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEAST = 1e-4


def logit(opacity: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    """Return log(p / (1 - p)), p kept 1e-4 away from 0 and 1 so that bytes 0 and 255 are finite."""
    p = np.clip(opacity.astype(np.float64), _LEAST, 1.0 - _LEAST)
    return np.log(p / (1.0 - p)).astype(np.float32)


def sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return 1 / (1 + exp(-x)) without overflow warnings."""
    with np.errstate(over="ignore"):
        return 1.0 / (1.0 + np.exp(-logits.astype(np.float64)))


def to_byte(values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Round to the nearest of 0..255; what is not a number becomes 0."""
    return np.clip(np.rint(np.nan_to_num(values)), 0, 255).astype(np.uint8)


def unit_quats(quats: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n, 4) float64 of length 1; what has no length becomes the identity."""
    q = np.nan_to_num(quats.astype(np.float64))
    length = np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(length > 0, q / np.maximum(length, 1e-30), [1.0, 0.0, 0.0, 0.0])
