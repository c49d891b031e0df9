"""What aligning a capture comes to, and what each cue says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.scene import Vector

MOST_DEGREES = 2.0
"""A cue for gravity that is further off, and by more than twice what it is unsure, is warned of."""

MOST_DIFFERENCE = 0.03
"""A cue for scale that differs by more is warned of."""


@dataclass(frozen=True, kw_only=True)
class GravityCue:
    """One answer to which way is up.

    Attributes:
        name: `horizon`, `floor`, `walls`, `mesh`, `poses` or `positions`.
        up: unit vector in the capture's frame.
        degrees: between it and the chosen direction.
        uncertain: standard deviation of what it says, degrees.
        reason: what it is and how sure, for people.
    """

    name: str
    up: Vector
    degrees: float
    uncertain: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class ScaleCue:
    """One answer to how long a unit of the capture is.

    Attributes:
        name: `tag`, `camera height`, `height`, `poses`, `positions` or `length`.
        scale: metres in a unit.
        difference: relative to the chosen scale; 0.01 is one percent more.
        used: whether it is the chosen one.
        reason: what it is and how sure, for people.
    """

    name: str
    scale: float
    difference: float
    used: bool
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Alignment:
    """The similarity from a capture's frame to metres: z up, the floor at z = 0.

    The origin lies on the floor below the first shot; x leads to the shot farthest from it.

    Attributes:
        T_metric_capture: (4, 4) float64, a scale times a rotation, and a translation.
        scale: metres in a unit of the capture.
        gravity: each cue's answer.
        scales: each cue's answer, the chosen one first.
        floor_share: of the sparse points, which lies on the floor.
        warnings: what somebody should look at.
    """

    T_metric_capture: NDArray[np.float64]
    scale: float
    gravity: tuple[GravityCue, ...]
    scales: tuple[ScaleCue, ...]
    floor_share: float
    warnings: tuple[str, ...]
