"""A policy may write into all that it gets and gives: its actions and its log stay the same."""

from __future__ import annotations

import hashlib
import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from mcap.reader import make_reader
from onnx import TensorProto, helper
from torch import nn

from nw_policies import instance_bundle, load_bundle
from nw_policies.cards.networks import ADAPTERS, NetworkAdapter
from nw_policies.mlp import MlpPolicy
from nw_policies.networks.act import Act, ActSizes
from nw_policies.networks.parkour import (
    DepthEncoder,
    Estimator,
    LucidSimTransformer,
    ParkourActor,
)
from nw_policies.opening import ZeroPolicy
from nw_policies.published import ActNetwork, LucidSimPolicy, StudentPolicy
from nw_policies.serve import serving
from nw_sim.rollout.trial import run_trial

# torch recommends torch.export for new files; people have these.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

CARD = """\
nw-policy: 1
name: writes
robot: go1
adapter: ADAPTER
control: {action: joint_position_offset, scale: 0.25}
observations:
"""
BODY = "sensor: proprio, terms: [ang_vel, gravity, joint_pos]"
# Samples that are shown at five steps; the third is also the first, read only once a step.
OBSERVATIONS = f"""\
  obs: {{{BODY}}}
  depth: {{sensor: depth, camera: ego, width: 32, height: 18, rate: 10}}
  again: {{{BODY}}}
"""
INPUTS = "inputs: {obs: [obs], depth: [depth], again: [again]}\n"
HISTORY = "{sensor: proprio, layout: parkour53, history: {steps: 10, current: false}, rate: 10}"


@dataclass
class Case:
    """A folder for a card, and whether its policy writes into what it gets and has given."""

    folder: object
    writes: bool
    patch: pytest.MonkeyPatch
    cleanup: ExitStack

    def card(self, adapter, observations=OBSERVATIONS, inputs=INPUTS, file="", **more):
        text = CARD.replace("ADAPTER", adapter) + observations + inputs
        text += f"checkpoint: {{file: {file}}}\n" if file else ""
        text += "".join(f"{key}: {value}\n" for key, value in more.items())
        (self.folder / "policy.yaml").write_text(text)
        return load_bundle(self.folder)

    def save(self, tensors, file="p.pt"):
        torch.save(tensors, self.folder / file)
        return file


def scribble(values):
    """Write into whatever can be written into."""
    for value in values:
        if isinstance(value, torch.Tensor):
            value.detach().fill_(7.0)
        elif value.flags.writeable:
            value.fill(7.0)


class Reads(nn.Module):
    def __init__(self):
        super().__init__()
        self.a, self.b = nn.Linear(18, 12), nn.Linear(18, 12)
        self.w = nn.Parameter(torch.randn(12))
        self.register_buffer("given", torch.zeros(1, 12))

    def forward(self, obs: torch.Tensor, depth: torch.Tensor, again: torch.Tensor) -> torch.Tensor:
        depth = (depth - 1.0) * 0.5
        action = torch.tanh(self.a(obs * 0.9) + self.b(again * 0.9) + self.w * depth.mean())
        self.given.copy_(action)
        return action


class Writes(Reads):
    """The same numbers; normalises in place, and keeps and overwrites what it has returned."""

    def forward(self, obs: torch.Tensor, depth: torch.Tensor, again: torch.Tensor) -> torch.Tensor:
        depth.sub_(1.0).mul_(0.5)
        obs.mul_(0.9)
        again.mul_(0.9)
        self.given.fill_(9.0)
        self.given.copy_(torch.tanh(self.a(obs) + self.b(again) + self.w * depth.mean()))
        return self.given


def module_of(case):
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return (Writes if case.writes else Reads)().eval()


def script_file(case, file="p.pt"):
    torch.jit.save(torch.jit.script(module_of(case)), case.folder / file)
    return file


def export_file(case, file="p.pt2"):
    zeros = (torch.zeros(1, 18), torch.zeros(1, 18, 32), torch.zeros(1, 18))
    exported = torch.export.export(module_of(case), zeros)
    torch.export.save(exported, case.folder / file)
    return file


