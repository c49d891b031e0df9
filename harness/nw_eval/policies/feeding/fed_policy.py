"""Policies that networks feed: each asked at its own rate, what it gave last held in between."""

from __future__ import annotations

import numpy as np

from nw_eval.arrays import pack
from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.cards.networks import feeding_order
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.feeding.feeder import Array, Feeder
from nw_eval.policies.memory import unfitting, unpacked
from nw_eval.policies.policy import Observation, Policy


class FedPolicy:
    """A policy whose inputs are observations, and what networks make of them.

    With the actions 0, n, 2n, ... of a trial a network is asked that runs at an n-th of the
    policy's rate. At one action, each is asked after those that feed it.
    """

    def __init__(self, bundle: Bundle, policy: Policy, *, allow_code: bool) -> None:
        """Open the networks of a bundle.

        Args:
            bundle: of a card with networks.
            policy: its checkpoint.
            allow_code: as for `open_policy`.

        Raises:
            PolicyError: as `open_network`.
        """
        self._name = bundle.name
        self.policy = policy
        self.feeders = tuple(
            Feeder(bundle, name, allow_code=allow_code) for name in feeding_order(bundle.card)
        )
        self._actions = 0
        self.held: dict[str, Array] = {}
        """By name, what the networks gave last."""

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take; empty where its format does not say."""
        return self.policy.inputs

    @property
    def network_inputs(self) -> dict[str, tuple[InputSpec, ...]]:
        """What the file of each network declares to take."""
        return {feeder.name: feeder.network.inputs for feeder in self.feeders}

    def reset(self, seed: int) -> None:
        """Begin a trial: nothing was given yet."""
        for feeder in self.feeders:
            feeder.network.reset(seed)
        self.policy.reset(seed)
        self._actions = 0
        self.held = {}

    def act(self, observation: Observation) -> Action:
        """Ask the networks whose time has come, then the policy.

        Raises:
            ActionError: a network gave inf or NaN, or as the policy.
            TrialError: a network, or the policy, failed otherwise.
        """
        inputs = dict(observation)
        for feeder in self.feeders:
            if self._actions % feeder.every == 0:
                self.held |= feeder.run(inputs)
            inputs |= {name: self.held[name] for name in feeder.outputs}
        self._actions += 1
        return self.policy.act(inputs)

    def state(self) -> bytes:
        """Return what all of them remember, what is held, and how many actions there were."""
        states = {f"network {feeder.name}": feeder.network.state() for feeder in self.feeders}
        states["policy"] = self.policy.state()
        arrays = {name: np.frombuffer(state, np.uint8) for name, state in states.items()}
        arrays |= {f"held {name}": array for name, array in self.held.items()}
        return pack(arrays | {"actions": np.array(self._actions)})

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            for feeder in self.feeders:
                feeder.network.restore(arrays.pop(f"network {feeder.name}").tobytes())
            self.policy.restore(arrays.pop("policy").tobytes())
            self._actions = int(arrays.pop("actions"))
            self.held = {name.removeprefix("held "): array for name, array in arrays.items()}
        known = {name for feeder in self.feeders for name in feeder.outputs}
        if self.held.keys() != (known if self._actions else set()):
            raise unfitting(self._name, f"it holds {', '.join(self.held) or 'nothing'}")

    def close(self) -> None:
        """Close all of them."""
        for feeder in self.feeders:
            feeder.network.close()
        self.policy.close()
