"""A policy that sees a trial and does not act in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from nw_eval.cards.inputs import InputSpec
    from nw_eval.policies import Policy
    from nw_eval.policies.policy import Observation

Array = NDArray[np.float64]


class Onlooker:
    """Stands in a trial for a policy that looks on. A `Policy`.

    It is asked at every step at which the policy would be, so whatever that remembers is of this
    trial; but what it answers is what is executed, and becomes its own past.

    Args:
        policy: already reset.
    """

    def __init__(self, policy: Policy) -> None:
        self.executed: Array | None = None
        """(12,) the action of this step, in the policy's words; None = there are none for it."""
        self._policy = policy

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take."""
        return self._policy.inputs

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._policy.reset(seed)

    def act(self, observation: Observation) -> Array:
        """Let the policy see an observation, and return what is executed; else its own answer."""
        answer = self._policy.act(observation)
        return answer if self.executed is None else self.executed

    def state(self) -> bytes:
        """Return what the policy remembers."""
        return self._policy.state()

    def restore(self, state: bytes) -> None:
        """Let the policy go back to a `state`."""
        self._policy.restore(state)

    def close(self) -> None:
        """Close the policy."""
        self._policy.close()
