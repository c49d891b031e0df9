"""One of the networks that feed a policy, in a trial."""

from __future__ import annotations

from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.checkpoint import NetworkAdapter
from nw_eval.cards.networks import NetworkOutput
from nw_eval.cards.observations import selected_indices
from nw_eval.errors import NotFiniteError, TrialError
from nw_eval.plural import plural
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.network import OpenNetwork, Wanted
from nw_eval.policies.policy import Observation

Array = NDArray[Any]


def open_network(
    adapter: NetworkAdapter, bundle: Bundle, wanted: Wanted, *, allow_code: bool
) -> OpenNetwork:
    """Open one file of a bundle for some of its outputs.

    Args:
        adapter: what runs the file.
        bundle: from `Bundle.of_network`.
        wanted: which outputs `run` is to return, in this order.
        allow_code: as for `open_policy`.

    Raises:
        PolicyError: the file is not what its adapter reads, or has other inputs and outputs than
            the card says.
    """
    match adapter:
        case "onnx":
            from nw_eval.policies.adapters.onnx import OnnxNetwork

            return OnnxNetwork(bundle, wanted)
        case "torchscript":
            from nw_eval.policies.adapters.torchscript import TorchScriptNetwork

            return TorchScriptNetwork(bundle, wanted, allow_code=allow_code)
        case "torch-export":
            from nw_eval.policies.adapters.torch_export import TorchExportNetwork

            return TorchExportNetwork(bundle, wanted, allow_code=allow_code)
        case _:
            assert_never(adapter)


class Feeder:
    """One network in a trial, with the names under which others take what it gives."""

    def __init__(self, bundle: Bundle, name: str, *, allow_code: bool) -> None:
        network = bundle.card.networks[name]
        self.name = name
        self.bundle = bundle.of_network(name)
        self.outputs = network.given_as(name)
        self.every = 1 if network.rate is None else bundle.card.control.rate // network.rate
        """Actions from one time that it is asked to the next."""
        wanted = [output.output for output in self.outputs.values()]
        self.network = open_network(network.adapter, self.bundle, wanted, allow_code=allow_code)

    def run(self, observation: Observation) -> dict[str, Array]:
        """Ask it; return what it gives by name, each in memory of its own.

        Raises:
            NotFiniteError: an output is not finite.
            TrialError: it failed, or `select` or `scale` does not fit an output.
        """
        raw = self.network.run(observation)
        return {
            name: self._finite(name, _picked(name, output, array))
            for (name, output), array in zip(self.outputs.items(), raw, strict=True)
        }

    def _finite(self, name: str, array: Array) -> Array:
        if np.isfinite(array).all():
            return array
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
