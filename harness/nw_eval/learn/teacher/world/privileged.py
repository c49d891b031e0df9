"""What the critic may know and the policy may not: it is thrown away after the training."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.learn.teacher.config import GROUNDS
from nw_eval.learn.teacher.world.body import Bodies

PRIVILEGED = 3 + 5 + 4 + 3 + len(GROUNDS) + 1
_FOOT = 0.02  # m, radius
_MIDDLE = 5.0  # of the levels


def features(
    body: Bodies,
    *,
    clearance: NDArray[np.float64],
    contacts: NDArray[np.bool_],
    grounds: NDArray[np.intp],
    levels: NDArray[np.intp],
) -> NDArray[np.float32]:
    """Return the critic's own numbers, (n, PRIVILEGED), of about one in size.

    Args:
        body: of n robots.
        clearance: (n, 5) heights of trunk and feet above the ground, m.
        contacts: (n, 4) feet that push.
        grounds: (n,) indices into `GROUNDS`.
        levels: (n,).
    """
    above = clearance.copy()
    above[:, 1:] -= _FOOT
    above *= (2.0, 4.0, 4.0, 4.0, 4.0)
    parts = (
        2.0 * body.velocity_in_trunk,
        above,
        contacts - 0.5,
        body.gravity,
        np.eye(len(GROUNDS))[grounds],
        levels[:, None] / _MIDDLE - 1.0,
    )
    return np.concatenate(parts, axis=1).astype(np.float32)
