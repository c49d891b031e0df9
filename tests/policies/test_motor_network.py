"""Networks of motors: their torques against torch's own, and files that are none."""

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from nw_base.errors import PolicyError
from nw_policies.executor import NEXT
from nw_policies.executor.network import Network
from nw_policies.motor_network import INPUT, TORQUE, motor_program

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", "/nowhere")) / "actuator_nets"
PUBLISHED = {"unitree_go1.pt": 6, "anydrive_v3_lstm.pt": 2}
"""Of walk-these-ways and of legged_gym, which are not part of this project."""


class Act(nn.Module):
    """As walk-these-ways calls its activation; the name is an attribute."""

    def __init__(self, act: str) -> None:
        super().__init__()
        self.act = act

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        if self.act == "softsign":
            return nn.functional.softsign(x)
        if self.act == "elu":
            return nn.functional.elu(x)
        return torch.tanh(x)


class LSTMsea(nn.Module):
    """The parts of `anydrive_v3_lstm.pt`."""

    def __init__(self, layers: int = 2, hidden: int = 8) -> None:
        super().__init__()
        self.lstm = nn.LSTM(2, hidden, layers, batch_first=True)
        self.linear = nn.Linear(hidden, 1)
        self.register_buffer("in_scale", torch.tensor([[[5.0, 0.1]]]))
        self.register_buffer("out_scale", torch.tensor([20.0]))

    def forward(
        self, x: torch.Tensor, hc: tuple[torch.Tensor, torch.Tensor]
    ) -> tuple[torch.Tensor, tuple[torch.Tensor, torch.Tensor]]:
        y, after = self.lstm(x * self.in_scale, hc)
        return self.out_scale * torch.squeeze(self.linear(y)), after


def layers(*activations, size=6):
    torch.manual_seed(0)
    linear = [nn.Linear(size, 16), nn.Linear(16, 16), nn.Linear(16, 1)]
    between = zip(linear, activations, strict=False)
    return nn.Sequential(*(part for pair in between for part in pair), linear[-1])


def saved(module, tmp_path):
    path = tmp_path / "motor.pt"
    torch.jit.script(module.eval()).save(str(path))
    return path.read_bytes()


