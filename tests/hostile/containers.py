"""Checkpoints crafted by their container or their numbers: ONNX, TorchScript and torch.export.

Each takes 12 numbers and returns 12, as the card that `bundle` writes wants them; what is wrong
with it is its one fault. `CRAFTED` has a function for each, by kind and name.
"""

from __future__ import annotations

import hashlib
import io
import json
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

SUFFIXES = {"onnx": "onnx", "torchscript": "pt", "torch-export": "pt2"}
CARD = """\
nw-policy: 1
name: crafted
robot: go1
adapter: {adapter}
checkpoint: {{file: policy.{suffix}, sha256: {digest}}}
control: {{action: joint_position_offset, scale: 0.25}}
observations: {{obs: {{sensor: proprio, terms: [joint_pos]}}}}
"""
FLOAT = TensorProto.FLOAT


def bundle(folder: Path, adapter: str, data: bytes) -> Path:
    """Write a file and its card into a folder, which is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    suffix = SUFFIXES[adapter]
    (folder / f"policy.{suffix}").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    card = CARD.format(adapter=adapter, suffix=suffix, digest=digest)
    (folder / "policy.yaml").write_text(card)
    return folder


def network(fill: float | None = None, dtype: torch.dtype = torch.float32) -> torch.nn.Module:
    torch.manual_seed(0)
    layers = torch.nn.Sequential(torch.nn.Linear(12, 16), torch.nn.ELU(), torch.nn.Linear(16, 12))
    if fill is not None:
        for parameter in layers.parameters():
            parameter.data.fill_(fill)
    return layers.to(dtype).eval()


def scripted(module: torch.nn.Module, *, dtype: torch.dtype = torch.float32) -> bytes:
    packed = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.save(torch.jit.trace(module, torch.zeros(1, 12, dtype=dtype)), packed)
    return packed.getvalue()


def exported(module: torch.nn.Module, *, dtype: torch.dtype = torch.float32) -> bytes:
    packed = io.BytesIO()
    torch.export.save(torch.export.export(module, (torch.zeros(1, 12, dtype=dtype),)), packed)
    return packed.getvalue()


# What can be done to any archive of either format: bytes to bytes.


def repacked(data: bytes, change) -> bytes:
    """Pack an archive again, with its members changed: (name, content) pairs to the same."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    packed = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(packed, "w") as archive:
        warnings.simplefilter("ignore", UserWarning)
        for name, content in change(members):
            archive.writestr(zipfile.ZipInfo(name), content)
    return packed.getvalue()


def patched_sizes(data: bytes, size: int) -> bytes:
    """Say that the largest member has another size, in its header and in the directory."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        large = max(archive.infolist(), key=lambda info: info.file_size)
    changed = bytearray(data)
    name = large.filename.encode()
    for signature, field, length in ((b"PK\x03\x04", 22, 30), (b"PK\x01\x02", 24, 46)):
        place = changed.find(signature)
        while place >= 0:
            if changed[place + length : place + length + len(name)] == name:
                struct.pack_into("<I", changed, place + field, size)
            place = changed.find(signature, place + 4)
    return bytes(changed)


def overlapping(data: bytes) -> bytes:
    """Let all entries of the directory point at the first one's bytes."""
    changed = bytearray(data)
    place = changed.find(b"PK\x01\x02")
    while place >= 0:
        struct.pack_into("<I", changed, place + 42, 0)
        place = changed.find(b"PK\x01\x02", place + 4)
    return bytes(changed)


