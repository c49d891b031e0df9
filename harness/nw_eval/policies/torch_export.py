"""torch.export files (`.pt2`), run operator by operator on one thread.

Buffers that the graph writes to are its recurrent state: they are reset with the trial and saved
with it.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from nw_eval.arrays import pack
from nw_eval.cards.inputs import InputSpec
from nw_eval.errors import PolicyError
from nw_eval.policies.apart import check_program
from nw_eval.policies.bundle import Bundle, NoOptions, read_options
from nw_eval.policies.network import ActingNetwork, Wanted, place_of
from nw_eval.policies.networks.exported import ExportedGraph
from nw_eval.policies.policy import unpacked
from nw_eval.policies.torch_network import TorchNetwork


class TorchExportNetwork(TorchNetwork):
    """A graph whose inputs are named as the arguments of the module's `forward`."""

    def __init__(self, bundle: Bundle, wanted: Wanted, *, allow_code: bool) -> None:
        """Open the graph of a card, or of one of its networks.

        Raises:
            PolicyError: it cannot be used, or has other inputs and outputs than the card says.
        """
        check_program(bundle, allow_code=allow_code)
        read_options(bundle, NoOptions)
        where = str(bundle.checkpoint)
        torch.set_num_threads(1)
        self._graph = ExportedGraph(bundle.read_checkpoint(), where)
        self._places = [place_of(one, self._graph.outputs, bundle) for one in wanted]
        names, shapes = self._graph.outputs, self._graph.output_shapes
        self.wanted = tuple((names[place], shapes[place]) for place in self._places)
        inputs = tuple(
            InputSpec(
                name=spec.name,
                shape=spec.shape,
                dtype=torch.empty(0, dtype=spec.dtype).numpy().dtype,
            )
            for spec in self._graph.inputs
        )
        super().__init__(bundle, inputs)

    def outputs(self, inputs: dict[str, Tensor]) -> list[Tensor]:
        """Run the graph once."""
        outputs = self._graph.run([inputs[spec.name] for spec in self._graph.inputs])
        return [outputs[place] for place in self._places]

    def forget(self) -> None:
        """Begin with the state that the file was saved with."""
        self._graph.reset()

    def state(self) -> bytes:
        """Return the buffers that the graph writes to."""
        return pack({name: tensor.numpy() for name, tensor in self._graph.state().items()})

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            self._graph.restore({name: torch.from_numpy(array) for name, array in arrays.items()})


class TorchExportPolicy(ActingNetwork):
    """A graph, one of whose outputs is the action."""

    def __init__(self, bundle: Bundle, *, joints: int, allow_code: bool) -> None:
        network = TorchExportNetwork(bundle, [bundle.card.output], allow_code=allow_code)
        ((name, shape),) = network.wanted
        if int(np.prod(shape)) != joints:
            raise PolicyError(
                f"{bundle.where}: output {name!r} of the checkpoint has shape {shape}, "
                f"the robot {bundle.card.robot!r} has {joints} joints",
                fix="name the action with `output`, or the right robot with `robot`",
            )
        super().__init__(network, joints=joints, policy=bundle.name)
