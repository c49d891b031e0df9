"""ONNX files that mean harm, each made by a function: for tests, fuzzers and demonstrations.

All take 16 numbers, `obs`, and give 12, `action`, as the card that `bundle` writes wants them:
what is wrong with a file is its one fault.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from onnx import (
    AttributeProto,
    FunctionProto,
    GraphProto,
    ModelProto,
    NodeProto,
    SparseTensorProto,
    StringStringEntryProto,
    TensorProto,
    TrainingInfoProto,
    TypeProto,
    helper,
    numpy_helper,
)

FLOAT = TensorProto.FLOAT
CARD = """\
nw-policy: 1
name: crafted
robot: go1
adapter: onnx
checkpoint: {{file: policy.onnx, sha256: {digest}}}
control: {{action: joint_position_offset, scale: 0.25}}
observations:
  body: {{sensor: proprio, terms: [joint_pos]}}
  feet: {{sensor: proprio, terms: [foot_contacts]}}
"""


def bundle(folder: Path, data: bytes) -> Path:
    """Write a file and its card into a folder, which is returned."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "policy.onnx").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    (folder / "policy.yaml").write_text(CARD.format(digest=digest))
    return folder


def honest(
    *, nodes=(), constants=(), functions=(), domains=(), inputs=(), outputs=()
) -> ModelProto:
    """A linear policy: `sum` = obs @ weight, then `nodes`, the last of which makes `action`."""
    nodes = list(nodes) or [helper.make_node("Identity", ["sum"], ["action"])]
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weight"], ["sum"]), *nodes],
        "g",
        [helper.make_tensor_value_info("obs", FLOAT, [1, 16]), *inputs],
        [helper.make_tensor_value_info("action", FLOAT, [1, 12]), *outputs],
        [constant("weight", np.zeros((16, 12), np.float32)), *constants],
    )
    opsets = [helper.make_opsetid("", 17), *(helper.make_opsetid(name, 1) for name in domains)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=8, functions=list(functions))


def constant(name: str, value: object) -> TensorProto:
    return numpy_helper.from_array(np.asarray(value), name)


def value(name: str, shape: list[int], kind: int = FLOAT):
    return helper.make_tensor_value_info(name, kind, shape)


def function(name: str, *nodes: NodeProto, attributes=()) -> FunctionProto:
    """A function x -> y of the domain `local`."""
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("local", 1)]
    made = helper.make_function("local", name, ["x"], ["y"], list(nodes), opsets)
    made.attribute_proto.extend(attributes)
    return made


def calling(*functions: FunctionProto) -> bytes:
    """A model whose action passes through the last of some functions."""
    call = helper.make_node(functions[-1].name, ["sum"], ["action"], domain="local")
    return honest(nodes=[call], functions=functions, domains=["local"]).SerializeToString()


def elsewhere(place: str = "secret.bin", size: int = 12) -> TensorProto:
    """Numbers that lie in another file."""
    tensor = TensorProto(name="stolen", dims=[1, size], data_type=FLOAT, data_location=1)
    for key, text in (("location", place), ("offset", "0"), ("length", str(4 * size))):
        tensor.external_data.append(StringStringEntryProto(key=key, value=text))
    return tensor


def external_in_a_functions_default() -> bytes:
    taken = helper.make_node("Constant", [], ["c"])
    taken.attribute.append(
        AttributeProto(name="value", ref_attr_name="stolen", type=AttributeProto.TENSOR)
    )
    default = AttributeProto(name="stolen", type=AttributeProto.TENSOR, t=elsewhere())
    return calling(
        function("F", taken, helper.make_node("Add", ["x", "c"], ["y"]), attributes=[default])
    )


def external_in_an_attribute_list() -> bytes:
    node = helper.make_node("Identity", ["sum"], ["action"])
    node.attribute.append(
        AttributeProto(name="extra", type=AttributeProto.TENSORS, tensors=[elsewhere()])
    )
    return honest(nodes=[node]).SerializeToString()


def external_by_its_flag_alone() -> bytes:
    tensor = constant("c", np.zeros((1, 12), np.float32))
    tensor.data_location = TensorProto.EXTERNAL
    return adding(tensor)


def external_in_a_second_graph() -> bytes:
    # protobuf merges both graphs: a walker that looks at one of them misses the other.
    more = GraphProto(initializer=[elsewhere()])
    return honest().SerializeToString() + ModelProto(graph=more).SerializeToString()


def external_in_a_second_half_of_a_tensor() -> bytes:
    half = AttributeProto(t=elsewhere()).SerializeToString()
    whole = AttributeProto(
        name="value", type=AttributeProto.TENSOR, t=TensorProto(name="c")
    ).SerializeToString()
    node = NodeProto(op_type="Constant", output=["c"]).SerializeToString()
    node += _sized(5, whole + half)
    add = helper.make_node("Add", ["sum", "c"], ["action"])
    model = honest(nodes=[add])
    graph = model.graph.SerializeToString()
    model.ClearField("graph")
    return model.SerializeToString() + _sized(7, graph + _sized(1, node))


