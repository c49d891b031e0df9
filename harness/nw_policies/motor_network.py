"""Networks of motors, read without running anything, as programs of nw-eval.

TorchScript files of two published forms are known by the names of their modules and tensors:

* an `nn.Sequential` of linear layers with activations between them, as walk-these-ways
  (`scripts/actuator_net`) and Isaac Lab (`ActuatorNetMLP`) have them. The activation is a module of
  torch, or `Act` of walk-these-ways, which has its name as `act`;
* an LSTM, `lstm`, and a linear layer, `linear`, with factors `in_scale` and `out_scale`: ANYmal's
  `anydrive_v3_lstm.pt` of legged_gym, Isaac Lab's `ActuatorNetLSTM`.

An ONNX file without memory is taken as it is. All motors of a group are rows of one batch.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PolicyError
from nw_policies.executor import NEXT, Graph, Program, UnsupportedError
from nw_policies.safety import FileLimits, check_onnx, file_kind
from nw_policies.safety.archive import Archive
from nw_policies.safety.objects import Record, TensorRef
from nw_policies.safety.tensors import SCRIPT_MEMBERS, checked_tree

LIMITS = FileLimits(file_bytes=2**22, tensor_bytes=2**22, index_bytes=2**20)
"""A motor's network has some thousand numbers; 4 MiB are a million."""
INPUT, TORQUE = "x", "torque"
"""What goes in, (joints, inputs), and comes out, (joints, 1). What it remembers are further inputs,
with their next values behind `NEXT`."""

_ACTIVATIONS = {
    "ReLU": "Relu", "Tanh": "Tanh", "Softsign": "Softsign", "Sigmoid": "Sigmoid", "SiLU": "Swish",
    "Identity": "",
}  # fmt: skip
"""Modules of torch without a number of their own, and the operators that they are."""
_ACTS = {
    "relu": "Relu", "leaky_relu": "LeakyRelu", "elu": "Elu", "tanh": "Tanh", "sp": "Softplus",
    "swish": "Swish", "softsign": "Softsign",
}  # fmt: skip
"""Words of walk-these-ways' `Act`."""
_GATES = (0, 3, 1, 2)
"""torch's gates i, f, g, o in ONNX's order i, o, f, g."""
_FIX = "export the network as ONNX, from (joints, inputs) to (joints, 1)"


def motor_program(data: bytes, where: str, *, joints: int, inputs: int) -> Program:
    """Return the program that computes the torques of a group of motors.

    Args:
        data: the whole file.
        where: its path, for errors.
        joints: rows of a batch.
        inputs: numbers that each motor's network is given.

    Raises:
        PolicyError: the file is damaged, too large, no network of a known form, or one that takes
            another number of inputs.
    """
    from nw_policies.executor.plan import plan

    try:
        if file_kind(data, where) == "onnx":
            graph = _onnx(data, where, joints, inputs)
        else:
            graph = _script(data, where, joints, inputs)
        program = plan(graph)
    except (UnsupportedError, ValueError) as error:
        raise _unknown(where, str(error)) from None
    if program.outputs[TORQUE].size != joints:
        raise _unknown(where, f"it gives {program.outputs[TORQUE].shape} for {joints} joints")
    return program


def _unknown(where: str, what: str) -> PolicyError:
    return PolicyError(f"{where}: no network of a motor that is known here: {what}", fix=_FIX)


def _check_inputs(where: str, takes: int, inputs: int) -> None:
    if takes != inputs:
        raise PolicyError(
            f"{where}: the network takes {takes} numbers a joint, the card gives it {inputs}",
            fix="correct `history`: an error and a velocity for each of its steps",
        )


