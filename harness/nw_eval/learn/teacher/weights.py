"""The policy as an ONNX file: read without running it, and written."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray

from nw_eval.errors import PolicyError
from nw_eval.learn.teacher.ppo.networks import LIMIT, Actor
from nw_eval.learn.teacher.world.senses import OBSERVED
from nw_eval.policies.networks.onnx_graph import Graph
from nw_eval.policies.safety import check_onnx
from nw_eval.policies.safety.onnx.fields import ONNX
from nw_eval.policies.safety.onnx.protobuf import ProtobufMessage, Reader, integers

_FLOAT32 = 1
_AXES = 8


def read_actor(data: bytes, where: str) -> Actor:
    """Return the network of an ONNX file of the form that `write_actor` writes.

    Only numbers are taken: the file's initialisers, in the order in which its nodes use them.

    Args:
        data: the whole file.
        where: its path, for errors.

    Raises:
        PolicyError: it is no such network, damaged, or of other sizes.
    """
    check_onnx(data, where)
    used = _numbers_in_order(memoryview(data))
    actor = Actor()
    wanted = {"mean": actor.mean, "inverse_std": actor.inverse_std}
    for index, layer in enumerate(actor.linear):
        wanted |= {
            f"layer {index} weight": layer.weight.data,
            f"layer {index} bias": layer.bias.data,
        }
    numbers = [array for array in used if array.ndim > 0]  # Without the two limits.
    shapes, expected = [a.shape for a in numbers], [tuple(t.shape) for t in wanted.values()]
    if shapes != expected:
        raise PolicyError(
            f"{where} is no network of a teacher: its numbers have shapes {shapes}",
            fix=f"they should be {expected}, in the order of use",
        )
    for tensor, array in zip(wanted.values(), numbers, strict=True):
        tensor.copy_(torch.from_numpy(array))
    return actor


def write_actor(actor: Actor) -> bytes:
    """Return the policy as an ONNX file, (1, 332) to (1, 12), normalisation and all."""
    graph = Graph()

    def numbers(tensor: torch.Tensor) -> str:
        return graph.constant(tensor.detach().cpu().numpy().astype(np.float32))

    low, high = (graph.constant(np.array(limit, dtype=np.float32)) for limit in (-LIMIT, LIMIT))
    x = graph.node("Sub", graph.input("obs", 1, OBSERVED), numbers(actor.mean))
    x = graph.node("Clip", graph.node("Mul", x, numbers(actor.inverse_std)), low, high)
    for layer in actor.linear:
        x = graph.node("Gemm", x, numbers(layer.weight), numbers(layer.bias), transB=1)
        if layer is not actor.linear[-1]:
            x = graph.node("Elu", x)
    return graph.model(x, 1, actor.linear[-1].out_features)


def _numbers_in_order(data: memoryview) -> list[NDArray[np.float32]]:
    """Return float32 initialisers in the order in which nodes use them."""
    reader = Reader(ONNX)
    graph = reader.read(reader.read(data, "Model").views("graph")[0], "Graph")
    tensors = [reader.read(view, "Tensor") for view in graph.views("initializer")]
    by_name = {tensor.text("name"): tensor for tensor in tensors}
    nodes = [reader.read(view, "Node") for view in graph.views("node")]
    names = [name for node in nodes for name in node.get("input", [])]
    return [_array(by_name[str(name)]) for name in names if str(name) in by_name]


def _array(tensor: ProtobufMessage) -> NDArray[np.float32]:
    shape = tuple(integers(tensor.get("dims", []), _AXES))
    raw = b"".join(tensor.views("raw_data"))
    if tensor.integer("data_type") != _FLOAT32 or len(raw) != 4 * math.prod(shape):
        raise PolicyError(
            f"a tensor {tensor.text('name')!r} of a policy is not plain float32",
            fix="export it with float32 weights",
        )
    return np.frombuffer(raw, dtype="<f4").reshape(shape).copy()
