"""The noise with which MCMC training explores."""

from __future__ import annotations

import math
from typing import Any

from nw_eval.twin.gaussians.kernels.ellipsoid import rotation
from nw_eval.twin.gaussians.kernels.jit import kernel

STEEPNESS, FAINT = 100.0, 0.005
"""Of the curve that lets only faint Gaussians wander: 1 / (1 + exp(100 (opacity - 0.005)))."""


@kernel
def perturb(means: Any, log_scales: Any, quats: Any, logits: Any, noise: Any, scale: Any) -> None:
    """Move each mean by its covariance times noise, the less the more opaque it is.

    What Kheradmand et al. 2024 add to each step: scale * curve(opacity) * Sigma * noise.

    Args:
        means: (N, 3) float32, moved.
        log_scales: (N, 3) float32.
        quats: (N, 4) float32.
        logits: (N,) float32.
        noise: (N, 3) float32, standard normal.
        scale: learning rate of the means times that of the noise.
    """
    for i in range(len(means)):
        opacity = 1.0 / (1.0 + math.exp(-float(logits[i])))
        share = scale / (1.0 + math.exp(min(STEEPNESS * (opacity - FAINT), 700.0)))
        r = rotation(quats[i])
        n0, n1, n2 = float(noise[i, 0]), float(noise[i, 1]), float(noise[i, 2])
        for axis in range(3):
            along = r[axis] * n0 + r[3 + axis] * n1 + r[6 + axis] * n2
            along *= share * math.exp(2.0 * float(log_scales[i, axis]))
            for k in range(3):
                means[i, k] += r[3 * k + axis] * along