def onnx_file(case, file="p.onnx"):
    """Return a graph whose recurrent state is what it gives, run by a runtime that scribbles."""
    rng = np.random.default_rng(0)
    weights = {"wa": (18, 12), "wb": (18, 12), "wd": (18 * 32, 12), "wh": (12, 12)}
    constants = [
        helper.make_tensor(n, TensorProto.FLOAT, s, rng.normal(0, 0.05, s).ravel())
        for n, s in weights.items()
    ]
    nodes = [
        helper.make_node("MatMul", ["obs", "wa"], ["xa"]),
        helper.make_node("MatMul", ["again", "wb"], ["xb"]),
        helper.make_node("Flatten", ["depth"], ["flat"]),
        helper.make_node("MatMul", ["flat", "wd"], ["xd"]),
        helper.make_node("MatMul", ["h_in", "wh"], ["xh"]),
        helper.make_node("Sum", ["xa", "xb", "xd", "xh"], ["sum"]),
        helper.make_node("Tanh", ["sum"], ["action"]),
        helper.make_node("Neg", ["action"], ["h_out"]),
    ]
    shapes = {"obs": (1, 18), "depth": (1, 18, 32), "again": (1, 18), "h_in": (1, 12)}
    inputs, outputs = (
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in named.items()]
        for named in (shapes, {"action": (1, 12), "h_out": (1, 12)})
    )
    graph = helper.make_graph(nodes, "g", inputs, outputs, constants)
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), case.folder / file)
    run = onnxruntime.InferenceSession.run

    def scribbling(session, names, feeds, *rest):
        results = run(session, names, feeds, *rest)
        scribble(array for name, array in feeds.items() if name != "h_in")
        return results

    if case.writes:
        case.patch.setattr(onnxruntime.InferenceSession, "run", scribbling)
    return file


PYTHON = """\
import numpy as np

class Reads:
    def __init__(self, bundle=None):
        rng = np.random.default_rng(0)
        self.w, self.v = rng.normal(size=(12, 18)) * .2, rng.normal(size=12)
        self.given = np.zeros(12)
    def act(self, given):
        obs, depth, again = given["obs"] * 0.9, (given["depth"] - 1.0) * 0.5, given["again"] * 0.9
        return np.tanh(self.w @ (obs + again) + self.v * float(depth.mean()))

class Writes(Reads):
    def act(self, given):
        obs, depth, again = given["obs"], given["depth"], given["again"]
        depth -= 1.0; depth *= 0.5; obs *= 0.9; again *= 0.9
        self.given[:] = 9.0
        self.given[:] = np.tanh(self.w @ (obs + again) + self.v * float(depth.mean()))
        given.clear()
        return self.given
"""


def python_code(case):
    # A module is imported once in a process, by its name.
    module = f"p{hashlib.sha256(str(case.folder).encode()).hexdigest()[:16]}"
    (case.folder / f"{module}.py").write_text(PYTHON)
    return f"python:{module}:{'Writes' if case.writes else 'Reads'}"


def written_to(case, cls, method):
    """Let a network of ours write into its inputs, and into what it has returned, if it is to."""
    compute, given = getattr(cls, method), []

    def scribbling(policy, inputs):
        scribble(given)
        result = compute(policy, inputs)
        parts = result if isinstance(result, tuple) else (result,)
        given[:] = [
            part.clone() if isinstance(part, torch.Tensor) else part.copy() for part in parts
        ]
        scribble(inputs.values())
        return tuple(given) if isinstance(result, tuple) else given[0]

    if case.writes:
        case.patch.setattr(cls, method, scribbling)


def randomized(module):
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return {
            name: torch.rand(tensor.shape) * max(tensor[0].numel(), 1) ** -1.0
            if tensor.is_floating_point() and tensor.ndim
            else tensor
            for name, tensor in module.state_dict().items()
        }


def mlp(case):
    layers = nn.Sequential(nn.Linear(18, 16), nn.ELU(), nn.Linear(16, 12))
    file = case.save({f"actor.{name}": value for name, value in randomized(layers).items()})
    written_to(case, MlpPolicy, "infer")
    options = "{weights: actor, activation: elu}"
    return case.card("mlp", f"  obs: {{{BODY}}}\n", "", file, options=options, runtime="native")


def act(case):
    sizes = ActSizes(
        width=16, heads=8, feedforward=8, encoder_layers=1, decoder_layers=1, pre_norm=False,
        proprio=18, latent=4, actions=12, chunk=4, backbone={}, normalized=False,
    )  # fmt: skip
    file = case.save(randomized(Act(sizes)))
    written_to(case, ActNetwork, "outputs")
    inputs = "inputs: {proprio: [obs]}\n"
    return case.card("act", f"  obs: {{{BODY}, rate: 10}}\n", inputs, file, runtime="native")


def lucidsim(case):
    file = case.save(randomized(LucidSimTransformer()))
    written_to(case, LucidSimPolicy, "infer")
    observations = """\
  proprio: {sensor: proprio, layout: parkour53}
  rgb: {sensor: splat_rgb, camera: ego, width: 80, height: 45, stack: 7, axes: chw, rate: 10,
        dtype: float32}
"""
    inputs = "inputs: {proprio: [proprio], frames: [rgb]}\n"
    return case.card("lucidsim", observations, inputs, file, runtime="native")


