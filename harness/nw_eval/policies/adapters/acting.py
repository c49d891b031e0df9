"""Policies that are one network: one of its outputs is the action."""

from __future__ import annotations

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.policies.network import OpenNetwork
from nw_eval.policies.policy import Observation, checked_action


class ActingNetwork:
    """A network that was opened for one output, whose numbers are checked as an action."""

    def __init__(self, network: OpenNetwork, *, joints: int, policy: str) -> None:
        self._network = network
        self._joints = joints
        self._policy = policy

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take; empty where its format does not say."""
        return self._network.inputs

    @property
    def remembers(self) -> bool:
        """Whether the network has a memory, or may have one."""
        return getattr(self._network, "remembers", True)

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._network.reset(seed)

    def act(self, observation: Observation) -> Action:
        """Run the network once.

        Raises:
            ActionError: the output is no action.
            TrialError: the network failed.
        """
        (raw,) = self._network.run(observation)
        return checked_action(raw, joints=self._joints, policy=self._policy)

    def state(self) -> bytes:
        """Return the network's memory."""
        return self._network.state()

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self._network.restore(state)

    def close(self) -> None:
        """Free the network."""
        self._network.close()
