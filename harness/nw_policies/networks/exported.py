"""Graphs of `torch.export.save`, read and run without `torch.export.load`.

That function imports torch's compiler, which takes seconds and writes temporary files, unpickles
parts of the file, and evaluates its symbolic expressions as Python. Here the JSON of the graph is
read as data, its weights are plain numbers of checked size, and one operator of torch's after
another is called. Which ones is the file's to say: it runs behind a fence, or is trusted.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from nw_base.errors import PolicyError, TrialError
from nw_policies.safety import Archive, FileLimits, file_kind, open_archive, read_tensors

_STATIC = "export with fixed shapes and batch 1, without `dynamic_shapes`"
_DTYPES = {
    1: torch.uint8,
    2: torch.int8,
    3: torch.int16,
    4: torch.int32,
    5: torch.int64,
    6: torch.float16,
    7: torch.float32,
    8: torch.float64,
    12: torch.bool,
    13: torch.bfloat16,
}
_MEMORY_FORMATS = {
    1: torch.contiguous_format,
    2: torch.channels_last,
    3: torch.channels_last_3d,
    4: torch.preserve_format,
}
_LITERALS: dict[str, Callable[[Any], Any]] = {
    **dict.fromkeys(("as_int", "as_float", "as_bool", "as_string"), lambda body: body),
    **dict.fromkeys(("as_ints", "as_floats", "as_bools"), list),
    "as_none": lambda _: None,
    "as_scalar_type": _DTYPES.__getitem__,
    "as_memory_format": _MEMORY_FORMATS.__getitem__,
    "as_layout": lambda _: torch.strided,
}
_LARGEST = 2**28
"""Numbers in all tensors of a run together: 1 GiB."""
_DEVICE = "\0device"
"""Name, among the values of a run, of a tensor on the device that the run is on."""


@dataclass(frozen=True, kw_only=True)
class GraphInput:
    """One input that the caller of the graph gives."""

    name: str
    shape: tuple[int, ...]
    dtype: torch.dtype


@dataclass(frozen=True, kw_only=True)
class _Step:
    """One operator: where its arguments come from and where its results go."""

    operator: Callable[..., Any]
    name: str
    arguments: dict[str, Callable[[dict[str, Tensor]], Any]]
    outputs: tuple[str | tuple[str, ...], ...]


class ExportedGraph:
    """A graph and its tensors. Tensors that the graph writes to are its recurrent state."""

    def __init__(self, data: bytes, where: str, limits: FileLimits | None = None) -> None:
        """Read a file.

        Args:
            data: the whole file.
            where: its path, for errors.
            limits: bounds on sizes.

        Raises:
            PolicyError: it is something else, damaged, has dynamic shapes, or an operator that is
                not allowed.
        """
        limits = limits or FileLimits()
        if file_kind(data, where) != "torch-export":
            raise PolicyError(
                f"{where}: not a torch.export file",
                fix="save it with torch.export.save(torch.export.export(module, args), file)",
            )
        archive = open_archive(data, where, limits)
        try:
            program, tensors = _read(archive, limits)
            self._build(program, tensors, where)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise PolicyError(
                f"{where}: the graph cannot be read: {type(error).__name__} {error}",
                fix="export it again with a current torch",
            ) from None
        self._initial: dict[str, Tensor] = {}
        self._find_state(where)

    def _build(self, program: dict[str, Any], tensors: dict[str, Tensor], where: str) -> None:
        module = program["graph_module"]
        graph, signature = module["graph"], module["signature"]
        values = graph["tensor_values"]
        self.inputs: tuple[GraphInput, ...] = ()
        self._tensors: dict[str, Tensor] = {}
        for spec in signature["input_specs"]:
            (kind, body), *_ = spec.items()
            match kind:
                case "user_input":
                    name = body["arg"]["as_tensor"]["name"]
                    self.inputs += (_graph_input(name, values[name], where),)
                case "parameter" | "buffer" | "tensor_constant":
                    key = {"tensor_constant": "tensor_constant_name"}.get(kind, f"{kind}_name")
                    self._tensors[body["arg"]["name"]] = tensors[body[key]]
                case _:
                    raise PolicyError(
                        f"{where}: the graph has an input of kind {kind}", fix=_STATIC
                    )
        self._steps = [_step(node, where) for node in graph["nodes"]]
        self._mutations: list[tuple[str, str]] = []
        arguments = {
            spec["buffer"]["buffer_name"]: spec["buffer"]["arg"]["name"]
            for spec in signature["input_specs"]
            if "buffer" in spec
        }
        self.outputs: tuple[str, ...] = ()
        for spec in signature["output_specs"]:
            (kind, body), *_ = spec.items()
            match kind:
                case "user_output":
                    self.outputs += (body["arg"]["as_tensor"]["name"],)
                case "buffer_mutation":
                    source = body["arg"]["name"]
                    self._mutations.append((arguments[body["buffer_name"]], source))
                case _:
                    raise PolicyError(
                        f"{where}: the graph has an output of kind {kind}", fix=_STATIC
                    )
        self.output_shapes = tuple(
            _static_shape(values[name]["sizes"], where) for name in self.outputs
        )

    def _find_state(self, where: str) -> None:
        """Run on shapes alone, then on zeros; copy every tensor that the graph writes to."""
        copies = {name: tensor.clone() for name, tensor in self._tensors.items()}
        versions = {name: tensor._version for name, tensor in self._tensors.items()}  # noqa: SLF001
        zeros = [torch.zeros(spec.shape, dtype=spec.dtype) for spec in self.inputs]
        try:
            with without_compiler():
                shapes = {name: tensor.to("meta") for name, tensor in self._tensors.items()}
                self._run(shapes, [tensor.to("meta") for tensor in zeros], "meta")
                self.run(zeros)
        except TrialError as error:
            raise PolicyError(f"{where}: {error}", fix="export it again") from None
        for name, tensor in self._tensors.items():
            if tensor._version != versions[name]:  # noqa: SLF001 - torch's own count of writes.
                self._initial[name] = copies[name]
        self.reset()

    def run(self, arguments: list[Tensor]) -> list[Tensor]:
        """Return the outputs for inputs in their order.

        Raises:
            TrialError: an operator failed.
        """
        return self._run(self._tensors, arguments, "cpu")

    def _run(
        self, tensors: Mapping[str, Tensor], arguments: list[Tensor], device: str
    ) -> list[Tensor]:
        """Run on a device; on "meta", only shapes are computed, and no memory is taken."""
        values = {_DEVICE: torch.empty(0, device=device), **tensors}
        values |= {spec.name: tensor for spec, tensor in zip(self.inputs, arguments, strict=True)}
        taken = 0
        with torch.no_grad():
            for step in self._steps:
                try:
                    operands = {name: find(values) for name, find in step.arguments.items()}
                    size = _store(values, step, step.operator(**operands))
                except (RuntimeError, TypeError, KeyError, ValueError, IndexError) as error:
                    reason = " ".join(str(error).split())[:160]
                    raise TrialError(
                        f"operator {step.name} of the graph failed: {reason}"
                    ) from error
                if device == "meta":
                    taken += size
                    if taken > _LARGEST:
                        raise TrialError(f"operator {step.name} of the graph makes {taken} numbers")
            for target, source in self._mutations:
                values[target].copy_(values[source])
        return [values[name] for name in self.outputs]

    def reset(self) -> None:
        """Go back to the state that the file was saved with."""
        self.restore(self._initial)

    @property
    def parameters(self) -> int:
        """Numbers in the tensors of the file."""
        return sum(tensor.numel() for tensor in self._tensors.values())

    @property
    def memory(self) -> dict[str, Tensor]:
        """The tensors that the graph writes to; empty for a feed-forward graph."""
        return {name: self._tensors[name] for name in self._initial}

    def state(self) -> dict[str, Tensor]:
        """Return copies of the tensors that the graph writes to; empty for a feed-forward graph."""
        return {name: self._tensors[name].clone() for name in self._initial}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Go back to a `state`."""
        for name in self._initial:
            self._tensors[name].copy_(state[name])