def given(*shape):
    scale = np.array([0.3] * (shape[1] // 2) + [5.0] * (shape[1] // 2))
    return (np.random.default_rng(0).normal(size=shape) * scale).astype(np.float32)


def check_against_torch(data, path, *, inputs):
    """Check torques of 12 joints for 40 steps against those of torch on the same file."""
    program = motor_program(data, str(path), joints=12, inputs=inputs)
    network, module = Network(program), torch.jit.load(str(path), map_location="cpu")
    memory = {k: np.zeros(s.shape, np.float32) for k, s in program.inputs.items() if k != INPUT}
    remembers = bool(memory)
    if remembers:
        state = module.lstm.state_dict()
        depth, hidden = len(state) // 4, state["weight_hh_l0"].shape[1]
        zeros = torch.zeros(depth, 12, hidden)
        after = (zeros, zeros)
    largest = 0.0
    for x in given(40 * 12, inputs).reshape(40, 12, inputs):
        found = network({INPUT: x, **memory})
        memory = {name: found[NEXT + name].copy() for name in memory}
        with torch.inference_mode():
            if remembers:
                wanted, after = module(torch.from_numpy(x[:, np.newaxis]), after)
            else:
                wanted = module(torch.from_numpy(x))
        np.testing.assert_allclose(
            found[TORQUE].ravel(), wanted.numpy().ravel(), atol=1e-4, rtol=1e-5
        )
        largest = max(largest, float(np.abs(found[TORQUE]).max()))
    assert largest > 0.05, "the torques are not all zero"


@pytest.mark.parametrize(
    "module",
    [
        layers(Act("softsign"), Act("softsign")),
        layers(Act("elu"), Act("tanh")),
        layers(nn.Softsign(), nn.Tanh()),
        layers(nn.ReLU(), nn.SiLU()),
        layers(nn.Sigmoid(), nn.Identity()),
    ],
    ids=["wtw", "wtw-mixed", "softsign", "relu", "sigmoid"],
)
def test_layers_give_the_torques_that_torch_gives(module, tmp_path):
    check_against_torch(saved(module, tmp_path), tmp_path / "motor.pt", inputs=6)


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_an_lstm_gives_the_torques_that_torch_gives_step_after_step(depth, tmp_path):
    torch.manual_seed(depth)
    check_against_torch(saved(LSTMsea(depth), tmp_path), tmp_path / "motor.pt", inputs=2)


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_networks_give_the_torques_that_torch_gives(name):
    if not (ASSETS / name).is_file():
        pytest.skip(f"no {name} at {ASSETS}")
    check_against_torch((ASSETS / name).read_bytes(), ASSETS / name, inputs=PUBLISHED[name])


def test_an_onnx_file_gives_what_the_module_gives_that_it_is_of(tmp_path):
    module = layers(nn.Softsign(), nn.ELU()).eval()
    path = tmp_path / "motor.onnx"
    torch.onnx.export(
        module,
        (torch.zeros(1, 6),),
        str(path),
        dynamo=False,
        input_names=["state"],
        dynamic_axes={"state": {0: "joints"}},
    )
    network = Network(motor_program(path.read_bytes(), "m", joints=12, inputs=6))
    x = given(12, 6)
    with torch.inference_mode():
        wanted = module(torch.from_numpy(x)).numpy()
    np.testing.assert_allclose(network({INPUT: x})[TORQUE], wanted, atol=1e-5)


class Twice(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.inner = nn.Linear(6, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return 2.0 * self.inner(x)


class BothWays(LSTMsea):
    def __init__(self) -> None:
        super().__init__()
        self.lstm = nn.LSTM(2, 8, 1, batch_first=True, bidirectional=True)
        self.linear = nn.Linear(16, 1)


def with_nan():
    module = layers(nn.Tanh(), nn.Tanh())
    with torch.no_grad():
        module[0].bias[0] = float("nan")
    return module


@pytest.mark.parametrize(
    ("module", "inputs", "said"),
    [
        (layers(nn.Tanh(), nn.Tanh()), 4, "takes 6 numbers a joint, the card gives it 4"),
        (LSTMsea(), 6, "takes 2 numbers a joint, the card gives it 6"),
        (layers(nn.ELU(), nn.ELU()), 6, "its part '1' is __torch__.torch.nn.modules.activation"),
        (layers(nn.Tanh(), nn.LayerNorm(16)), 6, "its part '3' is"),
        (layers(nn.Tanh(), nn.Tanh()).double(), 6, "a tensor is missing, or not float32"),
        (nn.Sequential(nn.Linear(6, 2)), 6, "it gives (12, 2) for 12 joints"),
        (Twice(), 6, "its parts are inner"),
        (BothWays(), 2, "an LSTM of two directions"),
        (with_nan(), 6, "not of finite numbers"),
    ],
)
def test_a_network_that_is_not_known_is_refused_with_what_it_is(module, inputs, said, tmp_path):
    with pytest.raises(PolicyError, match=r"motor.pt: ") as caught:
        motor_program(saved(module, tmp_path), "motor.pt", joints=12, inputs=inputs)
    assert said in caught.value.message
    assert caught.value.fix


@pytest.mark.parametrize("data", [b"", b"<html>", b"PK\x03\x04rest", b"\x08\x01", b"\x00" * 99])
def test_a_file_that_is_no_network_is_refused(data):
    with pytest.raises(PolicyError, match=r"^motor.pt: "):
        motor_program(data, "motor.pt", joints=12, inputs=6)


def test_a_state_dict_is_refused_since_it_does_not_say_the_activation(tmp_path):
    torch.save(layers(nn.Tanh(), nn.Tanh()).state_dict(), tmp_path / "motor.pt")
    with pytest.raises(PolicyError, match="a file of the kind state-dict"):
        motor_program((tmp_path / "motor.pt").read_bytes(), "motor.pt", joints=12, inputs=6)
