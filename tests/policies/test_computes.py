"""Starts are drawn by what a policy computes: a re-export of the same network meets the same."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from nw_base.files.shipped import shipped
from nw_eval.engine.identity import policy_info
from nw_gate.results.provenance import PolicyInfo
from nw_policies import load_bundle
from nw_policies.computes import computed_digest

if TYPE_CHECKING:
    from collections.abc import Callable

SHIPPED = shipped("policies") / "go1-parkour"


def key_of(folder: Path, weights: bytes, card: Callable[[str], str] = str) -> PolicyInfo:
    """Return what run.json says of go1-parkour with other weights and another card."""
    folder.mkdir()
    text = (SHIPPED / "policy.yaml").read_text(encoding="utf-8")
    (folder / "policy.yaml").write_text(card(text), encoding="utf-8")
    (given := folder / "other.onnx").write_bytes(weights)
    shutil.copy(SHIPPED / "policy.onnx", folder)
    return policy_info(load_bundle(folder / "policy.yaml", checkpoint=given))


def model() -> onnx.ModelProto:
    return onnx.load(SHIPPED / "policy.onnx")


def producer(other: onnx.ModelProto) -> None:
    other.producer_name, other.producer_version = "another exporter", "9.9"
    other.doc_string = other.graph.doc_string = "exported again"
    other.model_version += 1
    helper.set_model_props(other, {"date": "2026-11-26"})
    for node in other.graph.node:
        node.doc_string = "a line of Python"


def names(other: onnx.ModelProto) -> None:
    fixed = {value.name for value in (*other.graph.input, *other.graph.output)}

    def renamed(name: str) -> str:
        return name if name in fixed or not name else f"again/{name}"

    other.graph.name = "again"
    for number, node in enumerate(other.graph.node):
        node.name = f"node {number}"
        node.input[:] = [renamed(name) for name in node.input]
        node.output[:] = [renamed(name) for name in node.output]
    for tensor in other.graph.initializer:
        tensor.name = renamed(tensor.name)
    del other.graph.value_info[:]


def typed_numbers(other: onnx.ModelProto) -> None:
    stored = 0
    for tensor in other.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT and tensor.HasField("raw_data"):
            numbers = numpy_helper.to_array(tensor)
            tensor.ClearField("raw_data")
            tensor.float_data.extend(numbers.ravel().tolist())
            stored += 1
    assert stored


def order_of_weights(other: onnx.ModelProto) -> None:
    backwards = list(other.graph.initializer)[::-1]
    del other.graph.initializer[:]
    other.graph.initializer.extend(backwards)


def unused_operators(other: onnx.ModelProto) -> None:
    other.opset_import.append(helper.make_opsetid("ai.onnx.ml", 3))


@pytest.mark.parametrize(
    "change", [producer, names, typed_numbers, order_of_weights, unused_operators]
)
def test_a_re_export_of_the_same_network_has_the_same_key(
    tmp_path: Path, change: Callable[[onnx.ModelProto], None]
) -> None:
    original = (SHIPPED / "policy.onnx").read_bytes()
    change(other := model())
    onnx.checker.check_model(other)
    first, again = (
        key_of(tmp_path / "a", original),
        key_of(tmp_path / "b", other.SerializeToString()),
    )
    assert again.checkpoint_digest != first.checkpoint_digest, "another file"
    assert again.key == first.key != ""


def test_a_weight_that_differs_by_a_millionth_gives_another_key(tmp_path: Path) -> None:
    other = model()
    tensor = next(each for each in other.graph.initializer if each.data_type == TensorProto.FLOAT)
    numbers = numpy_helper.to_array(tensor).copy()
    numbers.flat[0] += np.float32(1e-6)
    tensor.CopyFrom(numpy_helper.from_array(numbers, tensor.name))
    first = key_of(tmp_path / "a", (SHIPPED / "policy.onnx").read_bytes())
    assert key_of(tmp_path / "b", other.SerializeToString()).key != first.key


def test_the_meaning_of_the_card_counts_and_its_title_does_not(tmp_path: Path) -> None:
    weights = (SHIPPED / "policy.onnx").read_bytes()
    first = key_of(tmp_path / "a", weights)

    def title(text: str) -> str:
        lines = [line for line in text.splitlines() if not line.startswith("title:")]
        return "\n".join(["# A comment.", *lines, "title: Another title."]) + "\n"

    def name(text: str) -> str:
        return text.replace("name: go1-parkour", "name: go1-again")

    def other(old: str, new: str) -> Callable[[str], str]:
        return lambda text: text.replace(old, new, 1)

    assert key_of(tmp_path / "b", weights, title).key == first.key
    assert key_of(tmp_path / "c", weights, name).key == first.key
    action = key_of(tmp_path / "d", weights, other("scale: 0.25", "scale: 0.26"))
    history = key_of(tmp_path / "e", weights, other("newest_first", "oldest_first"))
    robot = key_of(tmp_path / "f", weights, other("robot: go1", "robot: go2"))
    assert len({each.key for each in (first, action, history, robot)}) == 4


def test_a_run_of_an_older_version_is_drawn_by_its_files(tmp_path: Path) -> None:
    info = key_of(tmp_path / "a", (SHIPPED / "policy.onnx").read_bytes())
    older = PolicyInfo.model_validate(info.model_dump(exclude={"computes"}))
    assert older.key == f"{info.checkpoint_digest}/{info.card_digest}"


def graph(*nodes: onnx.NodeProto, inputs: str = "ab", **more: Any) -> bytes:
    def value(name: str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3])

    made = helper.make_graph(list(nodes), "g", [value(i) for i in inputs], [value("out")], **more)
    return helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)]).SerializeToString()


def test_what_is_connected_to_what_counts() -> None:
    one = graph(helper.make_node("Sub", ["a", "b"], ["out"]))
    assert computed_digest(one) == computed_digest(one) != ""
    others = [
        graph(helper.make_node("Sub", ["b", "a"], ["out"])),
        graph(helper.make_node("Sub", ["a", "b"], ["out"]), inputs="ba"),
        graph(helper.make_node("Sub", ["a", "a"], ["out"])),
        graph(helper.make_node("Add", ["a", "b"], ["out"])),
        graph(helper.make_node("Sub", ["c", "b"], ["out"]), inputs="cb"),
    ]
    digests = {computed_digest(each) for each in (one, *others)}
    assert len(digests) == 6, "with two inputs their names say which is which"
    longer = helper.make_node("Concat", ["a", "b"], ["out"], axis=1)
    assert computed_digest(graph(longer)) != computed_digest(
        graph(helper.make_node("Concat", ["a", "b"], ["out"], axis=0))
    )


def test_the_order_of_nodes_that_do_not_wait_for_each_other_means_nothing() -> None:
    left = helper.make_node("Neg", ["a"], ["x"])
    right = helper.make_node("Abs", ["b"], ["y"])
    both = helper.make_node("Add", ["x", "y"], ["out"])
    assert computed_digest(graph(left, right, both)) == computed_digest(graph(right, left, both))


def test_a_branch_inside_a_node_counts_with_the_values_that_it_takes_from_outside() -> None:
    def branched(source: str, inner: str) -> bytes:
        def branch(operator: str) -> onnx.GraphProto:
            out = helper.make_tensor_value_info(inner, TensorProto.FLOAT, [1, 3])
            return helper.make_graph(
                [helper.make_node(operator, [source], [inner])], "b", [], [out]
            )

        yes = helper.make_tensor("yes", TensorProto.BOOL, [], [True])
        node = helper.make_node(
            "If", ["yes"], ["out"], then_branch=branch("Neg"), else_branch=branch("Abs")
        )
        return graph(node, initializer=[yes])

    assert computed_digest(branched("a", "x")) == computed_digest(branched("a", "other")) != ""
    assert computed_digest(branched("b", "x")) != computed_digest(branched("a", "x"))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x08\x08",
        b"\x08\x08\x3a\x02\xff\xff",
        b"no network at all",
        b"PK\x03\x04 cut off",
        (2**62).to_bytes(8, "little") + b"{",
        (4).to_bytes(8, "little") + b"{ 4}",
        graph(helper.make_node("Neg", ["nowhere"], ["out"])),
        graph(helper.make_node("RandomNormalLike", ["a"], ["out"])),
        (SHIPPED / "policy.onnx").read_bytes()[:-1000],
    ],
)
def test_a_file_that_cannot_be_read_counts_with_its_own_digest(tmp_path: Path, data: bytes) -> None:
    assert computed_digest(data) == ""
    one, other = key_of(tmp_path / "a", data), key_of(tmp_path / "b", data + b"\0")
    assert one.computes
    assert one.key != other.key


class Net(torch.nn.Module):
    def __init__(self, weight: float = 0.5) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.ELU())
        with torch.no_grad():
            for parameter in self.parameters():
                parameter.fill_(weight)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.layers(x)


class Again(Net):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.layers(x)


X = torch.zeros(1, 3)


def exported(folder: Path, name: str, program: Any) -> bytes:
    torch.export.save(program, folder / name)
    return (folder / name).read_bytes()


def scripted(folder: Path, name: str, script: Any) -> bytes:
    script.save(str(folder / name))
    return (folder / name).read_bytes()


def test_torch_files_of_one_network_agree_and_of_another_do_not(tmp_path: Path) -> None:
    traced = scripted(tmp_path, "first.pt", torch.jit.trace(Net(), X))
    again = scripted(tmp_path, "again.pt", torch.jit.trace(Net(), X))
    assert traced != again, "another name, and other numbers of classes"
    assert computed_digest(traced) == computed_digest(again) != ""
    resaved = scripted(tmp_path, "resaved.pt", torch.jit.load(tmp_path / "first.pt"))
    assert computed_digest(resaved) == computed_digest(traced)
    other = scripted(tmp_path, "other.pt", torch.jit.trace(Net(0.500001), X))
    assert computed_digest(other) != computed_digest(traced)

    program = exported(tmp_path, "first.pt2", torch.export.export(Net(), (X,)))
    again = exported(tmp_path, "again.pt2", torch.export.export(Again(), (X,)))
    assert program != again, "its stack traces name other lines and classes"
    assert computed_digest(program) == computed_digest(again) != ""
    changed = exported(tmp_path, "other.pt2", torch.export.export(Net(0.6), (X,)))
    assert computed_digest(changed) != computed_digest(program)


def test_a_pickle_that_would_grow_without_end_is_read_in_little_memory() -> None:
    text = b"x" * 1_000_000
    pickled = b"\x80\x02X" + len(text).to_bytes(4, "little") + text + b"q\x00" + b"h\x00" * 300_000
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name, content in (("data.pkl", pickled + b"."), ("constants.pkl", b"\x80\x02).")):
            archive.writestr(f"a/{name}", content)
    assert len(computed_digest(data.getvalue())) == 64, "written out it has 300 GB"


def safetensors(tensors: dict[str, list[float]], **metadata: str) -> bytes:
    header: dict[str, Any] = {"__metadata__": metadata} if metadata else {}
    body = b""
    for name, numbers in tensors.items():
        part = np.array(numbers, dtype="<f4").tobytes()
        place = [len(body), len(body) + len(part)]
        header[name] = {"dtype": "F32", "shape": [len(numbers)], "data_offsets": place}
        body += part
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + body


def test_metadata_of_safetensors_means_nothing_and_names_of_tensors_do() -> None:
    plain = safetensors({"w": [1.0, 2.0], "b": [0.0]})
    same = [
        safetensors({"w": [1.0, 2.0], "b": [0.0]}, date="2026-11-26"),
        safetensors({"b": [0.0], "w": [1.0, 2.0]}),
    ]
    others = [
        safetensors({"w": [1.0, 2.0], "c": [0.0]}),
        safetensors({"w": [1.0, 2.0], "b": [0.5]}),
    ]
    assert computed_digest(plain) != ""
    assert {computed_digest(each) for each in same} == {computed_digest(plain)}
    assert len({computed_digest(each) for each in (plain, *others)}) == 3
