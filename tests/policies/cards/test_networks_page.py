"""The cards of docs/how-to/networks.md, as they stand there, on networks of their sizes."""

import hashlib
import io
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from nw_policies import load_bundle, open_policy
from nw_sim.rollout.confined.vetting import check_bundle

# torch recommends torch.export for new files; people have these.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "how-to" / "networks.md").read_text()
CARDS = dict(re.findall(r"^```yaml (\S+)/policy\.yaml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))


def scripted(module):
    buffer = io.BytesIO()
    torch.jit.save(torch.jit.script(module.eval()), buffer)
    return buffer.getvalue()


def graph(source, size, **outputs):
    """An ONNX graph of one layer for each output, by name and size."""
    rng = np.random.default_rng(0)
    weights = {name: rng.normal(0, 0.1, (n, size)).astype("f4") for name, n in outputs.items()}
    made = helper.make_graph(
        [helper.make_node("Gemm", [source, f"w_{o}"], [o], transB=1) for o in outputs],
        "layers",
        [helper.make_tensor_value_info(source, TensorProto.FLOAT, [1, size])],
        [helper.make_tensor_value_info(o, TensorProto.FLOAT, [1, n]) for o, n in outputs.items()],
        [numpy_helper.from_array(weight, f"w_{o}") for o, weight in weights.items()],
    )
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return model.SerializeToString()


class Eyes(nn.Module):
    """A GRU over a depth image and the body, whose hidden state is a buffer."""

    def __init__(self):
        super().__init__()
        self.rnn = nn.GRUCell(10 * 15 + 42, 34)
        self.register_buffer("hidden", torch.zeros(1, 34))

    def forward(self, depth: torch.Tensor, proprio: torch.Tensor) -> torch.Tensor:
        seen = depth[:, ::6, ::6].flatten(1)
        self.hidden = self.rnn(torch.cat([seen, proprio], dim=1), self.hidden)
        return self.hidden


FILES = {
    "my-adaptive": lambda: {
        "adaptation_module_latest.jit": scripted(nn.Linear(30 * 42, 2)),
        "body_latest.jit": scripted(nn.Linear(30 * 42 + 2, 12)),
    },
    "my-dreamwaq": lambda: {
        "cenet.onnx": graph("obs_history", 5 * 45, est_vel=3, latent=32),
        "actor.onnx": graph("obs", 45 + 3 + 16, actions=12),
    },
    "my-eyes": lambda: {
        "encoder.pt": scripted(Eyes()),
        "actor.pt": scripted(nn.Linear(42 + 32 + 2, 12)),
    },
}


@pytest.mark.parametrize(
    ("name", "seen"), [("my-adaptive", "history"), ("my-dreamwaq", "past"), ("my-eyes", "depth")]
)
def test_its_cards_run_and_what_a_network_sees_counts(tmp_path, name, seen):
    text = CARDS[name]
    for file, data in FILES[name]().items():
        (tmp_path / file).write_bytes(data)
        was = f"{{file: {file}, sha256: ...}}"
        assert text.count(was) == 1
        text = text.replace(was, was.replace("...", hashlib.sha256(data).hexdigest()))
    (tmp_path / "policy.yaml").write_text(text)
    bundle = load_bundle(tmp_path)
    specs = check_bundle(bundle)
    policy = open_policy(bundle)
    still = {spec.name: np.zeros(spec.shape, spec.dtype) for spec in specs}
    policy.reset(0)
    first = policy.act(still)
    policy.reset(0)
    assert not np.array_equal(policy.act(still | {seen: still[seen] + 0.5}), first)


def test_it_has_no_other_cards():
    assert list(CARDS) == list(FILES)
