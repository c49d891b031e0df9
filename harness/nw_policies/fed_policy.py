"""Policies that networks feed: each runs at its own rate, and its last output is held between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, assert_never, cast

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import NotFiniteError, TrialError
from nw_base.memory import pack
from nw_base.plural import plural
from nw_policies.bundle import Bundle
from nw_policies.cards.feeding import InputSpec, feeding_order
from nw_policies.cards.joint_control import Action
from nw_policies.cards.networks import NetworkAdapter, NetworkOutput, input_parts
from nw_policies.cards.observations import selected_indices
from nw_policies.planned import PlannedNetwork
from nw_policies.policy import (
    ActingNetwork,
    Observation,
    OpenNetwork,
    Policy,
    Wanted,
    unfitting,
    unpacked,
)

if TYPE_CHECKING:
    from nw_policies.one_plan import OnePlan
    from nw_policies.onnx import OnnxNetwork

Array = NDArray[Any]


class FedPolicy:
    """A policy that takes observations and outputs of other networks.

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
            PolicyError: as `_open_network`.
        """
        self._name = bundle.name
        self.policy = policy
        self.feeders = tuple(
            Feeder(bundle, name, allow_code=allow_code) for name in feeding_order(bundle.card)
        )
        self._actions = 0
        self._held: dict[str, Array] = {}
        self._plan: OnePlan | None = None
        self._has_tried = False

    @property
    def held(self) -> dict[str, Array]:
        """By name, what the networks gave last."""
        if self._plan is None or not self._actions:
            return self._held
        given = self._plan.given()
        return {
            name: _picked(name, output, given[name])
            for feeder in self.feeders
            for name, output in feeder.outputs.items()
        }

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
        self._held = {}

    def act(self, observation: Observation) -> Action:
        """Run the networks that are due, then the policy.

        Raises:
            ActionError: a network gave inf or NaN, or as the policy.
            TrialError: a network, or the policy, failed otherwise.
        """
        if not self._has_tried:
            self._has_tried, self._plan = True, self._planned(observation)
        if self._plan is not None:
            raw = self._plan.run(observation, self._actions)
            if raw is not None:
                self._actions += 1
                return cast("ActingNetwork", self.policy).action(raw)
            self._held, self._plan = self.held, None
        inputs = dict(observation)
        for feeder in self.feeders:
            if self._actions % feeder.every == 0:
                self._held |= feeder.run(inputs)
            inputs |= {name: self._held[name] for name in feeder.outputs}
        self._actions += 1
        return self.policy.act(inputs)

    def _planned(self, observation: Observation) -> OnePlan | None:
        """Return all networks as one plan, where nw-eval runs ONNX graphs whose outputs are whole.

        Others run one by one, and their numbers pass from one to the next as arrays.
        """
        own = getattr(self.policy, "network", None)
        networks = [*(feeder.network for feeder in self.feeders), own]
        are_planned = all(getattr(network, "program", None) is not None for network in networks)
        if not are_planned or not all(feeder.gives_whole for feeder in self.feeders):
            return None
        from nw_policies.one_plan import OnePlan  # It knows numba.

        try:
            plan = OnePlan(self.feeders, cast("OnnxNetwork", own), observation)
        except ValueError:
            return None
        if self._held:
            plan.restore(self._held)
        return plan

    def state(self) -> bytes:
        """Return the memory of all networks, the held outputs, and the count of actions."""
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
            self._held = {name.removeprefix("held "): array for name, array in arrays.items()}
        known = {name for feeder in self.feeders for name in feeder.outputs}
        if self._held.keys() != (known if self._actions else set()):
            raise unfitting(self._name, f"it holds {', '.join(self._held) or 'nothing'}")
        if self._plan is not None and self._held:
            self._plan.restore(self._held)

    def close(self) -> None:
        """Close all of them."""
        self._plan, self._has_tried = None, True
        for feeder in self.feeders:
            feeder.network.close()
        self.policy.close()


def _open_network(
    adapter: NetworkAdapter, bundle: Bundle, wanted: Wanted, *, allow_code: bool
) -> OpenNetwork:
    """Open one file of a bundle for some of its outputs.

    Args:
        adapter: name of the runtime of the file.
        bundle: from `Bundle.of_network`.
        wanted: which outputs `run` is to return, in this order.
        allow_code: as for `open_policy`.

    Raises:
        PolicyError: the file is not what its adapter reads, or has other inputs and outputs than
            the card says.
    """
    if adapter != "onnx" and bundle.card.is_planned:
        return PlannedNetwork(bundle, wanted)
    match adapter:
        case "onnx":
            from nw_policies.onnx import OnnxNetwork

            return OnnxNetwork(bundle, wanted)
        case "torchscript":
            from nw_policies.torchscript import TorchScriptNetwork

            return TorchScriptNetwork(bundle, wanted, allow_code=allow_code)
        case "torch-export":
            from nw_policies.torch_network import TorchExportNetwork

            return TorchExportNetwork(bundle, wanted, allow_code=allow_code)
        case _:
            assert_never(adapter)


class Feeder:
    """One network in a trial, with the names under which others take its outputs."""

    def __init__(self, bundle: Bundle, name: str, *, allow_code: bool) -> None:
        network = bundle.card.networks[name]
        self.name = name
        self.bundle = bundle.of_network(name)
        self.outputs = network.given_as(name)
        self.every = 1 if network.rate is None else round(bundle.card.control.rate / network.rate)
        """Actions from one time that it is asked to the next."""
        wanted = [output.output for output in self.outputs.values()]
        self.network = _open_network(network.adapter, self.bundle, wanted, allow_code=allow_code)
        self._taken = [part for _, parts in input_parts(network.inputs) for part in parts]
        self.is_function: bool = getattr(self.network, "is_function", False)
        self._given: list[Array] = []
        self._gave: dict[str, Array] = {}

    def run(self, observation: Observation) -> dict[str, Array]:
        """Ask it; return what it gives by name, which must not be changed.

        An encoder of images need not run again before there is a new one: a network that gives
        equal outputs for equal inputs gives what it gave, as long as it is given the same.

        Raises:
            NotFiniteError: an output is not finite.
            TrialError: it failed, or `select` or `scale` does not fit an output.
        """
        given = [observation[name] for name in self._taken] if self.is_function else []
        if self._gave and given and all(map(np.array_equal, self._given, given)):
            return self._gave
        outputs = self.named(self.network.run(observation))
        self.check(outputs)
        self._given, self._gave = [array.copy() for array in given], outputs
        return outputs

    def named(self, raw: tuple[Array, ...]) -> dict[str, Array]:
        """Return outputs of the file by the names under which others take them."""
        return {
            name: _picked(name, output, array)
            for (name, output), array in zip(self.outputs.items(), raw, strict=True)
        }

    @property
    def gives_whole(self) -> bool:
        """Whether the card takes its outputs as they are."""
        return all(one.select is None and one.scale == 1.0 for one in self.outputs.values())

    def check(self, outputs: Mapping[str, Array]) -> None:
        """Check outputs, by the names under which others take them.

        Raises:
            NotFiniteError: one is not finite.
        """
        for name, array in outputs.items():
            if np.isfinite(array).all():
                continue
            index = int(np.argmin(np.isfinite(array)))
            raise NotFiniteError(
                f"{self.bundle.subject} gave {array.flat[index]} for number {index} of `{name}`",
                fix="check its file, and the observations' scales on the card",
            )


def _picked(name: str, output: NetworkOutput, array: Array) -> Array:
    """Return a copy of what the card wants of an output, without a batch axis."""
    if array.size == max(array.shape, default=1):
        array = array.reshape(-1)
    elif array.shape[0] == 1:
        array = array[0]
    if output.select is not None:
        try:
            array = array.reshape(-1)[selected_indices(output.select, array.size, of="output")]
        except ValueError as error:
            raise TrialError(f"`{name}`: {error}") from None
    if output.scale == 1.0:
        return array.copy()
    scale = np.asarray(output.scale, array.dtype if array.dtype.kind == "f" else np.float32)
    if scale.ndim and scale.shape != array.shape:
        shape = " x ".join(str(side) for side in array.shape)
        raise TrialError(
            f"`{name}`: `scale` has {plural(scale.size, 'number')}, the output {shape}"
        )
    return array * scale