def parkour(case):
    saved = {
        "model_state_dict": {f"actor.{k}": v for k, v in randomized(ParkourActor()).items()},
        "estimator_state_dict": randomized(Estimator()),
        "depth_encoder_state_dict": randomized(DepthEncoder(41472)),
    }
    file = case.save(saved)
    written_to(case, StudentPolicy, "infer")
    observations = f"""\
  proprio: {{sensor: proprio, layout: parkour53, rate: 10}}
  history: {HISTORY}
  depth: {{sensor: depth, camera: ego, width: 80, height: 45, rate: 10}}
"""
    inputs = "inputs: {proprio: [proprio], history: [history], depth: [depth]}\n"
    return case.card("extreme-parkour", observations, inputs, file, runtime="native")


def zero(case):
    written_to(case, ZeroPolicy, "act")
    return case.card("zero", inputs="")


def remote(case):
    served = case.folder / "served"
    served.mkdir()
    bundle = Case(served, case.writes, case.patch, case.cleanup)
    bundle = bundle.card(python_code(bundle))
    address = case.cleanup.enter_context(serving(bundle, allow_code=True))
    return case.card("remote", inputs="", options=f"{{url: '{address.url}'}}")


def instance(case):
    module = python_code(case).split(":")
    case.patch.syspath_prepend(case.folder)
    __import__(module[1])
    made = getattr(sys.modules[module[1]], module[2])()
    card = case.card(":".join(module)).card
    return instance_bundle(made, card)


FILES = {"onnx": onnx_file, "torchscript": script_file, "torch-export": export_file}


def fed_by(adapter):
    """Return a policy that writes into what a network gives, which writes into what it sees."""

    def make(case):
        file = FILES[adapter](case)
        code = python_code(case)
        network = (
            f"{{adapter: {adapter}, checkpoint: {{file: {file}}}, {INPUTS.strip()}, rate: 10}}"
        )
        source = case.folder / f"{code.split(':')[1]}.py"
        # It adds what the network gives to its action, and writes into it afterwards.
        text = source.read_text().replace("def act(self, given):", "def plain(self, given):")
        text = text.replace("class Reads:", "class Reads:\n    def act(self, given):\n"
            "        eyes = given.pop('eyes')\n        sum = self.plain(given) + eyes.ravel()\n"
            "        return sum\n")  # fmt: skip
        text += "    def act(self, given):\n        eyes = given.pop('eyes')\n"
        text += "        sum = self.plain(given) + eyes.ravel()\n        eyes[:] = 7.0\n"
        source.write_text(text + "        return sum\n")
        return case.card(code, networks=f"{{eyes: {network}}}", inputs="")

    return make


CASES = {
    "onnx": lambda case: case.card("onnx", file=onnx_file(case), runtime="native"),
    "torchscript": lambda case: case.card("torchscript", file=script_file(case)),
    "torch-export": lambda case: case.card("torch-export", file=export_file(case)),
    "mlp": mlp,
    "lucidsim": lucidsim,
    "extreme-parkour": parkour,
    "act": act,
    "remote": remote,
    "zero": zero,
    "python": lambda case: case.card(python_code(case)),
    "an object of Python": instance,
}


def messages(path):
    """Return what a log holds, but for what differs between two files of weights."""
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic != "/nw/state"
        ]


def run(case, make, make_job, library):
    bundle = make(case)
    if bundle.instance is not None:
        library._known[bundle.reference] = bundle
    log = case.folder / "trial.mcap"
    job = make_job(policy="go1-parkour", mcap=log, record="all", duration=0.5, allow_code=True)
    served = "" if bundle.card.adapter == "remote" else bundle.checkpoint_digest
    job = replace(job, policy=bundle.reference, checkpoint_digest=served)
    result = run_trial(job, library=library)
    assert result.status == "ok", result.error_text
    return result, messages(log)


# A new adapter is an error here until it has a case: this is the table that opens them.
@pytest.mark.parametrize(
    "make",
    [
        *(pytest.param(lambda case, a=a: CASES[a](case), id=a) for a in ADAPTERS),
        *(pytest.param(CASES[a], id=a) for a in CASES if a not in ADAPTERS),
        *(pytest.param(fed_by(a), id=f"fed by {a}") for a in get_args(NetworkAdapter)),
    ],
)
def test_a_policy_that_writes_into_all_that_it_gets_acts_and_is_logged_as_one_that_does_not(
    tmp_path, make, make_job, library
):
    found = []
    for writes in (False, True):
        folder = tmp_path / ("writes" if writes else "reads") / "policy"
        folder.mkdir(parents=True)
        with pytest.MonkeyPatch.context() as patch, ExitStack() as cleanup:
            found.append(run(Case(folder, writes, patch, cleanup), make, make_job, library))
    (one, kept), (other, written) = found
    assert one.steps > 10
    assert (one.action_digest, one.state_digest) == (other.action_digest, other.state_digest)
    assert {topic for topic, *_ in kept} == {topic for topic, *_ in written}
    assert kept == written
