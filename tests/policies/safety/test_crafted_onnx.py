"""ONNX files that mean harm are refused before onnxruntime sees them; honest ones of every
exporter pass, and give the numbers that they gave."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import onnx_files
import onnxruntime as ort
import pytest
import torch
from onnx import helper, onnx_ml_pb2

from nw_base.errors import PolicyError
from nw_policies import load_bundle, open_policy
from nw_policies.drafting.checkpoint import inspect_checkpoint
from nw_policies.networks.onnx_graph import open_session
from nw_policies.safety import check_onnx
from nw_policies.safety.onnx import ONNX

REASONS = {
    "external_in_a_functions_default": "tensor 'stolen' lie in another file",
    "external_in_an_attribute_list": "tensor 'stolen' lie in another file",
    "external_by_its_flag_alone": "tensor 'c' lie in another file",
    "external_in_a_second_graph": "`graph` of Model comes twice",
    "external_in_a_second_half_of_a_tensor": "`t` of Attribute comes twice",
    "sparse_weights": "it has sparse tensors",
    "sparse_constant": "it has sparse tensors",
    "training_graph": "it has graphs for training",
    "two_to_the_thirty_nodes": "over 20000 nodes when its functions are written out",
    "a_function_that_calls_itself": "the function 'local::F' calls itself",
    "functions_that_call_each_other": "the function 'local::F' calls itself",
    "a_chain_of_five_thousand_functions": "over 64 functions call each other",
    "thirty_thousand_nodes": "it has over 20000 nodes",
    "graphs_nested_a_thousand_times": "nested too deeply",
    "types_nested_a_thousand_times": "nested too deeply",
    "an_input_of_two_to_the_forty": "inputs are declared to be over 16777216 numbers",
    "an_input_of_minus_one": "input 'more' has the shape 1 x -1",
    "an_output_of_two_to_the_forty": "outputs are declared to be over 16777216 numbers",
    "an_output_that_is_text": "output 'words' is text",
    "a_state_of_eight_gigabytes": "inputs are declared to be over",
    "a_state_of_two_to_the_forty": "inputs are declared to be over",
    "a_state_of_minus_one": "input 'h_in' has the shape 1 x -1",
    "a_state_of_a_hundred_axes": "input 'h_in' has the shape 1 x 1",
    "names_that_are_not_utf8": "`name` of ValueInfo is not UTF-8",
    "metadata_that_is_not_utf8": "`value` of Entry is not UTF-8",
    "a_name_of_a_megabyte": "`name` of ValueInfo has 1048576 bytes, over 2048",
    "an_operator_of_somebody_elses": "operator 'com.evil::Evil ::error::op'",
    "an_operator_that_reads_files": "operator 'com.microsoft::EPContext'",
    "an_unknown_field": "field 99 of Model is unknown",
    "six_hundred_thousand_fields": "more than 500000 fields",
}


@pytest.mark.parametrize("name", REASONS)
def test_a_file_that_means_harm_is_refused_in_one_clean_line(name):
    with pytest.raises(PolicyError, match=REASONS[name]) as caught:
        check_onnx(onnx_files.CRAFTED[name](), "policy.onnx")
    text = str(caught.value)
    assert text.startswith("policy.onnx: ")
    assert text.isprintable()
    assert len(text) < 400


def test_every_crafted_file_is_tried():
    odd = {"a_name_that_gives_orders"}
    assert onnx_files.CRAFTED.keys() == REASONS.keys() | onnx_files.LIMITED.keys() | odd


def test_a_name_that_gives_orders_gives_none_in_an_error(tmp_path):
    bundle = load_bundle(onnx_files.bundle(tmp_path, onnx_files.a_name_that_gives_orders()))
    with pytest.raises(PolicyError, match=r"the checkpoint has 2 inputs: obs, x") as caught:
        open_policy(bundle)
    assert str(caught.value).isprintable()


def test_what_only_limits_can_stop_is_right_by_its_form():
    for made in onnx_files.LIMITED.values():
        data = made()
        check_onnx(data, "policy.onnx")
        # Opening computes nothing of it: there is no need to open it otherwise than right files.
        assert [node.name for node in open_session(data).get_inputs()] == ["obs"]


def test_no_door_opens_a_crafted_file(tmp_path):
    (tmp_path / "secret.bin").write_bytes(bytes(48))
    for name in ("external_in_a_functions_default", "names_that_are_not_utf8"):
        folder = onnx_files.bundle(tmp_path / name, onnx_files.CRAFTED[name]())
        with pytest.raises(PolicyError, match=REASONS[name]):
            open_policy(load_bundle(folder))
        with pytest.raises(PolicyError, match=REASONS[name]):
            inspect_checkpoint(folder / "policy.onnx")


def test_every_field_of_the_format_is_known_or_refused():
    # The format's own definition, as the onnx package compiles it.
    names = {
        "TypeProto.Tensor": "TensorType", "TypeProto.Sequence": "Element",
        "TypeProto.Optional": "Element", "TensorShapeProto": "Shape",
        "TensorShapeProto.Dimension": "Dim", "OperatorSetIdProto": "Opset",
        "StringStringEntryProto": "Entry", "TensorAnnotation": "Annotation",
    }  # fmt: skip
    left_out = {
        ("Model", "configuration"), ("Node", "device_configurations"),
        ("Type", "map_type"), ("Type", "opaque_type"), ("Type", "sparse_tensor_type"),
    }  # fmt: skip

    def ours_of(descriptor):
        name = descriptor.full_name.removeprefix("onnx.")
        return names.get(name, name.removesuffix("Proto"))

    seen = set()

    def compare(descriptor):
        kind = ours_of(descriptor)
        if kind in seen:
            return
        seen.add(kind)
        assert ONNX[kind].keys() <= {field.number for field in descriptor.fields}
        for field in descriptor.fields:
            if field.number not in ONNX[kind]:
                assert (kind, field.name) in left_out
                continue
            known = ONNX[kind][field.number]
            assert (known.name, known.many) == (field.name, field.is_repeated)
            if known.kind in ONNX:
                assert known.kind == ours_of(field.message_type)
                compare(field.message_type)
            elif field.message_type is not None:
                assert known.kind == "bytes"  # Refused wherever it stands.
            else:
                wires = {"text": 9, "name": 9, "bytes": 12, "float": 2, "double": 1}
                assert field.type == wires.get(known.kind, field.type)
                assert (known.kind == "int") == (field.type in {3, 4, 5, 14})

    compare(onnx_ml_pb2.ModelProto.DESCRIPTOR)
    assert seen == ONNX.keys()


def test_mutants_raise_no_other_error():
    rng = np.random.default_rng(9)
    seeds = [
        onnx_files.CRAFTED[name]()
        for name in ("external_in_a_functions_default", "an_endless_loop", "sparse_constant")
    ]
    refused = 0
    for _ in range(1500):
        data = bytearray(seeds[rng.integers(len(seeds))])
        for _ in range(rng.integers(1, 5)):
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        try:
            check_onnx(bytes(data[: rng.integers(1, len(data) + 1)]), "policy.onnx")
        except PolicyError as error:
            refused += str(error).isprintable()
    assert refused > 1000


class Recurrent(torch.nn.Module):
    def __init__(self, kind):
        super().__init__()
        self.memory = kind(16, 8)
        self.head = torch.nn.Sequential(torch.nn.Linear(8, 12), torch.nn.ELU())

    def forward(self, obs):
        return self.head(self.memory(obs.unsqueeze(0))[0].squeeze(0))


class Branches(torch.nn.Module):
    """A loop and a branch, which the exporter writes as `Loop` and `If`."""

    def forward(self, obs: torch.Tensor, steps: torch.Tensor) -> torch.Tensor:
        action = obs[:, :12]
        for _ in range(int(steps)):
            action = action * 0.5
        if bool(action.sum() > 0):
            action = action + 1
        return action


@pytest.mark.parametrize("kind", [torch.nn.LSTM, torch.nn.GRU, torch.nn.RNN])
def test_recurrent_exports_pass(kind, tmp_path):
    torch.manual_seed(0)
    module = Recurrent(kind).eval()
    obs = torch.randn(1, 16)
    data = exported(module, (obs,), tmp_path, ["obs"])
    (action,) = open_session(data).run(None, {"obs": obs.numpy()})
    assert np.allclose(action, module(obs).detach().numpy(), atol=1e-6)


def test_loops_and_branches_pass(tmp_path):
    module = torch.jit.script(Branches())
    obs, steps = torch.ones(1, 16), torch.tensor(3)
    data = exported(module, (obs, steps), tmp_path, ["obs", "steps"])
    assert b"Loop" in data
    assert b"If" in data
    (action,) = open_session(data).run(None, {"obs": obs.numpy(), "steps": steps.numpy()})
    assert action.tolist() == [[1.125] * 12]


def exported(module, inputs, folder, names) -> bytes:
    path = folder / "exported.onnx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(module, inputs, path, input_names=names, dynamo=False)
    data = path.read_bytes()
    check_onnx(data, "exported.onnx")
    return data


def test_functions_and_optimised_files_pass(tmp_path):
    inner = onnx_files.function("F", helper.make_node("Relu", ["x"], ["y"]))
    outer = onnx_files.function(
        "G",
        helper.make_node("F", ["x"], ["m"], domain="local"),
        helper.make_node("Tanh", ["m"], ["y"]),
    )
    check_onnx(onnx_files.calling(inner, outer), "policy.onnx")
    gelu = helper.make_node("Gelu", ["sum"], ["action"], domain="com.microsoft")
    data = onnx_files.honest(nodes=[gelu], domains=["com.microsoft"]).SerializeToString()
    check_onnx(data, "policy.onnx")
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_EXTENDED
    options.optimized_model_filepath = str(tmp_path / "optimised.onnx")
    policy = Path(__file__).parents[3] / "policies/go1-parkour/policy.onnx"
    ort.InferenceSession(policy.read_bytes(), options, providers=["CPUExecutionProvider"])
    check_onnx((tmp_path / "optimised.onnx").read_bytes(), "optimised.onnx")


def test_onnxruntime_tells_nobody_and_writes_nothing(tmp_path):
    folder = onnx_files.bundle(tmp_path / "bundle", onnx_files.honest().SerializeToString())
    code = (
        "from dataclasses import replace; from pathlib import Path;"
        "from nw_policies import load_bundle, open_policy;"
        f"bundle = load_bundle(Path({str(folder)!r}));"
        "card = bundle.card.model_copy(update={'runtime': 'native'});"
        "open_policy(replace(bundle, card=card));"
        "from nw_policies.drafting.checkpoint import inspect_checkpoint;"
        f"inspect_checkpoint(Path({str(folder / 'policy.onnx')!r}));"
        "import os; print(os.environ['ORT_DISABLE_TELEMETRY'])"
    )
    home = tmp_path / "home"
    home.mkdir()
    env = {name: text for name, text in os.environ.items() if not name.startswith(("XDG", "ORT"))}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=env | {"HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "1"
    # Its device id and a database of events would lie in the cache folder.
    assert [path for path in home.rglob("*") if path.is_file()] == []
