"""Facts that a checkpoint of any known format contains, read without running it.

A graph says what it takes and gives. Of a scripted module, TorchScript keeps the code in members
`code/__torch__/...py`, in a small language that always writes a method as `def forward(self:
Type,`, one line for each argument, `) -> Type:`; it is read as text, nothing of it is run or
compiled.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, assert_never, cast

from nw_base.clean import clean
from nw_base.errors import PolicyError
from nw_base.files.inside import regular
from nw_policies.drafting.exporters import ExporterMetadata, read_exporter_metadata
from nw_policies.drafting.notation import plain
from nw_policies.networks.onnx_graph import state_pairs
from nw_policies.safety import (
    FileKind,
    FileLimits,
    TensorFacts,
    check_onnx,
    file_kind,
    open_archive,
    tensor_facts,
)
from nw_policies.safety.objects import Record, read_objects
from nw_policies.safety.tensors import plain_entries

EXPORT = "export the policy as ONNX or with torch.export"
_STATE_DICTS = "a plain state dict is enough for layers in a row, extreme-parkour, LucidSim and ACT"

_CODE_BYTES = 2**20
_FOLLOWED = 8
"""Functions that an argument is followed through to its first layer."""
_KEEP_WIDTH = "clamp|clip|sub|add|mul|div|to|unsqueeze|squeeze|nan_to_num|contiguous|clone|tanh"
_NOWHERE = "\0"
_ARGUMENT = re.compile(r"^(\w+): ([\w.\[\], ]+?)(?:\s*=.*)?$")


@dataclass(frozen=True, kw_only=True)
class ArrayFacts:
    """An input or output of a graph."""

    name: str
    shape: tuple[int | None, ...]
    """None is a free axis."""
    dtype: str


@dataclass(frozen=True, kw_only=True)
class ScriptInput:
    """An argument of a module's `forward` that has no default."""

    name: str
    kind: str
    """`Tensor`, or another type as TorchScript writes it."""
    size: int | None
    """How many numbers the layer takes that it is passed to; None where other code sees it first.
    """
    images: tuple[int | None, ...] = ()
    """Of a list of tensors: for each that is used, the channels of the convolution it goes into."""


@dataclass(frozen=True, kw_only=True)
class CheckpointFacts:
    """Facts that a checkpoint contains."""

    path: Path
    sha256: str
    format: FileKind
    adapter: str | None
    """The adapter of a card that reads it; None if the file holds weights of an unknown network."""
    inputs: tuple[ArrayFacts, ...] = ()
    """What it takes at each step, without recurrent state; empty where the format does not say."""
    script: tuple[ScriptInput, ...] = ()
    """What the code of a TorchScript file says that it takes, without shapes."""
    taken: int = 0
    """Numbers of a row of zeros that its one input was seen to take; 0 where it was not run."""
    joints: int = 12
    """Of the robot that it drives, by which published layouts are found."""
    outputs: tuple[ArrayFacts, ...] = ()
    recurrent: tuple[str, ...] = ()
    """Names of the state that it carries from step to step."""
    parameters: int = 0
    """Numbers in its tensors; 0 where they were not counted."""
    tensors: tuple[TensorFacts, ...] = ()
    """Tensors by name, for formats that name them."""
    entries: tuple[str, ...] = ()
    """Names of what else a file of weights has: numbers, texts and lists of them."""
    metadata: Mapping[str, str] = field(default_factory=dict[str, str])
    """Entries that an exporter left in the file, as they are."""
    exporter: ExporterMetadata | None = None
    """The same, understood."""


