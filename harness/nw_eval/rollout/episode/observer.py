"""What an episode shows to those who look on: recorders, probes, whatever comes next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.sensors.sensor import Moment
from nw_eval.words import Outcome

Array = NDArray[np.float64]


class Decision(NamedTuple):
    """What the policy saw and answered at one control step, and what is applied in it."""

    observation: Mapping[str, NDArray[Any]]
    action: Array  # (12,) raw output
    applied: Array  # (12,) raw action that this step applies
    targets: Array  # (12,) joint targets of this step, rad; or torques, N m
    moment: Moment | None = None  # what was observed; None where nothing was


class Step(NamedTuple):
    """One control step that was made."""

    decision: Decision
    outcome: Outcome | None  # how the trial ends with it; None if it goes on
    credited: bool  # whether a waypoint was credited in it


class Observer:
    """Looks on as an episode runs, at three places of each control step, and changes nothing.

    Its own methods look away: a subclass has those that it wants.
    """

    def before(self) -> None:
        """A control step begins: the episode can be saved."""

    def decided(self, decision: Decision) -> None:
        """The policy has decided, and nothing has moved yet."""

    def advanced(self, step: Step) -> None:
        """The world has moved, and the trail and the judge have seen it."""