@contextmanager
def without_compiler() -> Generator[None]:
    """Let torch compute shapes, or be recorded, without importing its compiler, which is not used.

    Some functions of torch are Python that it keeps out of its compiler's way
    (`torch._compile`), with `torch._dynamo.disable`. The import of that takes 4 s and fails where
    no temporary file can be made, as behind the fence.
    """
    name = "torch._dynamo"
    if name in sys.modules:
        yield
        return
    stand_in = ModuleType(name)
    stand_in.__dict__["disable"] = _undecorated
    sys.modules[name] = stand_in
    try:
        yield
    finally:
        del sys.modules[name]


def _undecorated(function: Any, *_: Any, **__: Any) -> Any:
    return function


def _read(archive: Archive, limits: FileLimits) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Return the program and its tensors by their names in the module."""
    where = archive.where
    names = archive.names()
    if "serialized_exported_program.json" in names:  # torch 2.5 to 2.7
        program = _json(archive, "serialized_exported_program.json", limits)
        parts = [
            read_tensors(archive.read(name), f"{where}:{name}", limits)
            for name in ("serialized_state_dict.pt", "serialized_constants.pt")
        ]
        return program, parts[0] | parts[1]
    models = [name for name in names if name.startswith("models/") and name.endswith(".json")]
    if len(models) != 1:
        raise PolicyError(
            f"{where}: the file has {len(models)} graphs", fix="export one graph per file"
        )
    model = models[0].removeprefix("models/").removesuffix(".json")
    tensors: dict[str, Tensor] = {}
    for folder, config in (
        ("data/weights/", f"data/weights/{model}_weights_config.json"),
        ("data/constants/", f"data/constants/{model}_constants_config.json"),
    ):
        for name, entry in _json(archive, config, limits)["config"].items():
            tensors[name] = _payload(archive, folder, name, entry, limits)
    return _json(archive, models[0], limits), tensors


def _json(archive: Archive, name: str, limits: FileLimits) -> dict[str, Any]:
    try:
        return json.loads(archive.read(name, at_most=limits.index_bytes))
    except RecursionError:
        raise ValueError(f"{name} is nested too deeply") from None


def _payload(
    archive: Archive, folder: str, name: str, entry: dict[str, Any], limits: FileLimits
) -> Tensor:
    """Read one tensor, whose numbers must lie in the file."""
    where = archive.where
    if entry["use_pickle"] or entry["tensor_meta"] is None:
        raise PolicyError(
            f"{where}: {name!r} is a pickled object, which could run code",
            fix="export a module whose parameters and buffers are dense tensors",
        )
    meta = entry["tensor_meta"]
    dtype = _DTYPES[meta["dtype"]]
    shape, strides = _static_shape(meta["sizes"], where), _static_shape(meta["strides"], where)
    offset = _static_int(meta["storage_offset"], where)
    raw = archive.read(folder + entry["path_name"])
    count = len(raw) // dtype.itemsize
    size = math.prod(shape)
    reach = offset + sum((n - 1) * s for n, s in zip(shape, strides, strict=True))
    if min((*shape, *strides, offset), default=0) < 0 or (size and reach >= count):
        raise PolicyError(
            f"{where}: tensor {name!r} of shape {shape} reaches outside the {count} numbers that "
            "the file holds for it",
            fix="the file is truncated or forged: export the policy again",
        )
    if size * dtype.itemsize > limits.tensor_bytes:
        raise PolicyError(f"{where}: tensor {name!r} of shape {shape} is too large", fix=_STATIC)
    if not size:
        return torch.empty(shape, dtype=dtype)
    flat = torch.frombuffer(bytearray(raw[: count * dtype.itemsize]), dtype=dtype)
    return flat.as_strided(shape, strides, offset).clone(memory_format=torch.contiguous_format)


def _graph_input(name: str, value: dict[str, Any], where: str) -> GraphInput:
    shape = _static_shape(value["sizes"], where)
    if math.prod(shape) > _LARGEST:
        raise PolicyError(f"{where}: input {name!r} has the shape {shape}", fix=_STATIC)
    return GraphInput(name=name, shape=shape, dtype=_DTYPES[value["dtype"]])


def _static_shape(sizes: list[dict[str, Any]], where: str) -> tuple[int, ...]:
    return tuple(_static_int(size, where) for size in sizes)


def _static_int(size: dict[str, Any], where: str) -> int:
    if not isinstance(size.get("as_int"), int):
        raise PolicyError(f"{where}: the graph has sizes that are not fixed", fix=_STATIC)
    return size["as_int"]


def _step(node: dict[str, Any], where: str) -> _Step:
    target = str(node["target"])
    prefix, _, rest = target.partition("torch.ops.aten.")
    name, _, overload = rest.partition(".")
    operator = None
    if not prefix and name.isidentifier() and overload.isidentifier():
        operator = getattr(getattr(torch.ops.aten, name, None), overload, None)
    if not callable(operator):
        raise PolicyError(
            f"{where}: the graph calls {target[:80]!r}, which is not an operator of torch",
            fix="export the plain network, without custom operators or control flow",
        )
    arguments = {arg["name"]: _argument(arg["arg"], name, where) for arg in node["inputs"]}
    if _makes_tensors(operator):
        arguments["device"] = _device
    return _Step(
        operator=operator,
        name=name,
        arguments=arguments,
        outputs=tuple(_output(output, where) for output in node["outputs"]),
    )


def _makes_tensors(operator: Any) -> bool:
    """Whether an operator makes tensors on a device that it is told."""
    arguments = operator._schema.arguments  # noqa: SLF001 - torch shows it nowhere else.
    return any(argument.name == "device" for argument in arguments)


def _argument(arg: dict[str, Any], op: str, where: str) -> Callable[[dict[str, Tensor]], Any]:
    """Return the function that finds an argument among the values of a run."""
    (kind, body), *_ = arg.items()
    if kind in _LITERALS:
        return _constant(_LITERALS[kind](body))
    match kind:
        case "as_tensor":
            name = body["name"]
            return lambda values: values[name]
        case "as_tensors":
            names = [tensor["name"] for tensor in body]
            return lambda values: [values[name] for name in names]
        case "as_optional_tensors":
            optional = [(t.get("as_tensor") or {}).get("name") for t in body]
            return lambda values: [None if n is None else values[n] for n in optional]
        case "as_sym_ints":
            return _constant([_static_int(size, where) for size in body])
        case "as_sym_int":
            return _constant(_static_int(body, where))
        case "as_device":
            return _device
        case _:
            raise PolicyError(f"{where}: operator {op} has an argument of kind {kind}", fix=_STATIC)


def _constant(value: Any) -> Callable[[dict[str, Tensor]], Any]:
    return lambda _: value


def _device(values: dict[str, Tensor]) -> torch.device:
    return values[_DEVICE].device


def _output(output: dict[str, Any], where: str) -> str | tuple[str, ...]:
    (kind, body), *_ = output.items()
    if kind == "as_tensor":
        return body["name"]
    if kind == "as_tensors":
        return tuple(tensor["name"] for tensor in body)
    raise PolicyError(f"{where}: an operator returns {kind}, not a tensor", fix=_STATIC)


def _store(values: dict[str, Tensor], step: _Step, result: Any) -> int:
    """Put results among the values by the names that the graph gives them; return their size."""
    size = 0
    results = (result,) if len(step.outputs) == 1 else result
    for names, part in zip(step.outputs, results if step.outputs else (), strict=True):
        named = {names: part} if isinstance(names, str) else dict(zip(names, part, strict=True))
        values.update(named)
        size += sum(tensor.numel() for tensor in named.values())
    return size