def inspect_checkpoint(path: Path) -> CheckpointFacts:
    """Read a checkpoint without running it.

    Args:
        path: an ONNX, TorchScript, torch.export, safetensors or torch state-dict file, a zip file
            of Stable-Baselines3, or parameters of brax or flax.

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
        case (
            "torchscript"
            | "state-dict"
            | "safetensors"
            | "stable-baselines3"
            | "pickle"
            | "msgpack"
        ):
            is_script = kind == "torchscript"
            tensors = tensor_facts(data, where)
            return CheckpointFacts(
                path=path,
                sha256=sha256,
                format=kind,
                adapter="torchscript" if is_script else _known_network(tensors),
                script=script_inputs(data, where, tensors) if is_script else (),
                recurrent=_recurrent_weights(tensors),
                parameters=sum(math.prod(tensor.shape) for tensor in tensors),
                tensors=tensors,
                entries=() if is_script else plain_entries(data, where),
                metadata=_SETTINGS[kind](data, where) if kind in _SETTINGS else {},
                exporter=_noted(data, where) if kind in {"safetensors", "torchscript"} else None,
            )
        case "unknown":
            raise PolicyError(
                f"{where}: the format of the file is unknown",
                fix="give an ONNX, TorchScript, torch.export or state-dict file",
            )
        case _:
            assert_never(kind)


_OF_NETWORK = re.compile(
    r":.*|__.*|activation_fn|squash_output|use_sde|net_arch|ortho_init|.*std.*|use_expln|"
    r"optimizer_.*|n_critics|n_quantiles|share_features_extractor|normalize_images|.*lstm.*"
)
"""Settings of its networks that are read, are seen in the tensors, or steer a training."""


def _saved_settings(data: bytes, where: str) -> dict[str, str]:
    """Return what Stable-Baselines3 wrote down, as JSON, beside its pickles.

    It is the activation, the limits of the action space, and names of what is unknown here.
    """
    text = open_archive(data, where).read("data", at_most=FileLimits().index_bytes)
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError):
        return {"unread": "all of `data`, which is no JSON"}
    settings = cast("dict[str, Any]", whole) if isinstance(whole, dict) else {}
    kwargs, space = settings.get("policy_kwargs"), settings.get("action_space")
    network = cast("dict[str, Any]", kwargs) if isinstance(kwargs, dict) else {}
    limits = cast("dict[str, Any]", space) if isinstance(space, dict) else {}
    facts = {f"action_{side}": str(limits.get(side, "")) for side in ("low", "high")}
    facts["use_sde"] = str(settings.get("use_sde"))
    facts["squash_output"] = str(network.get("squash_output"))
    function = str(network.get("activation_fn", ""))
    named = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", function)
    # The algorithm's own attributes steer a training; `predict` reads the policy and the spaces.
    unread = [f"policy_kwargs.{name}" for name in network if not _OF_NETWORK.fullmatch(name)]
    if named is not None:
        facts["activation"] = named[1]
    elif function:
        unread.append(f"policy_kwargs.activation_fn {function}")
    return {**facts, "unread": plain(", ".join(unread))}


def _header_settings(data: bytes, _: str) -> dict[str, str]:
    """Return the texts in the header of a safetensors file, which has been checked."""
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    metadata = header.get("__metadata__")
    items = cast("dict[str, Any]", metadata).items() if isinstance(metadata, dict) else ()
    return {key: value for key, value in items if isinstance(value, str)}


def _noted(data: bytes, where: str) -> ExporterMetadata | None:
    """Return notes of what a header or extra files say, which nothing reads."""
    if file_kind(data, where) == "safetensors":
        left = [
            name for name in _header_settings(data, where) if name not in {"activation", "format"}
        ]
        what = "its header has what this card does not"
    else:
        left = [name for name in open_archive(data, where).names() if name.startswith("extra/")]
        what = "its extra files were not read"
    note = f"{what}: {plain(', '.join(left))}"
    return ExporterMetadata(notes=(note,)) if left else None


_SETTINGS = {"stable-baselines3": _saved_settings, "safetensors": _header_settings}


def _onnx(data: bytes, path: Path, sha256: str) -> CheckpointFacts:
    from nw_policies.networks.onnx_reading import read_declared

    check_onnx(data, str(path))
    try:
        declared = read_declared(data)
    except ValueError as error:
        raise PolicyError(
            f"{path}: not a usable ONNX file: {clean(error, at_most=200)}",
            fix="export it again as one file with standard operators",
        ) from None
    inputs = tuple(ArrayFacts(**each._asdict()) for each in declared.inputs)
    outputs = tuple(ArrayFacts(**each._asdict()) for each in declared.outputs)
    metadata = declared.metadata
    state = state_pairs({a.name: a.shape for a in inputs}, {a.name: a.shape for a in outputs})
    return CheckpointFacts(
        path=path,
        sha256=sha256,
        format="onnx",
        adapter="onnx",
        inputs=tuple(array for array in inputs if array.name not in state),
        outputs=tuple(array for array in outputs if array.name not in state.values()),
        recurrent=tuple(f"{source} -> {target}" for source, target in state.items()),
        tensors=tuple(TensorFacts(name=name, shape=(), dtype="") for name in declared.weights),
        metadata=metadata,
        exporter=read_exporter_metadata(
            metadata, sum(array.shape[-1] or 0 for array in inputs if array.shape)
        ),
    )


def _exported(data: bytes, path: Path, sha256: str) -> CheckpointFacts:
    from nw_policies.networks.exported import ExportedGraph

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


def _recurrent_weights(tensors: Sequence[TensorFacts]) -> tuple[str, ...]:
    """Return the names of recurrent layers, whose hidden state the file does not show."""
    names = (tensor.name.rpartition(".") for tensor in tensors)
    return tuple(dict.fromkeys(path for path, _, leaf in names if leaf.startswith("weight_hh_l")))


def _known_network(tensors: Sequence[TensorFacts]) -> str | None:
    names = {tensor.name.removeprefix("model.") for tensor in tensors}
    if {"act_tokens", "transformer.0.fused_attn_ff_proj.weight"} <= names:
        return "lucidsim"
    if "estimator_state_dict.estimator.0.weight" in names:
        return "extreme-parkour"
    if {"decoder_pos_embed.weight", "action_head.weight"} <= names:
        return "act"
    return None


def script_inputs(
    data: bytes, where: str, tensors: Sequence[TensorFacts]
) -> tuple[ScriptInput, ...]:
    """Return what `forward` takes; empty where the code does not say it plainly.

    Args:
        data: a whole TorchScript file.
        where: its path, for errors.
        tensors: the file's, for sizes.
    """
    body = forward_code(data, where)
    signature = re.match(r"  def forward\(\w+: [\w.]+(?:,\s*([^)]*))?\) ->", body)
    if signature is None or signature[1] is None:
        return ()
    inputs: list[ScriptInput] = []
    for argument in re.split(r",\s*\n\s*", signature[1].strip()):
        parts = _ARGUMENT.match(argument)
        if parts is None:
            return ()
        if "=" not in argument:
            size = _first_width(parts[1], body, tensors)
            images = _image_channels(parts[1], body, tensors) if parts[2] == "List[Tensor]" else ()
            inputs.append(ScriptInput(name=parts[1], kind=parts[2], size=size, images=images))
    return tuple(inputs)


def forward_code(data: bytes, where: str) -> str:
    """Return the lines of `forward` of a TorchScript file; "" where it does not show them."""
    archive = open_archive(data, where)
    index = archive.read("data.pkl", at_most=FileLimits().index_bytes)
    module = read_objects(index, where)
    if not isinstance(module, Record):
        return ""
    file, _, name = module.name.rpartition(".")
    try:
        code = archive.read(f"code/{file.replace('.', '/')}.py", at_most=_CODE_BYTES)
    except PolicyError:  # Absent or long: then it says nothing.
        return ""
    return _forward_code(code.decode("utf-8", "replace"), name)


def _forward_code(code: str, name: str) -> str:
    """Return the lines of `forward` of a class; "" if there is none."""
    start = code.find(f"class {name}(Module):\n")
    start = -1 if start < 0 else code.find("\n  def forward(", start) + 1
    # A later class may have one where this has none; both begin at the margin.
    if start < 1 or "\nclass " in code[code.find(f"class {name}(Module):\n") : start]:
        return ""
    end = re.search(r"\n(?=\S|  \S)", code[start:])
    return code[start : start + end.start()] if end else code[start:]


def _first_width(argument: str, body: str, tensors: Sequence[TensorFacts]) -> int | None:
    """Return the width of the first layer that an argument goes into, one function at a time."""
    for _ in range(_FOLLOWED):
        call = re.search(rf"(?:(\w+) = |\()\(?(\w+)\)\.forward\w*\({argument}, ", body)
        if call is not None:
            prefix = _submodule(call[2], body)
            layers = (t for t in tensors if prefix and t.name.startswith(prefix))
            size = next((tensor.shape[1] for tensor in layers if len(tensor.shape) == 2), None)
            if size is not None:
                return size
        else:
            call = re.search(rf"(\w+) = torch\.(?:{_KEEP_WIDTH})\({argument}[,)]", body)
        if call is None or call[1] is None:
            return None
        argument = call[1]
    return None


def _image_channels(
    argument: str, body: str, tensors: Sequence[TensorFacts]
) -> tuple[int | None, ...]:
    """Return the channels of the convolutions that the items of a list go into, by their place."""
    used = [int(place) for place in re.findall(rf"\b{argument}\[(\d{{1,2}})\]", body)]
    channels: list[int | None] = [None] * (max(used, default=-1) + 1)
    for call in re.finditer(rf"\((\w+)\)\.forward\w*\({argument}\[(\d{{1,2}})\], ", body):
        prefix = _submodule(call[1], body)
        layers = (t for t in tensors if prefix and t.name.startswith(prefix))
        channels[int(call[2])] = next((t.shape[1] for t in layers if len(t.shape) == 4), None)
    return tuple(channels)


def _submodule(name: str, body: str) -> str:
    """Return what the names of the tensors begin with of the submodule in a variable; or ""."""
    match = re.search(rf'\n    {name} = (?:(\w+)\.(\w+)|getattr\((\w+), "(\w+)"\))\n', body)
    if match is None:
        return ""
    of, own = match[1] or match[3], match[2] or match[4]
    return f"{own}." if of == "self" else f"{_submodule(of, body) or _NOWHERE}{own}."
