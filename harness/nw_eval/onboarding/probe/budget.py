"""How long commands and other cards are tried, so that what was found before is always told."""

from __future__ import annotations

import math
from time import monotonic

from nw_eval.cards import Card
from nw_eval.onboarding.probe.recording import Recording
from nw_eval.onboarding.probe.rig import Rig


class SpentError(Exception):
    """The budget is used up."""


class Metered:
    """A rig that records until a budget is used up.

    Args:
        rig: what records.
        simulated: seconds of simulation, which come to the same on every machine.
        deadline: on the monotonic clock. Only policies that are far slower than a robot needs
            reach it, and on another machine elsewhere.
    """

    def __init__(self, rig: Rig, *, simulated: float, deadline: float = math.inf) -> None:
        self.spent = 0.0
        self._rig = rig
        self._simulated = simulated
        self._deadline = deadline

    def record(self, card: Card, *, seconds: float, level: float = math.inf) -> Recording:
        """Run the checkpoint under a card, while it leans less than `level`.

        Raises:
            SpentError: the budget is used up.
            NwEvalError: it cannot be run.
        """
        if self.spent >= self._simulated or monotonic() >= self._deadline:
            raise SpentError
        made = self._rig.record(card, seconds=seconds, level=level)
        self.spent += made.seconds
        return made
