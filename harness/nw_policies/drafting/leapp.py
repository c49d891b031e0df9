"""Pipelines that LEAPP exports: a YAML file with a network file for each node.

Isaac Lab writes them with `scripts/reinforcement_learning/leapp`, others with the package `leapp`
(NVIDIA, Apache-2.0). `models` has for each node its file, digest, inputs and outputs, each with a
shape and, where its author said so, a `kind` (`state/joint/position`) and names of its elements;
`pipeline` has which output feeds which input, in the same step (`data_flow`) or the next one
(`feedback_flow`). Isaac Lab computes observations and targets inside the graph: its inputs are the
robot's state itself (joint positions without the default pose, the orientation as x, y, z, w), its
outputs joint targets and constant gains.

The node that gives joint targets is the policy; nodes that feed it are the card's `networks`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from nw_base.errors import PolicyError
from nw_base.files.inside import OutsideError, bounded_bytes, checked, what_is
from nw_base.files.yaml_file import YamlProblems, parse_yaml
from nw_policies.cards.joints import short_name
from nw_policies.drafting.checkpoint import CheckpointFacts, forward_code
from nw_policies.drafting.exporters import ExporterMetadata as Metadata
from nw_policies.drafting.fields import Fields, account
from nw_policies.drafting.notation import plain
from nw_policies.safety import FileKind, FileLimits, open_archive
from nw_policies.safety.objects import TensorRef, read_index
from nw_policies.safety.onnx import ONNX, ProtobufMessage, Reader
from nw_policies.safety.tensors import check_references

_MOST = 1000
"""Numbers of one output; gains are one for each joint."""
_FLOAT = 1
"""TensorProto.DataType.FLOAT."""
Constants = dict[str, tuple[float, ...]]


def constant_outputs(data: bytes, where: str, kind: FileKind, names: Sequence[str]) -> Constants:
    """Return the float32 numbers of the outputs that no input changes, as far as they are plain.

    Args:
        data: an ONNX or TorchScript file that has been checked; of others nothing is read.
        where: its path, for errors.
        kind: which of them it is.
        names: the outputs of a TorchScript file, in order.
    """
    try:
        if kind == "onnx":
            return _of_graph(data)
        return _of_script(data, where, names) if kind == "torchscript" else {}
    except (ValueError, PolicyError):
        return {}  # What is no plain constant is not said.


def _of_graph(data: bytes) -> Constants:
    """Return outputs that are initialisers, or copies of them."""
    reader = Reader(ONNX)
    model = reader.read(memoryview(data), "Model")
    graph = reader.read(model.views("graph")[0], "Graph")
    stored: dict[str, ProtobufMessage] = {}
    for view in graph.views("initializer"):
        tensor = reader.read(view, "Tensor")
        stored[tensor.text("name")] = tensor
    copied: dict[str, str] = {}
    for view in graph.views("node"):
        node = reader.read(view, "Node")
        if node.text("op_type") == "Identity":
            copied[node.text("output")] = node.text("input")
    outputs = [reader.read(view, "ValueInfo").text("name") for view in graph.views("output")]
    constants = {name: stored.get(copied.get(name, name)) for name in outputs}
    return {name: n for name, tensor in constants.items() if tensor and (n := _numbers(tensor))}


def _numbers(tensor: ProtobufMessage) -> tuple[float, ...]:
    raw = b"".join([*tensor.views("raw_data"), *tensor.views("float_data")])
    if tensor.integer("data_type") != _FLOAT or len(raw) % 4 or len(raw) > 4 * _MOST:
        return ()
    return _finite(np.frombuffer(raw, "<f4"))


def _of_script(data: bytes, where: str, names: Sequence[str]) -> Constants:
    """Return what `forward` returns as `CONSTANTS.c7`: the tensor 7 of the file's constants."""
    body = forward_code(data, where)
    returned = re.search(r"\n    return (.+)", body)
    text = returned[1] if returned else ""
    bound = re.search(rf"\n    {text} = (.+)", body) if re.fullmatch(r"\w+", text) else None
    items = _items(bound[1] if bound else text)
    if len(items) != len(names):
        return {}
    archive, limits = open_archive(data, where), FileLimits()
    index = read_index(archive.read("constants.pkl", at_most=limits.index_bytes), where, limits)
    check_references(index, archive, "constants", limits)
    tree = index.tree if isinstance(index.tree, tuple | list) else ()
    constants: Constants = {}
    for name, item in zip(names, items, strict=True):
        place = re.fullmatch(r"CONSTANTS\.c(\d{1,6})", item)
        ref = tree[int(place[1])] if place and int(place[1]) < len(tree) else None
        if not isinstance(ref, TensorRef) or ref.storage.dtype != "float32":
            continue
        if math.prod(ref.shape) == ref.storage.count <= _MOST:
            raw = archive.read(f"constants/{ref.storage.key}", at_most=4 * _MOST)
            constants[name] = _finite(np.frombuffer(raw, "<f4"))
    return constants


