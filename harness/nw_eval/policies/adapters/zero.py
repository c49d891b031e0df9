"""The policy that does nothing: what a score of 0 looks like."""

from __future__ import annotations

import numpy as np

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.policies.adapters.stateless import StatelessPolicy
from nw_eval.policies.policy import Observation


class ZeroPolicy(StatelessPolicy):
    """Answers every observation with zeros: the robot holds its default pose."""

    inputs: tuple[InputSpec, ...] = ()

    def __init__(self, *, joints: int) -> None:
        self._joints = joints

    def act(self, observation: Observation) -> Action:  # noqa: ARG002 - that is the point.
        """Return zeros."""
        return np.zeros(self._joints)

    def close(self) -> None:
        """Do nothing, as always."""
