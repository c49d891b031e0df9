"""One step of Adam (Kingma and Ba 2015, algorithm 1) over rows of float32."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nw_eval.machine_code.jit import inlined
from nw_eval.twin.gaussians.kernels.jit import kernel

BETA1, BETA2 = 0.9, 0.999


@inlined
def _move(
    values: Any, gradient: Any, mean: Any, square: Any, i: Any, k: Any, rate: Any, numbers: Any
) -> None:
    root, epsilon = numbers
    g = gradient[i, k]
    m = np.float32(BETA1) * mean[i, k] + np.float32(1.0 - BETA1) * g
    v = np.float32(BETA2) * square[i, k] + np.float32(1.0 - BETA2) * g * g
    mean[i, k], square[i, k] = m, v
    values[i, k] -= rate * m / (np.sqrt(v) * root + epsilon)


@kernel
def adam(
    arrays: Any,
    lead: Any,
    rates: Any,
    epsilon: Any,
    step: Any,
    first: Any,
    end: Any,
) -> None:
    """Move rows first..end-1.

    Args:
        arrays: values, gradient, first and second moments, each (N, W) float32; all but the
            gradient are changed.
        lead: columns that move at the first rate; the others move at the second.
        rates: (rate, rate).
        epsilon: added to the root of the second moment.
        step: steps taken, this one included.
        first: first row.
        end: behind the last one.
    """
    values, gradient, mean, square = arrays
    share = 1.0 - BETA1**step
    lead_rate, rest_rate = np.float32(rates[0] / share), np.float32(rates[1] / share)
    numbers = (np.float32(1.0 / math.sqrt(1.0 - BETA2**step)), np.float32(epsilon))
    for i in range(first, end):
        for k in range(lead):
            _move(values, gradient, mean, square, i, k, lead_rate, numbers)
        for k in range(lead, values.shape[1]):
            _move(values, gradient, mean, square, i, k, rest_rate, numbers)