def _items(text: str) -> list[str]:
    """Return the entries of a tuple as TorchScript writes it; calls in it keep their commas."""
    items, depth = [""], 0
    for letter in text.strip().removeprefix("(").removesuffix(")"):
        depth += (letter in "([") - (letter in ")]")
        if letter == "," and depth == 0:
            items.append("")
        else:
            items[-1] += letter
    return [item.strip() for item in items if item.strip()]


def _finite(numbers: np.ndarray) -> tuple[float, ...]:
    return tuple(numbers.tolist()) if np.isfinite(numbers).all() else ()


_ADAPTERS = {"onnx": "onnx", "jit": "torchscript", "pt2": "torch-export"}
_MOST_NODES = 17
"""A policy and the 16 networks that a card may have."""
_MOST_TENSORS = 200
_LARGEST = 2**20
"""Bytes of the YAML; that of a policy of Isaac Lab has some 5 kB."""
_ACTIONS = {
    "target/joint/position": "joint_position",
    "target/joint/velocity": "joint_velocity",
    "target/joint/torques": "joint_torque",
    "target/joint/effort": "joint_torque",
}
JOINT_TERMS = {
    "state/joint/position": "{term: joint_pos, relative: false}",
    "state/joint/velocity": "joint_vel",
}
"""Terms of a card by the kinds of inputs that have a number for each joint."""
Port = tuple[str, str]
"""A node, and one of its inputs or outputs."""


@dataclass(frozen=True, kw_only=True)
class Tensor:
    """An input or output of a node."""

    name: str
    shape: tuple[int, ...]
    kind: str
    """What it is, by LEAPP's words; empty if unknown."""
    elements: tuple[str, ...]
    """Names of its numbers; empty if none are given."""
    source: str
    """What Isaac Lab connects it to: `state:robot:joint_pos`, `command:base_velocity`."""

    @property
    def size(self) -> int:
        """Numbers of its last axis; 0 where it is no row of one robot."""
        is_row = self.shape and math.prod(self.shape) == self.shape[-1]
        return self.shape[-1] if is_row else 0

    @property
    def said(self) -> str:
        """What it is, for errors."""
        kind = f"{plain(self.kind)}, " if self.kind else ""
        return f"{plain(self.name)!r} ({kind}{' x '.join(map(str, self.shape)) or 'a scalar'})"


@dataclass(frozen=True, kw_only=True)
class Node:
    """A network file of the pipeline."""

    name: str
    file: str
    """Inside the folder of the YAML."""
    sha256: str
    adapter: str
    """That of a card which runs it."""
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """Contents of a YAML file of LEAPP."""

    file: str
    """The YAML's name."""
    nodes: Mapping[str, Node]
    feeds: Mapping[Port, Port]
    """By input, the output of the same step that feeds it."""
    feedback: Mapping[Port, Port]
    """By input, the output of the last step."""
    rate: float | None = None
    """Runs per second, Hz."""
    initial: str = ""
    """The file of what `feedback` begins with."""
    notes: tuple[str, ...] = ()
    """What the YAML has that no card does."""


def is_pipeline(text: str) -> bool:
    """Whether a text looks like a YAML file of LEAPP."""
    return all(re.search(rf"^{word}:", text, re.MULTILINE) for word in ("models", "pipeline"))


def pipeline_of(texts: Mapping[str, str], checkpoint: str) -> tuple[Pipeline, Node] | None:
    """Return the pipeline that a checkpoint is a node of, and that node; None where there is none.

    Args:
        texts: name and text of YAML files beside it.
        checkpoint: the name of its file.

    Raises:
        PolicyError: the YAML is damaged or names files outside its folder.
    """
    for name, text in texts.items():
        if "/" in name or not is_pipeline(text):
            continue
        pipeline = read_pipeline(text, name)
        for node in pipeline.nodes.values():
            if node.file == checkpoint:
                return pipeline, node
    return None


def pipeline_checkpoint(folder: Path) -> Path | None:
    """Return the file in a folder that gives the action of a pipeline; None where there is none.

    Raises:
        PolicyError: the pipeline cannot be used.
    """
    for path in sorted(folder.glob("*.y*ml")):
        if path.suffix not in {".yaml", ".yml"} or what_is(path) != "file":
            continue
        try:
            text = bounded_bytes(path, _LARGEST).decode("utf-8")
        except (OSError, ValueError):
            continue
        if is_pipeline(text):
            node = acting_node(read_pipeline(text, str(path)), str(path))
            return folder / node.file
    return None


