"""What the card of a LEAPP pipeline says of its observations, inputs and networks."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nw_base.errors import PolicyError
from nw_base.files.inside import OutsideError, bounded_bytes, checked
from nw_policies.cards.joints import short_name
from nw_policies.drafting.beside import merged
from nw_policies.drafting.checkpoint import ArrayFacts, CheckpointFacts
from nw_policies.drafting.exporters import ExportedTerm
from nw_policies.drafting.exporters import ExporterMetadata as Metadata
from nw_policies.drafting.inputs import Wanted, parts_of
from nw_policies.drafting.leapp import (
    JOINT_TERMS,
    Node,
    Pipeline,
    Tensor,
    action_of,
    joints_of,
    metadata_of,
)
from nw_policies.drafting.notation import CHECK, key, plain, quoted
from nw_policies.drafting.vectors import Likely, ObservationDraft, likely_layouts

_INITIAL_BYTES = 2**24
_IN_WORLD = re.compile(r"_w$")


def with_pipeline(
    pipeline: Pipeline, node: Node, facts: CheckpointFacts, beside: Metadata | None
) -> Metadata:
    """Return the settings of a pipeline, completed from other files beside it.

    Raises:
        PolicyError: as `metadata_of`.
    """
    own = metadata_of(pipeline, node, facts)
    if beside is None:
        return own
    if own.action:
        # Terms, scales and clips are in the graph: those of the training must not come twice.
        beside = replace(beside, observation_terms=(), observation_clip=None, action_clip=None)
    return merged(own, beside)


@dataclass(frozen=True, kw_only=True)
class _File:
    """A network file of the draft: what of the card is about it."""

    node: Node
    inputs: dict[str, list[str]]
    recurrent: tuple[str, ...]


class PipelineDraft:
    """The lines of a card that say what its networks see and give.

    Raises:
        PolicyError: an input is something that no card can make, or the pipeline feeds back in a
            way that no card has; the message names it.
    """

    def __init__(
        self, pipeline: Pipeline, node: Node, facts: CheckpointFacts, layout: str | None = None
    ) -> None:
        self._pipeline = pipeline
        self._folder = facts.path.parent.resolve()
        self._likely = Likely(names=(layout,)) if layout else likely_layouts(facts)
        self.parts: list[ObservationDraft] = []
        """Observations of which only the size is known."""
        self._where = str(facts.path)
        self._action = action_of(node, pipeline, self._where)
        self._joints = list(joints_of(self._action, pipeline))
        self._acting = node
        self._observations: dict[str, tuple[str, ...]] = {}
        self._order: list[Node] = []
        self._taken: dict[str, list[str]] = {}
        """By node, the outputs that others take."""
        self._files = [self._file(one) for one in self._feeding(node)]
        self._policy = self._file(node)
        self.notes = self._initial_values(facts)

    def _feeding(self, node: Node, way: tuple[str, ...] = ()) -> list[Node]:
        """Return the nodes that feed one, each behind those that feed it."""
        for tensor in node.inputs:
            source, output = self._pipeline.feeds.get((node.name, tensor.name), ("", ""))
            if not source:
                continue
            other = self._pipeline.nodes.get(source)
            if other is None or source in (*way, node.name):
                raise PolicyError(
                    f"{self._where}: input {tensor.said} of node {plain(node.name)!r} is fed by "
                    f"{plain(source)!r}, which {'it feeds' if other else 'is not a node'}",
                    fix="export the pipeline again",
                )
            if output not in self._taken.setdefault(source, []):
                self._taken[source].append(output)
            if other not in self._order:
                self._feeding(other, (*way, node.name))
                self._order.append(other)
        return self._order

    def _file(self, node: Node) -> _File:
        inputs: dict[str, list[str]] = {}
        recurrent: list[str] = []
        fed = {
            tensor.name: self._pipeline.feedback[node.name, tensor.name]
            for tensor in node.inputs
            if (node.name, tensor.name) in self._pipeline.feedback
        }
        for tensor in node.inputs:
            port = (node.name, tensor.name)
            if port in self._pipeline.feeds:
                source, output = self._pipeline.feeds[port]
                inputs[tensor.name] = [f"{_named(source)}.{_named(output)}"]
            elif tensor.name in fed and fed[tensor.name] == (self._acting.name, self._action.name):
                # The action itself is an observation: what is fed back may be no action.
                inputs[tensor.name] = self._observed(
                    tensor, ("sensor: proprio", "terms: [last_output]")
                )
            elif tensor.name in fed:
                recurrent.append(self._recurrent(node, tensor, *fed[tensor.name]))
            else:
                inputs[tensor.name] = self._seen(tensor)
        return _File(node=node, inputs=inputs, recurrent=tuple(recurrent))

    def _recurrent(self, node: Node, tensor: Tensor, source: str, output: str) -> str:
        names = [one.name for one in node.outputs]
        taken = self._taken.get(node.name, [])
        if source != node.name or output not in names or output in taken:
            reason = "another node" if source != node.name else "an output that feeds others too"
            raise PolicyError(
                f"{self._where}: input {tensor.said} of node {plain(node.name)!r} is fed by "
                f"{plain(source)}/{plain(output)} of the last step: {reason}. No card has that",
                fix="export the nodes that feed each other back as one node",
            )
        if node.adapter == "torch-export":
            raise PolicyError(
                f"{self._where}: input {tensor.said} is fed by an output of the last step, which a "
                "card says of ONNX and TorchScript files alone",
                fix="export the pipeline with onnx-dynamo",
            )
        if node.adapter == "onnx":
            return f"{quoted(tensor.name)}: {quoted(output)}"
        shape = f"[{', '.join(map(str, tensor.shape))}]"
        return f"{quoted(tensor.name)}: {{output: {names.index(output)}, shape: {shape}}}"

    def _observed(self, tensor: Tensor, lines: tuple[str, ...]) -> list[str]:
        """Return the name of an observation of these lines, which is added where it is new."""
        for name, known in self._observations.items():
            if known == lines:
                return [name]
        base = key(tensor.name)
        name, count = base, 2
        while name in self._observations:
            name, count = f"{base}_{count}", count + 1
        self._observations[name] = lines
        return [name]

    def _seen(self, tensor: Tensor) -> list[str]:
        """Return the observations that make an input."""
        if tensor.source.startswith("observation:") or not (tensor.kind or tensor.source):
            # A whole term of Isaac Lab, or an input of which only the size is known.
            term = tensor.source.rpartition(":")[2]
            size = tensor.size or None
            terms = (
                [ExportedTerm(name=term, scale=(1.0,), clip=(-math.inf, math.inf), width=size)]
                if term
                else []
            )
            array = ArrayFacts(name=tensor.name, shape=tensor.shape, dtype="float32")
            reason = f"{self._pipeline.file} does not say what it is; it has {tensor.size} numbers"
            parts = parts_of(Wanted(array=array, reason=reason), terms, self._likely)
            self.parts += parts
            return [n for part in parts for n in self._observed(tensor, part.lines)]
        lines = (
            self._joint_lines(tensor) if tensor.kind in JOINT_TERMS else self._body_lines(tensor)
        )
        return self._observed(tensor, ("sensor: proprio", *lines))

    def _joint_lines(self, tensor: Tensor) -> tuple[str, ...]:
        lines = (f"terms: [{JOINT_TERMS[tensor.kind]}]",)
        names = [short_name(name) for name in tensor.elements]
        if names == self._joints:
            return lines
        if not names:
            return (*lines, f"{CHECK} {self._pipeline.file} names no joints of it: as the action's")
        others = [name for name in names if name not in self._joints]
        if others:
            raise PolicyError(
                f"{self._where}: input {tensor.said} has joints that the action does not drive: "
                f"{plain(', '.join(others))}",
                fix="export an action of all joints that the policy sees",
            )
        places = ", ".join(str(self._joints.index(name)) for name in names)
        return (*lines, f"select: [{places}]  # its joints are in another order than the action's")

    def _body_lines(self, tensor: Tensor) -> tuple[str, ...]:
        """Return the lines of what is neither joints nor a whole term."""
        read = tensor.source.rpartition(":")[2] or tensor.name
        frame = ", frame: world" if _IN_WORLD.search(read) else ""
        kind, size = tensor.kind, tensor.size
        is_command = kind == "command/body/velocity" or (
            not kind and tensor.source.startswith("command:")
        )
        elements = [name.lower().lstrip("q") for name in tensor.elements]
        word = ""
        if is_command and size == 3:
            word = "command"
        elif kind == "state/vector3d" and "gravity" in read and size == 3 and not frame:
            word = "gravity"
        elif kind == "state/body/rotation" and size == 4:
            first = elements[:1] == ["w"]
            word = f"{{term: orientation, order: {'wxyz' if first else 'xyzw'}}}"
            if len(elements) != 4:
                return (f"terms: [{word}]  {CHECK} or `order: wxyz`: its elements have no names",)
        elif kind == "state/body/angular_velocity" and size == 3:
            word = f"{{term: ang_vel{frame}}}" if frame else "ang_vel"
        elif kind == "state/body/linear_velocity" and size == 3:
            word = f"{{term: lin_vel{frame}}}" if frame else "lin_vel"
        if not word:
            raise PolicyError(
                f"{self._where}: input {tensor.said} of {self._pipeline.file} is nothing that a "
                "card's observations have",
                fix="annotate the complete observation term as the input, in Isaac Lab with "
                "`leapp_observation_input`, or write the card by hand (docs/how-to/policy-card.md)",
            )
        return (f"terms: [{word}]",)

    def _initial_values(self, facts: CheckpointFacts) -> tuple[str, ...]:
        """Return a note of what a trial begins with otherwise than LEAPP does."""
        ports = [f"{a}/{x}" for a, x in self._pipeline.feedback]
        if not self._pipeline.initial or not ports:
            return ()
        name = plain(self._pipeline.initial)
        try:
            path = facts.path.parent / checked(self._pipeline.initial)
            from nw_policies.safety.tensors import read_tensors

            tensors = read_tensors(bounded_bytes(path, _INITIAL_BYTES), str(path))
        except (OSError, ValueError, OutsideError, PolicyError):
            return (
                f"{name} cannot be read: a trial begins with zeros of {plain(', '.join(ports))}",
            )
        others = [port for port in ports if port in tensors and bool(tensors[port].any())]
        if not others:
            return ()
        ports = plain(", ".join(others))
        return (f"{name} has other numbers than zeros for {ports}; a trial begins with zeros",)

    @property
    def is_commanded(self) -> bool:
        """Whether an observation has the term `command`."""
        return any(
            "command" in line.partition("#")[0] for o in self._observations.values() for line in o
        )

    def lines(self, folder: Path | None) -> list[str]:
        """Return `networks`, `observations`, `inputs`, `output` and `recurrent`.

        Args:
            folder: of the card; None = that of the pipeline.
        """
        base = self._folder if folder is None else folder.resolve()
        is_below = self._folder.is_relative_to(base)
        place = self._folder.relative_to(base) if is_below else Path()
        lines = ["networks:"] if self._files else []
        for one in self._files:
            node = one.node
            file = (place / node.file).as_posix()
            taken = self._taken[node.name]
            outputs = ", ".join(f"{_named(n)}: {{output: {self._output(node, n)}}}" for n in taken)
            lines += [
                f"  {_named(node.name)}:",
                f"    adapter: {node.adapter}",
                f"    checkpoint: {{file: {quoted(file)}, sha256: {node.sha256}}}",
                f"    inputs: {_flow_of(one.inputs)}",
                f"    outputs: {{{outputs}}}",
                *([f"    recurrent: {{{', '.join(one.recurrent)}}}"] if one.recurrent else []),
            ]
        lines += [""] if lines else []
        lines.append(f"observations:  # {self._pipeline.file} names them")
        for name, own in self._observations.items():
            lines += [f"  {name}:", *(f"    {line}" for line in own)]
        lines += ["", f"inputs: {_flow_of(self._policy.inputs)}"]
        if len(self._acting.outputs) > 1:
            lines.append(f"output: {self._output(self._acting, self._action.name)}")
        if self._policy.recurrent:
            lines.append(f"recurrent: {{{', '.join(self._policy.recurrent)}}}")
        return lines

    def _output(self, node: Node, name: str) -> str:
        """Return an output as a card names it: by its place where the file has no names."""
        if node.adapter != "torchscript":
            return quoted(name)
        feeding = {
            x
            for (b, _), (a, x) in self._pipeline.feedback.items()
            if a == b == node.name and (a, x) != (self._acting.name, self._action.name)
        }
        return str([one.name for one in node.outputs if one.name not in feeding].index(name))


def _named(name: str) -> str:
    """Return a name of the pipeline as one of a network on a card."""
    plain_name = re.sub(r"[^\w-]", "_", name, flags=re.ASCII)[:60]
    return plain_name if re.match(r"[A-Za-z_]", plain_name) else f"n_{plain_name}"


def _flow_of(inputs: Mapping[str, Sequence[str]]) -> str:
    parts = (f"{quoted(name)}: [{', '.join(one)}]" for name, one in inputs.items())
    return f"{{{', '.join(parts)}}}"
