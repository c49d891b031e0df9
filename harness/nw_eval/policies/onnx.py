"""ONNX checkpoints, run by onnxruntime on one thread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.networks import InputSpec
from nw_eval.clean import clean
from nw_eval.errors import PolicyError, TrialError, nearest
from nw_eval.memory import Arrays, pack
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.networks.onnx_graph import open_session, state_pairs
from nw_eval.policies.policy import (
    ActingNetwork,
    InputAssembler,
    Observation,
    Wanted,
    place_of,
    unfitting,
    unpacked,
)
from nw_eval.policies.safety import check_onnx

if TYPE_CHECKING:
    import onnxruntime as ort

_DTYPES: dict[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}


class OnnxNetwork:
    """An ONNX graph, with the recurrent state that it passes from step to step.

    The graph is loaded from bytes that were verified, without external data files and without
    custom operators, so it can do arithmetic and nothing else. Inputs that an output feeds (`h_in`
    and `h_out`, or what the card's `recurrent` says) begin a trial as zeros.
    """

    def __init__(self, bundle: Bundle, wanted: Wanted) -> None:
        """Open the graph of a card, or of one of its networks.

        Raises:
            PolicyError: it cannot be used, or has other inputs and outputs than the card says.
        """
        self._name = bundle.name
        self._subject = bundle.subject
        file = bundle.checkpoint_sha256, str(bundle.checkpoint), bundle.read_checkpoint()
        graph = _GraphFile(*file)
        session = _open(graph)
        self._session: ort.InferenceSession | None = session
        specs = tuple(_spec(bundle, node) for node in session.get_inputs())
        outputs = session.get_outputs()
        self._fed_by = _recurrent(bundle, specs, outputs)
        self._recurrent = tuple(spec for spec in specs if spec.name in self._fed_by)
        self.is_function = not self._recurrent and not _draws(graph)
        """Whether equal inputs give equal outputs, whatever came before."""
        self._memory: Arrays = {}
        self.inputs = tuple(spec for spec in specs if spec.name not in self._fed_by)
        try:
            self._assemble = InputAssembler(bundle.card, self.inputs)
        except PolicyError as error:
            raise PolicyError(f"{bundle.where}: {clean(error)}") from None
        feeding = [self._fed_by[spec.name] for spec in self._recurrent]
        free = [node for node in outputs if node.name not in feeding]
        names = [str(node.name) for node in free]
        if not names:
            raise PolicyError(
                f"{bundle.where}: every output of the checkpoint feeds an input, none is an action",
                fix="say on the card which ones do: `recurrent: {input: output}`",
            )
        places = [place_of(one, names, bundle) for one in wanted]
        self.wanted = tuple((names[place], tuple(free[place].shape)) for place in places)
        self._outputs = [*dict.fromkeys([*(name for name, _ in self.wanted), *feeding])]
        self.reset(0)

    @property
    def remembers(self) -> bool:
        """Whether inputs of the graph are fed by its own outputs."""
        return bool(self._recurrent)

    def reset(self, seed: int) -> None:  # noqa: ARG002 - nothing here is random.
        """Begin a trial: the recurrent state is zeros."""
        self._memory = {
            spec.name: np.zeros([1 if size is None else size for size in spec.shape], spec.dtype)
            for spec in self._recurrent
        }

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Run the graph once."""
        if self._session is None:
            raise TrialError(f"{self._subject} is closed", fix="open it again")
        feeds = self._assemble(observation)
        feeds.update(self._memory)
        try:
            values = self._session.run(self._outputs, feeds)
        except Exception as error:
            raise TrialError(f"{self._subject} failed: {clean(error, at_most=200)}") from error
        results = {
            name: np.asarray(value) for name, value in zip(self._outputs, values, strict=True)
        }
        for spec in self._recurrent:
            self._memory[spec.name] = results[self._fed_by[spec.name]]
        return tuple(results[name] for name, _ in self.wanted)

    def state(self) -> bytes:
        """Return the recurrent state."""
        return pack(self._memory)

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            found = {name: (array.shape, array.dtype) for name, array in arrays.items()}
            if found != {name: (array.shape, array.dtype) for name, array in self._memory.items()}:
                raise unfitting(self._name, f"it has {found}")
            self._memory = arrays

    def close(self) -> None:
        """Free the graph."""
        self._session = None


class OnnxPolicy(ActingNetwork):
    """An ONNX graph, one of whose outputs is the action."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        network = OnnxNetwork(bundle, [bundle.card.output])
        ((name, shape),) = network.wanted
        size = shape[-1] if shape else None
        if isinstance(size, int) and size != joints:
            raise PolicyError(
                f"{bundle.where}: output {clean(name, at_most=100)!r} of the checkpoint has "
                f"{size} numbers, the robot {bundle.card.robot!r} has {joints} joints",
                fix="name the action with `output`, or the right robot with `robot`",
            )
        super().__init__(network, joints=joints, policy=bundle.name)


def _recurrent(bundle: Bundle, specs: Sequence[InputSpec], outputs: Any) -> dict[str, str]:
    """Return the inputs that an output feeds: those that the card says, or the names show.

    Raises:
        PolicyError: the card names an input or output that the file has not.
    """
    inputs = {spec.name: spec.shape for spec in specs}
    targets = {
        node.name: tuple(s if isinstance(s, int) else None for s in node.shape) for node in outputs
    }
    named = bundle.card.recurrent
    if named is None:
        observed = {name for name, _ in bundle.card.input_parts()}
        pairs = state_pairs(inputs, targets)
        return {source: target for source, target in pairs.items() if source not in observed}
    pairs = {source: str(target) for source, target in named.items()}
    for source, target in pairs.items():
        for kind, name, known in (("input", source, inputs), ("output", target, targets)):
            if name not in known:
                raise PolicyError(
                    f"{bundle.where}: recurrent: the checkpoint has no {kind} {name!r}",
                    fix=clean(nearest(name, known)),
                )
        if len(inputs[source]) != len(targets[target]):
            raise PolicyError(
                f"{bundle.where}: recurrent: input {source!r} has shape {inputs[source]}, "
                f"output {target!r} {targets[target]}",
                fix="name the output that is the input's next value",
            )
    return pairs


_DRAWING = (b"Random", b"Bernoulli", b"Multinomial", b"Dropout")
"""What the names of operators begin with that draw numbers: their sessions remember how many."""


@dataclass(frozen=True)
class _GraphFile:
    """A graph that was verified; equal to another one of the same bytes."""

    sha256: str
    where: str
    data: bytes = field(compare=False, repr=False)


@lru_cache(maxsize=8)
def _draws(graph: _GraphFile) -> bool:
    return any(name in graph.data for name in _DRAWING)


def _open(graph: _GraphFile) -> ort.InferenceSession:
    return _session.__wrapped__(graph) if _draws(graph) else _session(graph)


# All trials of a process open the same files, and what computes without drawing remembers nothing.
@lru_cache(maxsize=4)
def _session(graph: _GraphFile) -> ort.InferenceSession:
    check_onnx(graph.data, graph.where)
    try:
        return open_session(graph.data)
    except Exception as error:  # noqa: BLE001 - onnxruntime's exceptions share no public base.
        raise PolicyError(
            f"{graph.where}: not a usable ONNX file: {clean(error, at_most=200)}",
            fix="export it again as one file with standard operators",
        ) from None


def _spec(bundle: Bundle, node: Any) -> InputSpec:
    if node.type not in _DTYPES:
        raise PolicyError(
            f"{bundle.checkpoint}: input {clean(node.name, at_most=100)!r} is a {node.type}",
            fix=f"export it as one of {', '.join(_DTYPES)}",
        )
    shape = tuple(size if isinstance(size, int) else None for size in node.shape)
    return InputSpec(name=node.name, shape=shape, dtype=np.dtype(_DTYPES[node.type]))
