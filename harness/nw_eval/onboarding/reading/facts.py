"""Reads a checkpoint of any known format and collects what it says of itself."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import assert_never

from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.files.inside import regular
from nw_eval.onboarding.reading.exporter import ExporterMetadata, read_exporter_metadata
from nw_eval.onboarding.reading.script import ScriptInput, script_inputs
from nw_eval.policies.onnx.recurrence import state_pairs
from nw_eval.policies.safety import (
    FileKind,
    FileLimits,
    TensorFacts,
    check_onnx,
    file_kind,
    tensor_facts,
)

EXPORT = "export the policy as ONNX or with torch.export"
_STATE_DICTS = "a plain state dict is enough for extreme-parkour, LucidSim and ACT only"


@dataclass(frozen=True, kw_only=True)
class ArrayFacts:
    """An input or output of a graph."""

    name: str
    shape: tuple[int | None, ...]
    """None is a free axis."""
    dtype: str


@dataclass(frozen=True, kw_only=True)
class CheckpointFacts:
    """What a checkpoint says of itself."""

    path: Path
    sha256: str
    format: FileKind
    adapter: str | None
    """The adapter of a card that reads it; None if the file holds weights of an unknown network."""
    inputs: tuple[ArrayFacts, ...] = ()
    """What it takes at each step, without recurrent state; empty where the format does not say."""
    script: tuple[ScriptInput, ...] = ()
    """What the code of a TorchScript file says that it takes, without shapes."""
    outputs: tuple[ArrayFacts, ...] = ()
    recurrent: tuple[str, ...] = ()
    """Names of the state that it carries from step to step."""
    parameters: int = 0
    """Numbers in its tensors; 0 where they were not counted."""
    tensors: tuple[TensorFacts, ...] = ()
    """Tensors by name, for formats that name them."""
    metadata: Mapping[str, str] = field(default_factory=dict[str, str])
    """Entries that an exporter left in the file, as they are."""
    exporter: ExporterMetadata | None = None
    """The same, understood."""


def inspect_checkpoint(path: Path) -> CheckpointFacts:
    """Read a checkpoint without running it.

    Args:
        path: an ONNX, TorchScript, torch.export, safetensors or torch state-dict file.

    Raises:
        PolicyError: the file cannot be read, is none of these, or could run code.
    """
    where = str(path)
    try:
        size = regular(path).stat().st_size
        if size > FileLimits().file_bytes:
            raise PolicyError(
                f"{where}: the file has {size / 2**20:.0f} MiB, over the limit of "
                f"{FileLimits().file_bytes // 2**20}",
                fix="export the actor alone",
            )
        data = path.read_bytes()
    except OSError as error:
        raise PolicyError(
            f"{where}: the checkpoint cannot be read: {error.strerror}", fix="check the path"
        ) from None
    try:
        return _facts(data, path)
    except PolicyError as error:
        if error.fix is None or not re.search("state.dict", error.fix):
            raise
        # A state dict helps whoever has a card; here it would be refused as an unknown network.
        what = str(error).removesuffix(f"; {error.fix}")
        raise PolicyError(what, fix=f"{EXPORT} where you trust the file; {_STATE_DICTS}") from None


def _facts(data: bytes, path: Path) -> CheckpointFacts:
    where = str(path)
    sha256 = hashlib.sha256(data).hexdigest()
    kind = file_kind(data, where)
    match kind:
        case "onnx":
            return _onnx(data, path, sha256)
        case "torch-export":
            return _exported(data, path, sha256)
        case "torchscript":
            tensors = tensor_facts(data, where)
            return CheckpointFacts(
                path=path,
                sha256=sha256,
                format=kind,
                adapter="torchscript",
                script=script_inputs(data, where, tensors),
                recurrent=_recurrent_weights(tensors),
                parameters=_count(tensors),
                tensors=tensors,
            )
        case "state-dict" | "safetensors":
            tensors = tensor_facts(data, where)
            return CheckpointFacts(
                path=path,
                sha256=sha256,
                format=kind,
                adapter=_known_network(tensors),
                recurrent=_recurrent_weights(tensors),
                parameters=_count(tensors),
                tensors=tensors,
            )
        case "unknown":
            raise PolicyError(
                f"{where}: the format of the file is unknown",
                fix="give an ONNX, TorchScript, torch.export or state-dict file",
            )
        case _:
            assert_never(kind)


def _onnx(data: bytes, path: Path, sha256: str) -> CheckpointFacts:
    from nw_eval.policies.onnx.session import open_session

    check_onnx(data, str(path))
    try:
        session = open_session(data, optimise=False)
    except Exception as error:  # noqa: BLE001 - onnxruntime's exceptions share no public base.
        raise PolicyError(
            f"{path}: not a usable ONNX file: {clean(error, at_most=200)}",
            fix="export it again as one file with standard operators",
        ) from None
    inputs = tuple(_node(node.name, node.shape, node.type) for node in session.get_inputs())
    outputs = tuple(_node(node.name, node.shape, node.type) for node in session.get_outputs())
    metadata = dict(session.get_modelmeta().custom_metadata_map)
    state = state_pairs({a.name: a.shape for a in inputs}, {a.name: a.shape for a in outputs})
    return CheckpointFacts(
        path=path,
        sha256=sha256,
        format="onnx",
        adapter="onnx",
        inputs=tuple(array for array in inputs if array.name not in state),
        outputs=tuple(array for array in outputs if array.name not in state.values()),
        recurrent=tuple(f"{source} -> {target}" for source, target in state.items()),
        metadata=metadata,
        exporter=read_exporter_metadata(metadata),
    )


def _node(name: str, shape: Sequence[int | str | None], kind: str) -> ArrayFacts:
    sizes = tuple(size if isinstance(size, int) else None for size in shape)
    dtype = kind.removeprefix("tensor(").removesuffix(")")
    dtype = {"float": "float32", "double": "float64"}.get(dtype, dtype)
    return ArrayFacts(name=name, shape=sizes, dtype=dtype)


def _exported(data: bytes, path: Path, sha256: str) -> CheckpointFacts:
    from nw_eval.policies.networks.exported import ExportedGraph

    graph = ExportedGraph(data, str(path))
    return CheckpointFacts(
        path=path,
        sha256=sha256,
        format="torch-export",
        adapter="torch-export",
        inputs=tuple(
            ArrayFacts(
                name=spec.name, shape=spec.shape, dtype=str(spec.dtype).removeprefix("torch.")
            )
            for spec in graph.inputs
        ),
        outputs=tuple(
            ArrayFacts(name=name, shape=shape, dtype="float32")
            for name, shape in zip(graph.outputs, graph.output_shapes, strict=True)
        ),
        recurrent=tuple(graph.state()),
        parameters=graph.parameters,
    )


def _count(tensors: Sequence[TensorFacts]) -> int:
    return sum(math.prod(tensor.shape) for tensor in tensors)


def _recurrent_weights(tensors: Sequence[TensorFacts]) -> tuple[str, ...]:
    """Return the names of recurrent layers, whose hidden state the file does not show."""
    found = (tensor.name.rpartition(".") for tensor in tensors)
    return tuple(dict.fromkeys(path for path, _, leaf in found if leaf.startswith("weight_hh_l")))


def _known_network(tensors: Sequence[TensorFacts]) -> str | None:
    names = {tensor.name.removeprefix("model.") for tensor in tensors}
    if {"act_tokens", "transformer.0.fused_attn_ff_proj.weight"} <= names:
        return "lucidsim"
    if "estimator_state_dict.estimator.0.weight" in names:
        return "extreme-parkour"
    if {"decoder_pos_embed.weight", "action_head.weight"} <= names:
        return "act"
    return None