def read_pipeline(text: str, where: str) -> Pipeline:
    """Read a YAML file of LEAPP.

    Args:
        text: of the file.
        where: its path, for errors.

    Raises:
        PolicyError: it is damaged, too large, or names a file outside its folder.
    """
    try:
        data = Fields(parse_yaml(text, file=where, foreign=True).data)
    except YamlProblems as problems:
        raise PolicyError(f"{where}: {problems}", fix="export the pipeline again") from None
    models, pipeline = _dict(data.get("models")), _dict(data.get("pipeline"))
    if not models or len(models) > _MOST_NODES:
        raise PolicyError(
            f"{where}: `models` has {len(models)} nodes; a card runs 1 to {_MOST_NODES}",
            fix="export the policy as fewer nodes",
        )
    parsed = Pipeline(
        file=plain(Path(where).name),
        nodes={str(name): _node(str(name), _dict(one), where) for name, one in models.items()},
        feeds=_flow(pipeline.get("data_flow"), where),
        feedback=_flow(pipeline.get("feedback_flow"), where),
        rate=_rate(data.below("pipeline").below("configs")),
        initial=str(pipeline.get("initial_values") or ""),
    )
    return replace(parsed, notes=account(parsed.file, ["leapp"], data))


def _rate(configs: Fields) -> float | None:
    rate = configs.number("frequency")
    is_rate = rate is not None and 0 < rate <= 2000
    configs.doubt("frequency", configs.get("frequency"), readable=is_rate)
    return rate if is_rate else None


def _node(name: str, data: Mapping[str, Any], where: str) -> Node:
    parameters = _dict(data.get("parameters"))
    file, digest = str(parameters.get("model_path")), str(parameters.get("sha256sum"))
    backend = str(parameters.get("backend"))
    subject = f"{where}: node {plain(name)!r}"
    try:
        checked(file)
    except OutsideError as error:
        raise PolicyError(
            f"{subject} has its file at {plain(file)!r}: {error}",
            fix="copy the file into the folder of the YAML, and name it there in `model_path`",
        ) from None
    if backend not in _ADAPTERS:
        raise PolicyError(
            f"{subject} is of the backend {plain(backend)!r}, which no card runs",
            fix=f"export it with one of {', '.join(_ADAPTERS)}",
        )
    if not re.fullmatch(r"[0-9a-f]{64}", digest):
        raise PolicyError(f"{subject} has no `sha256sum`", fix="export the pipeline again")
    inputs, outputs = _tensors(data.get("inputs")), _tensors(data.get("outputs"))
    if not inputs or not outputs:
        raise PolicyError(
            f"{subject} has no {'outputs' if inputs else 'inputs'} that can be read",
            fix="export the pipeline again",
        )
    return Node(
        name=name,
        file=file,
        sha256=digest,
        adapter=_ADAPTERS[backend],
        inputs=inputs,
        outputs=outputs,
    )


def _tensors(value: Any) -> tuple[Tensor, ...]:
    tensors: list[Tensor] = []
    for entry in map(_dict, _list(value)[:_MOST_TENSORS]):
        sizes = _list(entry.get("shape"))
        if not all(isinstance(size, int) and 0 <= size < 2**31 for size in sizes):
            return ()
        axes = [
            [n for n in _list(axis) if isinstance(n, str)]
            for axis in _list(entry.get("element_names"))
        ]
        names = next((axis for axis in reversed(axes) if sizes and len(axis) == sizes[-1]), [])
        tensors.append(
            Tensor(
                name=str(entry.get("name")),
                shape=tuple(sizes),
                kind=str(entry.get("kind") or ""),
                elements=tuple(names),
                source=str(entry.get("isaaclab_connection") or ""),
            )
        )
    return tuple(tensors)


def _flow(value: Any, where: str) -> dict[Port, Port]:
    flow: dict[Port, Port] = {}
    for source in _dict(value):
        for target in _list(_dict(value)[source]):
            ends = [str(end).partition("/") for end in (source, target)]
            (a, slash_a, x), (b, slash_b, y) = ends
            if not slash_a or not slash_b or (b, y) in flow:
                raise PolicyError(
                    f"{where}: the flow from {plain(str(source))!r} to {plain(str(target))!r} "
                    "cannot be read",
                    fix="export the pipeline again",
                )
            flow[b, y] = (a, x)
    return flow