def adding(*constants: TensorProto, nodes=()) -> bytes:
    """A model that adds `c`, made of constants by nodes."""
    add = helper.make_node("Add", ["sum", "c"], ["action"])
    return honest(nodes=[*nodes, add], constants=constants).SerializeToString()


def sparse_weights() -> bytes:
    model = honest()
    model.graph.sparse_initializer.append(_sparse())
    return model.SerializeToString()


def sparse_constant() -> bytes:
    node = helper.make_node("Constant", [], ["c"], sparse_value=_sparse())
    return adding(nodes=[node])


def _sparse() -> SparseTensorProto:
    numbers, places = constant("s", np.ones(1, np.float32)), constant("i", np.zeros(1, np.int64))
    return SparseTensorProto(values=numbers, indices=places, dims=[2**20, 2**20])


def training_graph() -> bytes:
    model = honest()
    info = TrainingInfoProto(algorithm=GraphProto(initializer=[elsewhere()]))
    model.training_info.append(info)
    return model.SerializeToString()


def two_to_the_thirty_nodes() -> bytes:
    functions = [function("F0", helper.make_node("Identity", ["x"], ["y"]))]
    for level in range(1, 31):
        twice = [
            helper.make_node(f"F{level - 1}", ["x"], ["m"], domain="local"),
            helper.make_node(f"F{level - 1}", ["m"], ["y"], domain="local"),
        ]
        functions.append(function(f"F{level}", *twice))
    return calling(*functions)


def a_function_that_calls_itself() -> bytes:
    return calling(function("F", helper.make_node("F", ["x"], ["y"], domain="local")))


def functions_that_call_each_other() -> bytes:
    return calling(
        function("F", helper.make_node("G", ["x"], ["y"], domain="local")),
        function("G", helper.make_node("F", ["x"], ["y"], domain="local")),
    )


def a_chain_of_five_thousand_functions() -> bytes:
    functions = [function("F0", helper.make_node("Identity", ["x"], ["y"]))]
    for level in range(1, 5000):
        node = helper.make_node(f"F{level - 1}", ["x"], ["y"], domain="local")
        functions.append(function(f"F{level}", node))
    return calling(*functions)


def thirty_thousand_nodes() -> bytes:
    names = ["sum", *(f"n{i}" for i in range(30_000)), "action"]
    pairs = pairwise(names)
    nodes = [helper.make_node("Identity", [before], [after]) for before, after in pairs]
    return honest(nodes=nodes).SerializeToString()


def graphs_nested_a_thousand_times() -> bytes:
    graph = _sized(1, helper.make_node("Identity", ["sum"], ["r"]).SerializeToString())
    for _ in range(1000):
        branch = _sized(1, b"then_branch") + _sized(6, graph) + _number(20, AttributeProto.GRAPH)
        graph = _sized(1, _sized(1, b"flag") + _sized(4, b"If") + _sized(5, branch))
    model = honest()
    whole = model.graph.SerializeToString() + graph
    model.ClearField("graph")
    return model.SerializeToString() + _sized(7, whole)


def types_nested_a_thousand_times() -> bytes:
    kind = TypeProto(tensor_type=TypeProto.Tensor(elem_type=FLOAT)).SerializeToString()
    for _ in range(1000):
        kind = _sized(4, _sized(1, kind))
    model = honest()
    info = _sized(1, b"deep") + _sized(2, kind)
    whole = model.graph.SerializeToString() + _sized(13, info)
    model.ClearField("graph")
    return model.SerializeToString() + _sized(7, whole)


def an_input_of_two_to_the_forty() -> bytes:
    return honest(inputs=[value("more", [2**40])]).SerializeToString()


def an_input_of_minus_one() -> bytes:
    return honest(inputs=[value("more", [1, -1])]).SerializeToString()


def an_output_of_two_to_the_forty() -> bytes:
    return honest(outputs=[value("other", [2**40])]).SerializeToString()


def an_output_that_is_text() -> bytes:
    model = honest(constants=[constant("words", np.array(["a"] * 12, dtype=object))])
    model.graph.output[0].CopyFrom(value("words", [12], TensorProto.STRING))
    return model.SerializeToString()


def recurrent(shape: list[int]) -> bytes:
    """A policy with a state `h_in` to `h_out` of a shape."""
    node = helper.make_node("Identity", ["h_in"], ["h_out"])
    final = helper.make_node("Identity", ["sum"], ["action"])
    return honest(
        nodes=[node, final], inputs=[value("h_in", shape)], outputs=[value("h_out", shape)]
    ).SerializeToString()


