"""TorchScript files that attack: none runs anything, none reaches torch's loader."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch
from torchscript import CRAFTED, HONEST, PRINTS, saying, write_bundle

from nw_eval.errors import PolicyError, TrialError
from nw_eval.policies import load_bundle, open_policy

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

SAID = {
    "saves a file": r"\.py:\d+: it calls `torch\.save`",
    "maps a file": r"\.py:\d+: it calls `torch\.from_file`",
    "saves a file, hidden by case": "a member 'CODE/__torch__.*such a file does not have",
    "maps a file, hidden by case": "a member 'CODE/__torch__",
    "saves a file while it is opened": r"\.py:\d+: it defines `__setstate__`, which would run",
    "saves a file while it is opened, hidden by case": "a member 'CODE/__torch__",
    "maps a file while it is opened, hidden by case": "a member 'CODE/__torch__",
    "reads outside its storage": "calls `ops.inductor._reinterpret_tensor`",
    "reads outside its storage while it is opened": "defines `__setstate__`",
    "tells an address": "calls `ops.mkldnn.data_ptr`",
    "believes any size": "calls `torch._reshape_alias`",
    "shows memory that nobody wrote": "calls `torch.empty_like`",
    "has numbers on a device without any": "names the device .*meta.*on the CPU",
    "resizes by a method": "calls `x.resize_`",
    "resizes by a method of its own name": "does `aten::resize_`",
    "calls by another name": "`torch.*` is not TorchScript's",
    "renames the namespace": "`torch` is not TorchScript's",
    "calls in a default": r"`torch\.from_file\(.*\)` is not a plain value",
    "has a class of a library": "`__torch__.torch.classes.quantized.*` is not in the file",
    "forks": "statement FunctionDef",
    "is no script": "statement Import",
    "is nested deeply": "brackets are nested too deeply",
    "is chained deeply": "nested too deeply|it is not TorchScript",
    "lies about a tensor": "claims 800 bytes, the file holds 16",
    "lies about a tensor, hidden by case": "appears twice but for its case",
    "lies about a tensor, hidden by roots": "do not lie in one folder",
    "is for another interpreter": "mobile interpreter",
    "brings a member of its own": "a member 'attributes.pkl'",
}


# The one that only torch's types tell from a method of the file's own.
COMPILED = "resizes by a method of its own name"


def test_every_crafted_file_has_an_answer():
    assert set(SAID) == set(CRAFTED)


@pytest.mark.parametrize("name", CRAFTED)
def test_a_crafted_script_is_refused_and_nothing_of_it_runs(name, tmp_path, monkeypatch):
    bundle = load_bundle(write_bundle(tmp_path / "policy", CRAFTED[name]()))
    monkeypatch.chdir(tmp_path)
    if name != COMPILED:
        # None: whatever would call it fails.
        monkeypatch.setattr(torch._C, "import_ir_module_from_buffer", None)
    with pytest.raises(PolicyError, match=SAID[name]) as caught:
        open_policy(bundle)
    assert str(caught.value).startswith(str(tmp_path / "policy" / "policy.pt: "))
    assert len(str(caught.value).splitlines()) == 1
    assert caught.value.fix
    assert [path.name for path in tmp_path.iterdir()] == ["policy"]


def test_what_a_script_prints_is_left_out(tmp_path, capfd):
    policy = open_policy(load_bundle(write_bundle(tmp_path, PRINTS())))
    action = policy.act({"body": np.arange(12, dtype=np.float32)})
    assert action.tolist() == [2.0 * k for k in range(12)]
    said = capfd.readouterr()
    assert "forged" not in said.out + said.err


def test_what_a_script_raises_is_one_harmless_line(tmp_path):
    raising = saying(
        f'ops.prim.RaiseException("no\\n::error::\\033[31m", "builtins.ValueError")\n{HONEST}'
    )
    policy = open_policy(load_bundle(write_bundle(tmp_path, raising())))
    with pytest.raises(TrialError) as caught:
        policy.act({"body": np.zeros(12, np.float32)})
    assert re.fullmatch(r"[ -~]+", str(caught.value))
    assert "\n::error" not in str(caught.value)


WRONG_SIZES = {
    "lstm": (
        "_1, _2, _3 = torch.lstm(torch.zeros([2, 1, 3]), [h, h], "
        "[torch.ones([2, 3]), torch.ones([2, 5]), torch.ones([2]), torch.ones([2])], "
        "True, 1, 0., False, False, False)"
    ),
    "gru": (
        "_1, _2 = torch.gru(torch.zeros([2, 1, 3]), h, "
        "[torch.ones([2, 3]), torch.ones([2, 5]), torch.ones([2]), torch.ones([2])], "
        "True, 1, 0., False, False, False)"
    ),
    "lstm of packed sequences": (
        "_1, _2, _3 = torch.lstm(torch.zeros([6, 3]), torch.tensor([3, 3]), [h, h], "
        "[torch.ones([2, 3]), torch.ones([2, 5]), torch.ones([2]), torch.ones([2])], "
        "True, 1, 0., False, False)"
    ),
    "lstm_cell": (
        "_1, _2 = torch.lstm_cell(torch.zeros([1, 3]), [torch.zeros([1, 5]), torch.zeros([1, 5])],"
        " torch.ones([2, 3]), torch.ones([2, 5]))"
    ),
    "gru_cell": (
        "_1 = torch.gru_cell(torch.zeros([1, 3]), torch.zeros([1, 5]), "
        "torch.ones([2, 3]), torch.ones([2, 5]))"
    ),
    "attention": (
        "_1 = torch.scaled_dot_product_attention(torch.ones([1, 2, 40, 8]), "
        "torch.ones([1, 2, 3, 8]), torch.ones([1, 2, 50000, 8]))"
    ),
    "attention of nothing": (
        "_1 = torch.scaled_dot_product_attention(torch.ones([1, 0, 4, 8]), "
        "torch.ones([1, 0, 3, 8]), torch.ones([1, 0, 3, 8]))"
    ),
}


@pytest.mark.parametrize("name", WRONG_SIZES)
def test_an_operator_that_believes_sizes_is_asked_first(name, tmp_path):
    body = f"h = torch.zeros([1, 1, 5])\n{WRONG_SIZES[name]}\n{HONEST}"
    policy = open_policy(load_bundle(write_bundle(tmp_path, saying(body)())))
    with pytest.raises(TrialError, match=r"recurrent|attention|calls `torch\.lstm`"):
        policy.act({"body": np.zeros(12, np.float32)})


def test_random_numbers_are_not_drawn_and_may_stand_where_nothing_draws_them(tmp_path):
    body = "if torch.gt(torch.sum(x), {}):\n  y = torch.add(x, torch.randn_like(x))\nelse:\n  y = x"
    zeros = {"body": np.zeros(12, np.float32)}
    idle = saying(body.format("1.") + "\nreturn y")()
    assert not open_policy(load_bundle(write_bundle(tmp_path / "idle", idle))).act(zeros).any()
    drawing = saying(body.format("-1.") + "\nreturn y")()
    policy = open_policy(load_bundle(write_bundle(tmp_path / "drawing", drawing)))
    with pytest.raises(TrialError, match=r"calls `torch\.randn_like`, which is not among"):
        policy.act(zeros)


def test_repeats_in_a_tensor_are_refused_once_torch_knows_their_type(tmp_path):
    body = "return torch.repeat_interleave(x, torch.tensor([4611686018427387904]))"
    with pytest.raises(PolicyError, match=r"does `repeat_interleave\.self_Tensor`"):
        open_policy(load_bundle(write_bundle(tmp_path, saying(body)())))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ('return torch.to(x, "meta")', "name the device `meta`"),
        ('s = torch.strip(" meta")\nreturn torch.to(x, annotate(Device, s))', "device"),
        ("return torch.zeros([12], layout=1)", "not dense"),
        ("return torch.zeros([12], layout=5)", "not dense"),
    ],
)
def test_a_tensor_without_plain_numbers_is_refused(body, said, tmp_path):
    with pytest.raises(PolicyError, match=said):
        open_policy(load_bundle(write_bundle(tmp_path, saying(body)())))
