"""What networks that torch runs here have in common, and the policies around our own of them.

Among them are torch.export files (`.pt2`), run operator by operator on one thread. Buffers that
their graph writes to are its recurrent state: they are reset with the trial and saved with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nw_base.errors import PolicyError, TrialError
from nw_base.memory import pack
from nw_policies.bundle import Bundle, NoOptions, read_options
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.joint_control import Action
from nw_policies.executor import RecordedFile
from nw_policies.line import check_program
from nw_policies.networks.exported import ExportedGraph
from nw_policies.networks.recording import numbered, record, recorded_file
from nw_policies.policy import (
    ActingNetwork,
    InputAssembler,
    Observation,
    Wanted,
    checked_action,
    place_of,
    unfitting,
    unpacked,
)
from nw_policies.safety import read_tensors


class TorchNetwork:
    """A network that runs here, on one thread. Subclasses say how.

    `outputs` computes what it gives from the inputs; `forget`, `state` and `restore` are for those
    whose next outputs depend on more than the next inputs.
    """

    def __init__(self, bundle: Bundle, inputs: tuple[InputSpec, ...]) -> None:
        """Resolve the card's inputs against those of the network.

        Raises:
            PolicyError: the card names other inputs.
        """
        # More threads change the order of sums, and with it the last bits of an action.
        torch.set_num_threads(1)
        self.inputs = inputs
        self.where = bundle.where
        self._name = bundle.name
        self._subject = bundle.subject
        self._open = True
        try:
            self._assemble = InputAssembler(bundle.card, inputs)
        except PolicyError as error:
            raise PolicyError(f"{bundle.where}: {error}") from None
        self.forget()

    def outputs(self, inputs: dict[str, Tensor]) -> Sequence[Tensor]:
        """Return what it gives for inputs by name, each with a leading axis of 1."""
        raise NotImplementedError

    def forget(self) -> None:
        """Begin without memory."""

    def memory(self) -> dict[str, Tensor]:
        """Return what the next outputs depend on beside the inputs."""
        return {}

    def remember(self, memory: Mapping[str, Tensor]) -> None:
        """Go back to a `memory`; what does not fit it raises KeyError or RuntimeError."""

    def state(self) -> bytes:
        """Return the memory as bytes."""
        memory = self.memory()
        return pack({name: tensor.numpy() for name, tensor in memory.items()}) if memory else b""

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        if self.memory():
            with unpacked(state, self._name) as arrays:
                self.remember({name: torch.from_numpy(array) for name, array in arrays.items()})
        elif state:
            raise unfitting(self._name, f"{len(state)} bytes, and it remembers nothing")

    def tensors(self, observation: Observation) -> dict[str, Tensor]:
        """Return the inputs that observations make, by name."""
        return {name: torch.from_numpy(x) for name, x in self._assemble(observation).items()}

    def recorded(self, observation: Observation) -> RecordedFile:
        """Return what `run` computes as graphs.

        Args:
            observation: as for `run`; its sizes count.

        Raises:
            UnsupportedError: it has an operator that cannot be recorded.
        """
        self.forget()
        given, first = self.tensors(observation), self.memory()

        def run() -> dict[str, Tensor]:
            outputs = self.outputs(given)
            named = {f"output {index}": tensor for index, tensor in enumerate(outputs)}
            return named | self.memory()

        kept = {name: tensor.numpy().copy() for name, tensor in first.items()}
        try:
            graph = record(run, numbered(given.values()), first)
        finally:
            self.forget()
        return recorded_file(graph, kept)

    def reset(self, seed: int) -> None:  # noqa: ARG002 - nothing here is random.
        """Begin a trial."""
        self.forget()

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Run the network once.

        Raises:
            TrialError: it failed.
        """
        if not self._open:
            raise TrialError(f"{self._subject} is closed", fix="open it again")
        inputs = self.tensors(observation)
        try:
            with torch.inference_mode():
                outputs = self.outputs(inputs)
        except RuntimeError as error:
            reason = " ".join(str(error).split())[:200]
            raise TrialError(f"{self._subject} failed: {reason}") from error
        return tuple(output.numpy() for output in outputs)

    def close(self) -> None:
        """End; a later `run` is an error."""
        self._open = False


class NetworkPolicy(TorchNetwork):
    """A policy around such a network. Subclasses compute an action from the inputs: `infer`."""

    def __init__(self, bundle: Bundle, inputs: tuple[InputSpec, ...], *, joints: int) -> None:
        super().__init__(bundle, inputs)
        self._joints = joints

    def infer(self, inputs: dict[str, Tensor]) -> Tensor:
        """Return the raw action for inputs by name, each with a leading axis of 1."""
        raise NotImplementedError

    def outputs(self, inputs: dict[str, Tensor]) -> Sequence[Tensor]:
        """Return the raw action alone."""
        return (self.infer(inputs),)

    def act(self, observation: Observation) -> Action:
        """Run the network once.

        Raises:
            TrialError: it failed, or the action is not finite.
        """
        (raw,) = self.run(observation)
        return checked_action(raw, joints=self._joints, policy=self._name)


def input_spec(name: str, *shape: int | None) -> InputSpec:
    """Return the spec of a float32 input; a leading batch axis of 1 is added."""
    return InputSpec(name=name, shape=(1, *shape), dtype=np.dtype(np.float32))


def checkpoint_tensors(bundle: Bundle) -> dict[str, Tensor]:
    """Read the state dict that a card names.

    Raises:
        PolicyError: it cannot be read, or could run code.
    """
    return read_tensors(bundle.read_checkpoint(), str(bundle.checkpoint))


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

    def memory(self) -> dict[str, Tensor]:
        """Return the buffers that the graph writes to."""
        return self._graph.memory

    def remember(self, memory: Mapping[str, Tensor]) -> None:
        """Write them."""
        self._graph.restore(memory)

    def state(self) -> bytes:
        """Return them as bytes."""
        return pack({name: tensor.numpy() for name, tensor in self.memory().items()})

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            self.remember({name: torch.from_numpy(array) for name, array in arrays.items()})


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