def _onnx(data: bytes, where: str, joints: int, inputs: int) -> Graph:
    from nw_policies.networks.onnx_reading import read_graph

    check_onnx(data, where)
    graph = read_graph(data)
    if len(graph.inputs) != 1 or len(graph.outputs) != 1 or len(graph.inputs[0].shape) != 2:
        raise _unknown(where, f"it has {len(graph.inputs)} inputs, {len(graph.outputs)} outputs")
    own = graph.inputs[0]
    _check_inputs(where, own.shape[1] or inputs, inputs)
    graph.inputs = [replace(own, shape=(joints, inputs))]
    # Known names: identities behind the one that goes in, and before the one that comes out.
    if own.name != INPUT:
        graph.inputs = [replace(own, name=INPUT, shape=(joints, inputs))]
        graph.nodes.insert(0, _identity(INPUT, own.name))
    graph.nodes.append(_identity(graph.outputs[0], TORQUE))
    graph.outputs = [TORQUE]
    return graph


def _identity(source: str, target: str) -> Any:
    from nw_policies.executor import Node

    return Node(operator="Identity", inputs=(source,), outputs=(target,))


def _script(data: bytes, where: str, joints: int, inputs: int) -> Graph:
    kind = file_kind(data, where)
    if kind != "torchscript":
        raise _unknown(where, f"a file of the kind {kind}")
    archive, index = checked_tree(data, where, LIMITS, SCRIPT_MEMBERS)
    root = index.tree
    if not isinstance(root, Record):
        raise _unknown(where, "its root is no module")
    reader = _Script(archive, where, joints, inputs)
    return reader.sequential(root) if _is(root, "Sequential") else reader.recurrent(root)


def _class(part: Any) -> str:
    """Return the class of a module, empty for what is none, as torch calls it."""
    return re.sub(r"___torch_mangle_\d+\.", "", part.name) if isinstance(part, Record) else ""


def _is(part: Any, name: str) -> bool:
    return re.fullmatch(rf"__torch__\.torch\.nn\.modules\.\w+\.{name}", _class(part)) is not None


def _parts(module: Record) -> dict[str, Any]:
    """Return the modules and tensors of a module by name."""
    state = cast("dict[str, Any]", module.state) if isinstance(module.state, dict) else {}
    return {k: v for k, v in state.items() if isinstance(v, Record | TensorRef)}


