"""State dicts and safetensors: the same tensors that torch reads."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
import pytest
import torch

from nw_base.errors import PolicyError
from nw_policies.safety import FileLimits, file_kind, read_tensors, tensor_facts, tensors_below


def saved(value: object) -> bytes:
    buffer = io.BytesIO()
    torch.save(value, buffer)
    return buffer.getvalue()


def training_checkpoint() -> dict[str, object]:
    """What rsl_rl and its relatives write: modules, an optimiser with state, counters, None."""
    module = torch.nn.Sequential(torch.nn.Linear(5, 4), torch.nn.BatchNorm1d(4))
    optimizer = torch.optim.Adam(module.parameters())
    module(torch.randn(3, 5)).sum().backward()
    optimizer.step()
    return {
        "model_state_dict": module.state_dict(),
        "optimizer_state_dict": optimizer.state_dict(),
        "iter": 1500,
        "infos": None,
        "best": -1.5,
        "tags": ["a", ("b", True)],
    }


def flattened(value: object, name: str = "") -> dict[str, torch.Tensor]:
    if isinstance(value, torch.Tensor):
        return {name: value}
    pairs = value.items() if isinstance(value, dict) else ()
    if isinstance(value, list | tuple):
        pairs = enumerate(value)
    found: dict[str, torch.Tensor] = {}
    for key, item in pairs:
        found |= flattened(item, f"{name}.{key}" if name else str(key))
    return found


def test_a_training_checkpoint_reads_as_torch_reads_it():
    data = saved(training_checkpoint())
    ours = read_tensors(data, "model.pt")
    theirs = flattened(torch.load(io.BytesIO(data), weights_only=True))
    assert list(ours) == list(theirs)
    for name, tensor in theirs.items():
        assert ours[name].dtype == tensor.dtype
        assert torch.equal(ours[name], tensor)
    assert "optimizer_state_dict.state.0.exp_avg" in ours
    assert list(tensors_below(ours, "model_state_dict.0.")) == ["weight", "bias"]


@pytest.mark.parametrize(
    "dtype",
    [
        torch.float64,
        torch.float16,
        torch.bfloat16,
        torch.int64,
        torch.int8,
        torch.uint8,
        torch.bool,
    ],
)
def test_every_type_of_number_survives(dtype):
    tensor = torch.arange(12).reshape(3, 4).to(dtype)
    ours = read_tensors(saved({"x": tensor, "scalar": tensor[1, 2]}), "x.pt")
    assert torch.equal(ours["x"], tensor)
    assert torch.equal(ours["scalar"], tensor[1, 2])


def test_views_parameters_and_empty_tensors_are_read_as_tensors_of_their_own():
    base = torch.arange(24.0).reshape(4, 6)
    value = {
        "transposed": base.T,
        "strided": base[::2, 1::3],
        "parameter": torch.nn.Parameter(base[1]),
        "empty": torch.zeros(0, 5),
        "expanded": torch.ones(1).expand(7),
    }
    ours = read_tensors(saved(value), "x.pt")
    for name, tensor in value.items():
        assert torch.equal(ours[name], tensor)
    ours["strided"].zero_()
    assert torch.equal(ours["transposed"], base.T)


def test_facts_are_those_of_the_tensors():
    facts = tensor_facts(saved({"a": {"w": torch.zeros(3, 4)}, "n": torch.tensor(3)}), "x.pt")
    assert [(f.name, f.shape, f.dtype) for f in facts] == [
        ("a.w", (3, 4), "float32"),
        ("n", (), "int64"),
    ]


def safetensors(**arrays: np.ndarray) -> bytes:
    header, body = {"__metadata__": {"format": "pt"}}, b""
    for name, array in arrays.items():
        header[name] = {
            "dtype": {"f4": "F32", "i8": "I64"}[array.dtype.str[1:]],
            "shape": list(array.shape),
            "data_offsets": [len(body), len(body) + array.nbytes],
        }
        body += array.tobytes()
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + body


def test_safetensors_are_read():
    weight = np.arange(6, dtype=np.float32).reshape(2, 3)
    data = safetensors(weight=weight, step=np.array(7))
    assert file_kind(data, "x") == "safetensors"
    ours = read_tensors(data, "x.safetensors")
    assert torch.equal(ours["weight"], torch.from_numpy(weight))
    assert ours["step"].item() == 7
    with pytest.raises(PolicyError, match=r"'step'.*not where the header puts it"):
        read_tensors(data[:-4], "x.safetensors")


def test_safetensors_that_share_bytes_or_a_name_are_refused():
    def file(header):
        text = json.dumps(header) if isinstance(header, dict) else header
        return len(text).to_bytes(8, "little") + text.encode() + bytes(16)

    def at(first, end):
        return {"dtype": "F32", "shape": [(end - first) // 4], "data_offsets": [first, end]}

    apart = file({"a": at(0, 8), "none": at(8, 8), "b": at(8, 16)})
    assert set(read_tensors(apart, "x")) == {"a", "none", "b"}
    for first, end in ((4, 12), (0, 8), (0, 4)):
        with pytest.raises(PolicyError, match=r"tensors '[ab]' and '[ab]' share bytes"):
            tensor_facts(file({"a": at(0, 8), "b": at(first, end)}), "x")
    one = json.dumps({"a": at(0, 8)})
    with pytest.raises(PolicyError, match="header is damaged: it has 'a' twice"):
        tensor_facts(file(one[:-1] + ", " + one[1:]), "x")


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (FileLimits(file_bytes=1000), "over the limit of 0 MiB"),
        (FileLimits(members=3), "members, over the limit of 3"),
        (FileLimits(unpacked_bytes=1000), "unpacks to"),
        (FileLimits(tensor_bytes=1000), "tensors up to 'b'"),
        (FileLimits(index_bytes=50), "'data.pkl' has"),
    ],
)
def test_each_limit_is_kept(limits, reason):
    data = saved({"a": torch.zeros(200), "b": torch.zeros(200)})
    with pytest.raises(PolicyError, match=reason):
        read_tensors(data, "x.pt", limits)


def test_other_formats_are_named():
    module = torch.jit.script(torch.nn.Linear(3, 2))
    buffer = io.BytesIO()
    torch.jit.save(module, buffer)
    with pytest.raises(PolicyError, match="not a state dict: it is a TorchScript file"):
        read_tensors(buffer.getvalue(), "policy.pt")
    with pytest.raises(PolicyError, match="not a state dict: it is an ONNX graph"):
        read_tensors(b"\x08\x08\x12\x07pytorch", "policy.onnx")