def acting_node(pipeline: Pipeline, where: str) -> Node:
    """Return the node that gives the action.

    Raises:
        PolicyError: none does, or several do.
    """
    nodes = list(pipeline.nodes.values())
    acting = [n for n in nodes if any(o.kind in _ACTIONS for o in n.outputs)]
    if not acting:  # The roles are not given: the node that feeds no other.
        feeding = {source for source, _ in pipeline.feeds.values()}
        acting = [n for n in nodes if n.name not in feeding]
    if len(acting) != 1:
        names = ", ".join(plain(n.name) for n in acting) or "none"
        raise PolicyError(
            f"{where}: {'several nodes give' if acting else 'no node gives'} an action: {names}",
            fix="export a pipeline in which one node gives the targets of all joints",
        )
    return acting[0]


def action_of(node: Node, pipeline: Pipeline, where: str) -> Tensor:
    """Return the output of a node that is the action.

    Raises:
        PolicyError: several outputs drive joints, or none does.
    """
    said = [one for one in node.outputs if one.kind in _ACTIONS]
    if not said and all(one.kind in {"", "kp", "kd"} for one in node.outputs):
        fed = {x for a, x in pipeline.feedback.values() if a == node.name}
        free = [one for one in node.outputs if not one.kind and one.size > 1]
        said = [one for one in free if one.name not in fed] or free
    if len(said) != 1:
        shown = ", ".join(one.said for one in said or node.outputs)
        raise PolicyError(
            f"{where}: a card's policy has one action, and node {plain(node.name)!r} has "
            f"{len(said)}: {shown}",
            fix="export one action term for all joints, as one `target/joint/position`",
        )
    return said[0]


def joints_of(action: Tensor, pipeline: Pipeline) -> tuple[str, ...]:
    """Return the joints of an action in its order; without names, those of the joint positions."""
    inputs = [one for node in pipeline.nodes.values() for one in node.inputs]
    named = [o for kind in JOINT_TERMS for o in inputs if o.kind == kind and o.size == action.size]
    names = next((one.elements for one in (action, *named) if one.elements), ())
    return tuple(short_name(plain(name)) for name in names)


def metadata_of(pipeline: Pipeline, node: Node, facts: CheckpointFacts) -> Metadata:
    """Return what the pipeline says of joints, actions, gains and rate.

    Raises:
        PolicyError: as `action_of`; or the file is another one than the YAML is about.
    """
    where = str(facts.path)
    if facts.sha256 != node.sha256:
        raise PolicyError(
            f"{where}: its SHA-256 is {facts.sha256[:12]}..., {pipeline.file} has "
            f"{node.sha256[:12]}...: it is another file than the one that was exported",
            fix="copy YAML and files of one export together",
        )
    action = action_of(node, pipeline, where)
    names = joints_of(action, pipeline)
    constants = constant_outputs(
        facts.path.read_bytes(), where, facts.format, [one.name for one in node.outputs]
    )
    gains = {kind: _gains(kind, node, names, constants) for kind in ("kp", "kd")}
    said = {
        "joint_names": names,
        "joint_stiffness": gains["kp"],
        "joint_damping": gains["kd"],
        "action": _ACTIONS.get(action.kind, ""),
        "action_scale": (1.0,) if action.kind else (),
        "rate": pipeline.rate,
    }
    sources = {name: pipeline.file for name, value in said.items() if value}
    notes = [*pipeline.notes]
    if gains["kp"] and not any(gains["kp"]) and action.kind == "target/joint/position":
        # Isaac Lab did so for explicit actuators until its pull request 6252.
        notes.append("all gains of the bundle are 0: take kp and kd from the training")
        for name in ("joint_stiffness", "joint_damping"):
            said[name] = ()
            sources.pop(name, None)
    return Metadata(
        **cast("dict[str, Any]", said),
        guessed_order=bool(names) and not action.elements,
        sources=sources,
        notes=tuple(notes),
    )


def _gains(
    kind: str, node: Node, names: Sequence[str], constants: Mapping[str, tuple[float, ...]]
) -> tuple[float, ...]:
    """Return the gains of all joints in their order; none where the file does not hold them."""
    gains: dict[str, float] = {}
    for output in node.outputs:
        if output.kind == kind and output.name in constants:
            own = [short_name(name) for name in output.elements] or names
            gains |= dict(zip(own, constants[output.name], strict=False))
    return tuple(gains[name] for name in names) if names and set(names) <= set(gains) else ()


def _dict(value: Any) -> Mapping[str, Any]:
    return cast("Mapping[str, Any]", value) if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return cast("list[Any]", value) if isinstance(value, list) else []