def bomb(data: bytes) -> bytes:
    """Pack the largest member as deflated zeros: 400 MB in half a megabyte."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    large = max(members, key=lambda member: len(member[1]))[0]
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, bytes(400_000_000) if name == large else content)
    return packed.getvalue()


def renamed(old: str, new: str):
    return lambda members: [(name.replace(old, new), content) for name, content in members]


def root_of(data: bytes) -> str:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return archive.namelist()[0].partition("/")[0]


def added(name: str, content: bytes = b"x"):
    return lambda members: [*members, (name, content)]


def rewritten(end: str, change):
    """Change the content of the members whose names end so."""
    return lambda members: [
        (name, change(content) if name.endswith(end) else content) for name, content in members
    ]


ARCHIVES = {
    "a member twice": lambda data: repacked(data, lambda members: [*members, members[-1]]),
    "a member twice, by case": lambda data: repacked(
        data, lambda members: [*members, (members[0][0].swapcase(), b"x")]
    ),
    "an absolute name": lambda data: repacked(data, added("/tmp/crafted")),
    "a name above": lambda data: repacked(data, added(f"{root_of(data)}/../../crafted")),
    "another root": lambda data: repacked(data, renamed(root_of(data) + "/", "other/../x/")),
    "a member of 4 GB by its header": lambda data: patched_sizes(data, 2**32 - 2),
    "a member of no bytes by its header": lambda data: patched_sizes(data, 0),
    "entries that overlap": overlapping,
    "a bomb": bomb,
    "no numbers": lambda data: repacked(
        data, lambda members: [member for member in members if "data/" not in member[0]]
    ),
    "a directory cut off": lambda data: data[:-30],
    "an archive behind noise": lambda data: b"MZ" + bytes(5000) + data,
    "two archives in one": lambda data: data + data,
    "fifty thousand members": lambda data: repacked(
        data,
        lambda members: [*members, *((f"{root_of(data)}/x/{n}", b"") for n in range(50_000))],
    ),
}


def graph_of(change) -> bytes:
    """Return an exported program whose graph, as JSON, is changed."""

    def rewrite(content: bytes) -> bytes:
        whole = json.loads(content)
        change(whole)
        return json.dumps(whole).encode()

    return repacked(exported(network()), rewritten(".json", lambda c: _quietly(rewrite, c)))


def _quietly(rewrite, content: bytes) -> bytes:
    try:
        return rewrite(content)
    except (KeyError, TypeError, IndexError, ValueError):  # Another of its files of JSON.
        return content


def nodes_of(whole):
    return whole["graph_module"]["graph"]["nodes"]


def cyclic(whole):
    first, last = nodes_of(whole)[0], nodes_of(whole)[-1]
    first["inputs"][0]["arg"] = {"as_tensor": dict(last["outputs"][0]["as_tensor"])}


def calls(target):
    def change(whole):
        nodes_of(whole)[0]["target"] = target

    return change


def of_sizes(size):
    def change(whole):
        for value in whole["graph_module"]["graph"]["tensor_values"].values():
            value["sizes"] = [{"as_int": size} for _ in value["sizes"]]

    return change


def longer(whole):
    nodes_of(whole).extend(nodes_of(whole)[:1] * 200_000)


def deeply(_whole) -> bytes:
    return b"[" * 200_000 + b"]" * 200_000


EXPORTED = {
    "a graph with a cycle": lambda: graph_of(cyclic),
    "an operator of Python's": lambda: graph_of(calls("builtins.eval")),
    "an operator that saves": lambda: graph_of(calls("torch.ops.aten.save.default")),
    "an operator of no library": lambda: graph_of(calls("torch.ops.evil.run.default")),
    "a name of operator with a path": lambda: graph_of(calls("torch.ops.../../x")),
    "tensors of 2^31": lambda: graph_of(of_sizes(2**31)),
    "tensors of less than nothing": lambda: graph_of(of_sizes(-1)),
    "two hundred thousand nodes": lambda: graph_of(longer),
    "JSON that is deep": lambda: repacked(exported(network()), rewritten(".json", deeply)),
    "JSON that is none": lambda: repacked(exported(network()), rewritten(".json", lambda _: b"{")),
    "numbers that are NaN": lambda: exported(network(float("nan"))),
    "numbers of 64 bits": lambda: exported(network(dtype=torch.float64), dtype=torch.float64),
}


class Wide(torch.nn.Module):
    def forward(self, x):
        return x.repeat(1, 134_217_728)[:, :12]


class Text(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> str:
        return "action" + str(x.shape[0])


class Whole(torch.nn.Module):
    def forward(self, x):
        return (x * 3).to(torch.int64)


class Endless(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        while bool(x.sum() > -1.0):
            x = x + 1.0
        return x


class Recurring(torch.nn.Module):
    """Doubles a list until there is no memory left."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        held = [x]
        for _ in range(60):
            held = held + held
        return held[0]


def _script(module) -> bytes:
    packed = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.save(torch.jit.script(module), packed)
    return packed.getvalue()


SCRIPTED = {
    "numbers that are NaN": lambda: scripted(network(float("nan"))),
    "numbers that are infinite": lambda: scripted(network(float("inf"))),
    "numbers of 64 bits": lambda: scripted(network(dtype=torch.float64), dtype=torch.float64),
    "an action that is text": lambda: _script(Text()),
    "an action of integers": lambda: _script(Whole()),
    "six gigabytes on the way": lambda: _script(Wide()),
    "a loop without an end": lambda: _script(Endless()),
    "a list without an end": lambda: _script(Recurring()),
    "code that is deep": lambda: repacked(
        scripted(network()),
        rewritten(".py", lambda code: code + b"# " + b"(" * 10**6),
    ),
    "code of four megabytes": lambda: repacked(
        scripted(network()), rewritten(".py", lambda code: code + b"\n# x" * 10**6)
    ),
    "code that is not text": lambda: repacked(
        scripted(network()), rewritten(".py", lambda code: b"\xff\xfe\x00" + code)
    ),
}


