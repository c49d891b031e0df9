"""torch.export files (`.pt2`), run operator by operator on one thread.

Buffers that the graph writes to are its recurrent state: they are reset with the trial and saved
with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nw_eval.errors import PolicyError, nearest
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.networks.exported import ExportedGraph
from nw_eval.policies.networks.policy import NetworkPolicy
from nw_eval.policies.options import NoOptions, read_options
from nw_eval.policies.policy import InputSpec


class TorchExportPolicy(NetworkPolicy):
    """A graph whose inputs are named as the arguments of the module's `forward`."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        read_options(bundle, NoOptions)
        where = str(bundle.checkpoint)
        torch.set_num_threads(1)
        self._graph = ExportedGraph(bundle.read_checkpoint(), where)
        self._output = self._action_output(bundle, joints)
        inputs = tuple(
            InputSpec(
                name=spec.name,
                shape=spec.shape,
                dtype=torch.empty(0, dtype=spec.dtype).numpy().dtype,
            )
            for spec in self._graph.inputs
        )
        super().__init__(bundle, inputs, joints=joints)

    def infer(self, given: dict[str, Tensor]) -> Tensor:
        """Run the graph once."""
        outputs = self._graph.run([given[spec.name] for spec in self._graph.inputs])
        return outputs[self._output]

    def forget(self) -> None:
        """Begin with the state that the file was saved with."""
        self._graph.reset()

    def memory(self) -> dict[str, NDArray[Any]]:
        """Return the buffers that the graph writes to."""
        return {name: tensor.numpy() for name, tensor in self._graph.state().items()}

    def remember(self, memory: dict[str, NDArray[Any]]) -> None:
        """Go back to a `memory`."""
        self._graph.restore({name: torch.from_numpy(array) for name, array in memory.items()})

    def _action_output(self, bundle: Bundle, joints: int) -> int:
        """Return which output is the action."""
        names, wanted = self._graph.outputs, bundle.card.output
        if wanted is not None and wanted not in names:
            raise PolicyError(
                f"{bundle.card_path}: the checkpoint has no output {wanted!r}",
                fix=nearest(wanted, names),
            )
        index = names.index(wanted) if wanted is not None else 0
        shape = self._graph.output_shapes[index]
        if int(np.prod(shape)) != joints:
            raise PolicyError(
                f"{bundle.card_path}: output {names[index]!r} of the checkpoint has shape {shape}, "
                f"the robot {bundle.card.robot!r} has {joints} joints",
                fix="name the action with `output`, or the right robot with `robot`",
            )
        return index