class _Script:
    """Makes a graph of the modules of a script."""

    def __init__(self, archive: Archive, where: str, joints: int, inputs: int) -> None:
        self._archive, self._where = archive, where
        self._joints, self._inputs = joints, inputs
        self._graph = Graph()
        self._graph.input(INPUT, (joints, inputs))

    def sequential(self, root: Record) -> Graph:
        """Return linear layers with activations between them."""
        value, takes = INPUT, self._inputs
        parts = _parts(root)
        if not all(name.isdecimal() for name in parts):
            raise _unknown(self._where, f"its parts are {', '.join(parts)}")
        for place, (name, part) in enumerate(sorted(parts.items(), key=lambda one: int(one[0]))):
            if _is(part, "Linear"):
                value, takes = self._linear(part, value, takes, is_first=place == 0)
            else:
                value = self._activation(part, name, value)
        return self._ended(value)

    def recurrent(self, root: Record) -> Graph:
        """Return an LSTM with a linear layer behind it."""
        parts = _parts(root)
        if set(parts) != {"in_scale", "out_scale", "lstm", "linear"} or not (
            _is(parts["lstm"], "LSTM") and _is(parts["linear"], "Linear")
        ):
            raise _unknown(self._where, f"its parts are {', '.join(parts) or 'none'}")
        add, constant = self._graph.add, self._graph.constant
        tensors = _parts(parts["lstm"])
        depth = sum(name.startswith("weight_hh_l") for name in tensors)
        if set(tensors) != {
            f"{what}_{side}_l{layer}"
            for what in ("weight", "bias") for side in ("ih", "hh") for layer in range(depth)
        }:  # fmt: skip
            raise _unknown(self._where, "an LSTM of two directions, a projection or without biases")
        size = self._numbers(tensors["weight_hh_l0"], 2).shape[1]
        _check_inputs(self._where, self._numbers(tensors["weight_ih_l0"], 2).shape[1], self._inputs)
        scale = constant(self._numbers(parts["in_scale"]).reshape(1, -1))
        x = add("Mul", INPUT, scale)
        x = add("Reshape", x, constant(np.array([1, self._joints, self._inputs])))
        shape = (1, self._joints, size)
        for layer in range(depth):
            states = [f"{state} {layer}" for state in ("hidden", "cell")]
            before = [self._graph.input(state, shape) for state in states]
            weights = [self._gates(tensors[f"weight_{side}_l{layer}"], 2) for side in ("ih", "hh")]
            biases = [self._gates(tensors[f"bias_{side}_l{layer}"], 1) for side in ("ih", "hh")]
            given = [constant(w[np.newaxis]) for w in (*weights, np.concatenate(biases))]
            y, *after = self._graph.add_many(
                "LSTM", x, *given, "", *before, outputs=3, hidden_size=size
            )
            x = add("Reshape", y, constant(np.array(shape)))
            for state, name in zip(states, after, strict=True):
                self._named(name, NEXT + state)
        flat = add("Reshape", x, constant(np.array([self._joints, size])))
        value, _ = self._linear(parts["linear"], flat, size)
        out = self._numbers(parts["out_scale"])
        if out.size != 1:
            raise _unknown(self._where, f"`out_scale` has {out.size} numbers")
        return self._ended(add("Mul", value, constant(out.reshape(1, 1))))

    def _ended(self, value: str) -> Graph:
        self._named(value, TORQUE)
        return self._graph

    def _named(self, value: str, name: str) -> None:
        self._graph.nodes.append(_identity(value, name))
        self._graph.outputs.append(name)

    def _linear(
        self, part: Record, value: str, takes: int, *, is_first: bool = False
    ) -> tuple[str, int]:
        tensors = _parts(part)
        weight = self._numbers(tensors.get("weight"), 2)
        if is_first:
            _check_inputs(self._where, weight.shape[1], takes)
        elif weight.shape[1] != takes:
            raise _unknown(self._where, f"a layer takes {weight.shape[1]} numbers of {takes}")
        operands = [self._graph.constant(weight.T)]
        product = self._graph.add("MatMul", value, *operands)
        if "bias" in tensors:
            bias = self._graph.constant(self._numbers(tensors["bias"], 1))
            product = self._graph.add("Add", product, bias)
        return product, weight.shape[0]

    def _activation(self, part: Any, name: str, value: str) -> str:
        kind = _class(part)
        operator = next((_ACTIVATIONS[each] for each in _ACTIVATIONS if _is(part, each)), None)
        if kind == "__torch__.Act" or kind.endswith(".Act"):
            operator = _ACTS.get(str(part.state.get("act")))
            kind = f"Act({part.state.get('act')})"
        if operator is None:
            raise _unknown(self._where, f"its part {name!r} is {kind or 'no module'}")
        return self._graph.add(operator, value) if operator else value

    def _gates(self, ref: Any, axes: int) -> NDArray[np.float32]:
        parts = np.split(self._numbers(ref, axes), len(_GATES))
        return np.concatenate([parts[gate] for gate in _GATES])

    def _numbers(self, ref: Any, axes: int | None = None) -> NDArray[np.float32]:
        """Return the numbers of a tensor, which `checked_tree` has found in the file."""
        if not isinstance(ref, TensorRef) or ref.storage.dtype != "float32":
            raise _unknown(self._where, "a tensor is missing, or not float32")
        raw = np.frombuffer(self._archive.read(f"data/{ref.storage.key}"), "<f4")
        strides = tuple(4 * step for step in ref.strides)
        view = np.lib.stride_tricks.as_strided(raw[ref.offset :], ref.shape, strides)
        if (axes is not None and view.ndim != axes) or not np.isfinite(view).all():
            raise _unknown(self._where, f"a tensor of shape {ref.shape}, or not of finite numbers")
        return view.astype(np.float32)