def a_state_of_eight_gigabytes() -> bytes:
    return recurrent([1, 2**31])


def a_state_of_two_to_the_forty() -> bytes:
    return recurrent([2**20, 2**20])


def a_state_of_minus_one() -> bytes:
    return recurrent([1, -1])


def a_state_of_a_hundred_axes() -> bytes:
    return recurrent([1] * 100)


def names_that_are_not_utf8() -> bytes:
    return honest().SerializeToString().replace(b"obs", b"\xff\xfe\xfd")


def metadata_that_is_not_utf8() -> bytes:
    return honest().SerializeToString() + _sized(14, _sized(1, b"key") + _sized(2, b"\xff\xfe"))


def a_name_of_a_megabyte() -> bytes:
    return honest(inputs=[value("x" * 2**20, [1])]).SerializeToString()


def a_name_that_gives_orders() -> bytes:
    return honest(inputs=[value("x\n::error::lost\x1b[2J", [1])]).SerializeToString()


def an_operator_of_somebody_elses() -> bytes:
    node = helper.make_node("Evil\n::error::op", ["sum"], ["action"], domain="com.evil")
    return honest(nodes=[node], domains=["com.evil"]).SerializeToString()


def an_operator_that_reads_files() -> bytes:
    node = helper.make_node(
        "EPContext", ["sum"], ["action"], domain="com.microsoft", embed_mode=0,
        ep_cache_context="../secret.bin",
    )  # fmt: skip
    return honest(nodes=[node], domains=["com.microsoft"]).SerializeToString()


def an_unknown_field() -> bytes:
    return honest().SerializeToString() + _sized(99, b"x")


def six_hundred_thousand_fields() -> bytes:
    graph = honest().graph.SerializeToString() + _sized(12, b"") * 600_000
    return ModelProto(ir_version=8).SerializeToString() + _sized(7, graph)


def an_endless_loop() -> bytes:
    """`Loop` without a count and with a condition that stays true."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["go_on"]),
            helper.make_node("Identity", ["x"], ["x_next"]),
        ],
        "body",
        [
            value("i", [], TensorProto.INT64),
            value("go", [], TensorProto.BOOL),
            value("x", [1, 12]),
        ],
        [value("go_on", [], TensorProto.BOOL), value("x_next", [1, 12])],
    )
    node = helper.make_node("Loop", ["", "true", "sum"], ["action"], body=body)
    return honest(nodes=[node], constants=[constant("true", np.bool_(True))]).SerializeToString()


def eight_gigabytes_of_zeros() -> bytes:
    """A `ConstantOfShape` of 2^31 numbers, and their sum."""
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["zeros"]),
        helper.make_node("ReduceSum", ["zeros"], ["c"], keepdims=0),
    ]
    return adding(constant("shape", np.array([2**31])), nodes=nodes)


def _sized(number: int, data: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _number(number: int, count: int) -> bytes:
    return _varint(number << 3) + _varint(count)


def _varint(count: int) -> bytes:
    groups = bytearray()
    while count > 0x7F:
        groups.append(count & 0x7F | 0x80)
        count >>= 7
    return bytes([*groups, count])


LIMITED: dict[str, Callable[[], bytes]] = {
    made.__name__: made for made in (an_endless_loop, eight_gigabytes_of_zeros)
}
"""Right files by their form: only limits of time and memory stop what they compute."""

CRAFTED: dict[str, Callable[[], bytes]] = {
    made.__name__: made
    for made in (
        external_in_a_functions_default,
        external_in_an_attribute_list,
        external_by_its_flag_alone,
        external_in_a_second_graph,
        external_in_a_second_half_of_a_tensor,
        sparse_weights,
        sparse_constant,
        training_graph,
        two_to_the_thirty_nodes,
        a_function_that_calls_itself,
        functions_that_call_each_other,
        a_chain_of_five_thousand_functions,
        thirty_thousand_nodes,
        graphs_nested_a_thousand_times,
        types_nested_a_thousand_times,
        an_input_of_two_to_the_forty,
        an_input_of_minus_one,
        an_output_of_two_to_the_forty,
        an_output_that_is_text,
        a_state_of_eight_gigabytes,
        a_state_of_two_to_the_forty,
        a_state_of_minus_one,
        a_state_of_a_hundred_axes,
        names_that_are_not_utf8,
        metadata_that_is_not_utf8,
        a_name_of_a_megabyte,
        a_name_that_gives_orders,
        an_operator_of_somebody_elses,
        an_operator_that_reads_files,
        an_unknown_field,
        six_hundred_thousand_fields,
    )
} | LIMITED
"""Every file by its name."""