def model(nodes, constants=(), *, inputs=None, outputs=None, **more) -> bytes:
    graph = helper.make_graph(
        nodes,
        "g",
        inputs or [helper.make_tensor_value_info("obs", FLOAT, [1, 12])],
        outputs or [helper.make_tensor_value_info("action", FLOAT, [1, 12])],
        [numpy_helper.from_array(array, name) for name, array in dict(constants).items()],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], **more)
    made.ir_version = 9
    return made.SerializeToString()


def _linear(value: float) -> bytes:
    weight = np.full((12, 12), value, np.float32)
    return model([helper.make_node("MatMul", ["obs", "w"], ["action"])], {"w": weight})


def _expanding(size: int, axes: int) -> bytes:
    nodes = [
        helper.make_node("Expand", ["obs", "shape"], ["large"]),
        helper.make_node("ReduceMax", ["large"], ["action"], axes=list(range(axes)), keepdims=0),
    ]
    return model(nodes, {"shape": np.array([size] * axes + [1, 12], np.int64)})


def _external(location: str) -> bytes:
    made = onnx.ModelProto.FromString(_linear(1.0))
    tensor = made.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    for key, value in (("location", location), ("offset", "0"), ("length", "576")):
        entry = tensor.external_data.add()
        entry.key, entry.value = key, value
    return made.SerializeToString()


def _doubling(levels: int) -> bytes:
    """Nest branches that each hold the next twice: 2^levels nodes in some hundred bytes a level."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["obs"], ["out"])],
        "leaf",
        [],
        [helper.make_tensor_value_info("out", FLOAT, [1, 12])],
    )
    for level in range(levels):
        node = helper.make_node("If", ["yes"], ["out"], then_branch=body, else_branch=body)
        output = [helper.make_tensor_value_info("out", FLOAT, [1, 12])]
        body = helper.make_graph([node], f"level-{level}", [], output)
    node = helper.make_node("If", ["yes"], ["action"], then_branch=body, else_branch=body)
    return model([node], {"yes": np.array(True)})


ONNX = {
    "numbers that are NaN": lambda: _linear(float("nan")),
    "numbers that are infinite": lambda: _linear(float("inf")),
    "a graph with a cycle": lambda: model(
        [
            helper.make_node("Add", ["obs", "two"], ["one"]),
            helper.make_node("Add", ["one", "obs"], ["two"]),
            helper.make_node("Identity", ["two"], ["action"]),
        ]
    ),
    "a node that feeds itself": lambda: model(
        [helper.make_node("Add", ["obs", "action"], ["action"])]
    ),
    "a name given twice": lambda: model([helper.make_node("Identity", ["obs"], ["action"])] * 2),
    "a tensor of 2^31": lambda: _expanding(2**31, 1),
    "a tensor of 2^60 by two axes": lambda: _expanding(2**30, 2),
    "branches in branches, 2^12 nodes": lambda: _doubling(12),
    "numbers beside it": lambda: _external("weights.bin"),
    "numbers above it": lambda: _external("../../../etc/passwd"),
    "numbers in a device": lambda: _external("/dev/zero"),
    "an observation that is text": lambda: model(
        [helper.make_node("Identity", ["obs"], ["action"])],
        inputs=[helper.make_tensor_value_info("obs", TensorProto.STRING, [1, 12])],
        outputs=[helper.make_tensor_value_info("action", TensorProto.STRING, [1, 12])],
    ),
    "an action of 64 bits": lambda: model(
        [helper.make_node("Cast", ["obs"], ["action"], to=TensorProto.DOUBLE)],
        outputs=[helper.make_tensor_value_info("action", TensorProto.DOUBLE, [1, 12])],
    ),
    "an operator set of the future": lambda: model(
        [helper.make_node("Identity", ["obs"], ["action"])]
    ).replace(b"\x10\x11", b"\x10\x7f"),
    "an action of nothing": lambda: model(
        [helper.make_node("Slice", ["obs", "s", "e"], ["action"])],
        {"s": np.array([0, 0]), "e": np.array([1, 0])},
        outputs=[helper.make_tensor_value_info("action", FLOAT, [1, None])],
    ),
}


def _archives(make):
    return {
        name: lambda change=change: change(make(network())) for name, change in ARCHIVES.items()
    }


CRAFTED = {
    "onnx": ONNX,
    "torchscript": {**_archives(scripted), **SCRIPTED},
    "torch-export": {**_archives(exported), **EXPORTED},
}
