"""ONNX checkpoints, run by nw-eval or, as a card's `runtime` says, by onnxruntime on one thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import PolicyError, TrialError, nearest
from nw_base.memory import Arrays, pack
from nw_policies.bundle import Bundle, PlannedFile
from nw_policies.cards.feeding import InputSpec
from nw_policies.executor import RecordedFile, UnsupportedError
from nw_policies.networks.onnx_graph import open_session, state_pairs
from nw_policies.planned import unsupported
from nw_policies.policy import (
    ActingNetwork,
    InputAssembler,
    Observation,
    Wanted,
    place_of,
    unfitting,
    unpacked,
)
from nw_policies.safety import check_onnx

if TYPE_CHECKING:
    import onnxruntime as ort

    from nw_policies.executor import Graph, Program

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
    custom operators, so it can do arithmetic and nothing else; or it was planned into a program,
    which is data. Inputs that an output feeds (`h_in`
    and `h_out`, or what the card's `recurrent` says) begin a trial as zeros.
    """

    def __init__(self, bundle: Bundle, wanted: Wanted) -> None:
        """Open the graph of a card, or of one of its networks.

        Raises:
            PolicyError: it cannot be used, or has other inputs and outputs than the card says.
        """
        self._name = bundle.name
        self._subject = bundle.subject
        self._bundle = bundle
        self.where = bundle.where
        runner = _Planned(bundle) if bundle.card.is_planned else _Native(bundle)
        self._runner: _Native | _Planned | None = runner
        specs, outputs = runner.inputs, runner.outputs
        self.fed = _recurrent(bundle, specs, outputs)
        self._recurrent = tuple(spec for spec in specs if spec.name in self.fed)
        self.is_function = not self._recurrent and not runner.draws
        """Whether equal inputs give equal outputs, whatever came before."""
        self._memory: Arrays = {}
        self._is_lent = False
        self.inputs = tuple(spec for spec in specs if spec.name not in self.fed)
        try:
            self._assemble = InputAssembler(bundle.card, self.inputs)
        except PolicyError as error:
            raise PolicyError(f"{bundle.where}: {clean(error)}") from None
        feeding = [self.fed[spec.name] for spec in self._recurrent]
        names = [name for name in outputs if name not in feeding]
        if not names:
            raise PolicyError(
                f"{bundle.where}: every output of the checkpoint feeds an input, none is an action",
                fix="say on the card which ones do: `recurrent: {input: output}`",
            )
        places = [place_of(one, names, bundle) for one in wanted]
        self.wanted = tuple((names[place], outputs[names[place]]) for place in places)
        self._outputs = [*dict.fromkeys([*(name for name, _ in self.wanted), *feeding])]
        self.reset(0)

    @property
    def remembers(self) -> bool:
        """Whether inputs of the graph are fed by its own outputs."""
        return bool(self._recurrent)

    def reset(self, seed: int) -> None:  # noqa: ARG002 - nothing here is random.
        """Begin a trial: the recurrent state is zeros."""
        self._remember(
            {
                spec.name: np.zeros([size or 1 for size in spec.shape], spec.dtype)
                for spec in self._recurrent
            }
        )

    @property
    def program(self) -> Program | None:
        """Program of the graph; None where onnxruntime runs it, or after it is closed."""
        return self._runner.program if isinstance(self._runner, _Planned) else None

    @property
    def parts(self) -> tuple[tuple[InputSpec, tuple[str, ...]], ...]:
        """Its inputs, with the observations that they are made of."""
        return self._assemble.parts

    def remember_in(self, memory: Mapping[str, NDArray[Any]]) -> None:
        """Keep the recurrent state in arrays of somebody else's, who runs the graph from now on."""
        for name, array in memory.items():
            array[...] = self._memory[name]
        self._memory = dict(memory)
        self._is_lent = True

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Run the graph once."""
        if self._runner is None:
            raise TrialError(f"{self._subject} is closed", fix="open it again")
        feeds = self._assemble(observation)
        feeds.update(self._memory)
        try:
            results = self._runner.run(self._outputs, feeds)
        except Exception as error:
            raise TrialError(f"{self._subject} failed: {clean(error, at_most=200)}") from error
        self._remember({name: results[output] for name, output in self.fed.items()})
        return tuple(results[name] for name, _ in self.wanted)

    def recorded(self, observation: Observation) -> RecordedFile:  # noqa: ARG002 - it says its sizes.
        """Return its graph.

        Raises:
            UnsupportedError: it is none of arrays of numbers.
        """
        return RecordedFile(parts=((1, _read(_graph_file(self._bundle))),), first={})

    def state(self) -> bytes:
        """Return the recurrent state."""
        return pack(self._memory)

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        with unpacked(state, self._name) as arrays:
            forms = {name: (array.shape, array.dtype) for name, array in arrays.items()}
            if forms != {name: (array.shape, array.dtype) for name, array in self._memory.items()}:
                raise unfitting(self._name, f"it has {forms}")
            self._remember(arrays)

    def _remember(self, memory: Arrays) -> None:
        if not self._is_lent:
            self._memory = memory
            return
        for name, array in memory.items():
            self._memory[name][...] = array

    def close(self) -> None:
        """Free the graph."""
        self._runner = None


class _Native:
    """A graph that onnxruntime runs."""

    def __init__(self, bundle: Bundle) -> None:
        graph = _graph_file(bundle)
        self._session = _open(graph)
        self.draws = _draws(graph)
        """Whether it draws numbers."""
        self.inputs = tuple(_spec(bundle, node) for node in self._session.get_inputs())
        self.outputs = {str(n.name): tuple(n.shape) for n in self._session.get_outputs()}

    def run(self, names: list[str], feeds: Arrays) -> dict[str, NDArray[Any]]:
        values = self._session.run(names, feeds)
        return {name: np.asarray(value) for name, value in zip(names, values, strict=True)}


class _Planned:
    """A graph that nw-eval runs."""

    draws = False

    def __init__(self, bundle: Bundle) -> None:
        from nw_policies.executor.network import Network

        known = bundle.programs.get(bundle.network) or planned_file(bundle)
        ((_, program),) = known.parts
        self.program = program
        self._network = Network(program)
        self.inputs = tuple(
            InputSpec(name=name, shape=slot.shape, dtype=np.dtype(slot.dtype))
            for name, slot in program.inputs.items()
        )
        self.outputs = {name: slot.shape for name, slot in program.outputs.items()}

    def run(self, names: list[str], feeds: Arrays) -> dict[str, NDArray[Any]]:
        results = self._network(feeds)
        return {name: results[name].copy() for name in names}


def planned_file(bundle: Bundle) -> PlannedFile:
    """Return the plan of a bundle's ONNX file.

    Raises:
        PolicyError: it cannot be used, or has an operator that nw-eval does not run.
    """
    return PlannedFile(inputs=(), parts=((1, _program(_graph_file(bundle))),), first={})


class OnnxPolicy(ActingNetwork):
    """An ONNX graph with an output that is the action."""

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


def _recurrent(
    bundle: Bundle, specs: Sequence[InputSpec], outputs: Mapping[str, tuple[Any, ...]]
) -> dict[str, str]:
    """Return the inputs that an output feeds: those that the card says, or the names show.

    Raises:
        PolicyError: the card names an input or output that the file has not.
    """
    inputs = {spec.name: spec.shape for spec in specs}
    targets = {
        name: tuple(side if isinstance(side, int) else None for side in shape)
        for name, shape in outputs.items()
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


def _graph_file(bundle: Bundle) -> _GraphFile:
    return _GraphFile(bundle.checkpoint_sha256, str(bundle.checkpoint), bundle.read_checkpoint())


@lru_cache(maxsize=4)
def _program(graph: _GraphFile) -> Program:
    from nw_policies.executor.plan import plan

    try:
        return plan(_read(graph))
    except UnsupportedError as error:
        raise unsupported(graph.where, error) from None
    except ValueError as error:
        raise PolicyError(
            f"{graph.where}: not a usable ONNX file: {clean(error, at_most=200)}",
            fix="export it again as one file with standard operators",
        ) from None


def _read(graph: _GraphFile) -> Graph:
    from nw_policies.networks.onnx_reading import read_graph

    check_onnx(graph.data, graph.where)
    return read_graph(graph.data)


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
    except ModuleNotFoundError:  # It is not the file's fault.
        raise
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
