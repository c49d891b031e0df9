"""Policies that other networks feed, in trials: the same walk, own rates, replays, strangers."""

import hashlib
import io
import os
import re
from dataclasses import replace
from pathlib import Path

import onnx
import pytest
import torch
from onnx.utils import Extractor
from torch import nn

from nw_base.errors import PolicyError
from nw_eval.cli.verbs.policies import card_page, probe_page
from nw_policies import load_bundle
from nw_sim.probe.report import probe_here
from nw_sim.probe.summary import card_summary
from nw_sim.rollout.confined.vetting import check_bundle, vet_bundle
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.replaying.takeover import replay
from nw_sim.rollout.trial import run_trial

REPOSITORY = Path(__file__).resolve().parents[3]
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", REPOSITORY.parent / "shared" / "assets"))
HIMLOCO = ASSETS / "policies/himloco-go2/himloco.pt"

# torch recommends torch.export for new files; people have these.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def put(folder, name, data):
    """Write a file; return the lines of a card that say which it is."""
    (folder / name).write_bytes(data)
    return f"{{file: {name}, sha256: {hashlib.sha256(data).hexdigest()}}}"


def scripted(module):
    buffer = io.BytesIO()
    torch.jit.save(torch.jit.script(module.eval()), buffer)
    return buffer.getvalue()


@pytest.fixture(scope="session")
def split(tmp_path_factory):
    """The shipped policy with its first two layers in a file of their own."""
    folder = tmp_path_factory.mktemp("split")
    shipped = load_bundle("go1-parkour")
    whole = Extractor(onnx.shape_inference.infer_shapes(onnx.load(shipped.checkpoint)))
    front = put(folder, "f.onnx", whole.extract_model(["obs"], ["h2"]).SerializeToString())
    back = put(folder, "b.onnx", whole.extract_model(["h2"], ["action"]).SerializeToString())
    text = re.sub(r"checkpoint:\n(  .*\n)+", f"checkpoint: {back}\n", shipped.card_path.read_text())
    parts = ", ".join(shipped.card.observations)
    text += f"networks: {{front: {{adapter: onnx, checkpoint: {front}, inputs: [{parts}]}}}}\n"
    (folder / "policy.yaml").write_text(f"{text}inputs: {{h2: [front]}}\n")
    return str(folder)


def test_the_shipped_policy_in_two_files_walks_as_in_one(make_job, library, split):
    two, one = (run_trial(make_job(policy=p), library=library) for p in (split, "go1-parkour"))
    assert two.status == "ok", two.error_text
    assert (two.steps, two.action_digest) == (one.steps, one.action_digest)
    assert two.state_digest == one.state_digest


class Encoder(nn.Module):
    """Sees a depth image, and remembers in a buffer."""

    def __init__(self):
        super().__init__()
        self.rnn = nn.GRUCell(60, 8)
        self.register_buffer("hidden", torch.zeros(1, 8))

    def forward(self, depth: torch.Tensor) -> torch.Tensor:
        seen = depth[:, ::4, ::4].flatten(1)
        self.hidden = self.rnn(seen, self.hidden)
        return self.hidden


class Body(nn.Module):
    def __init__(self):
        super().__init__()
        self.net = nn.Linear(12 + 8, 12)

    def forward(self, both: torch.Tensor) -> torch.Tensor:
        return 0.3 * torch.tanh(self.net(both))


EYES = """\
nw-policy: 1
name: eyes
robot: go1
adapter: torchscript
checkpoint: BODY
control: {action: joint_position_offset, scale: 0.25}
networks:
  encoder: {adapter: torchscript, checkpoint: ENCODER, inputs: [depth], rate: 10}
inputs: [joints, encoder]
observations:
  joints: {sensor: proprio, terms: [joint_pos]}
  depth: {sensor: depth, camera: ego, width: 40, height: 24, rate: 10, latency: 0.04}
"""


@pytest.fixture(scope="session")
def eyes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("eyes")
    with torch.random.fork_rng():
        torch.manual_seed(3)
        body, encoder = (
            put(folder, "b.pt", scripted(Body())),
            put(folder, "e.pt", scripted(Encoder())),
        )
    (folder / "policy.yaml").write_text(EYES.replace("BODY", body).replace("ENCODER", encoder))
    return folder


@pytest.fixture
def looked(make_job, library, eyes, tmp_path):
    """A trial's log and result."""
    path = tmp_path / "trial.mcap"
    job = make_job(policy=str(eyes), mcap=path, record="all", duration=0.6)
    result = run_trial(job, library=library)
    assert result.status == "ok", result.error_text
    return job, path, result


def test_a_recurrent_encoder_begins_every_trial_anew(looked, library):
    job, _, result = looked
    again = run_trial(job, library=library)
    assert again.action_digest == result.action_digest
    assert again.state_digest == result.state_digest


def test_a_replay_is_identical_from_the_start_and_from_between_two_looks(looked, library):
    _, path, result = looked
    whole, part = replay(path, library=library), replay(path, start=0.26, library=library)
    assert whole.is_identical
    assert part.is_identical
    assert part.start_step < result.steps == part.result.steps
    memory = {state.policy for state in LogReader(path).states()}
    assert len(memory) > 1  # There was something to restore.


class Deaf(nn.Module):
    def forward(self, depth: torch.Tensor) -> torch.Tensor:
        return 0.0 * depth[:, 0, :8]


def with_encoder(data, eyes, folder):
    """The same card and policy with another encoder."""
    body, encoder = put(folder, "b.pt", (eyes / "b.pt").read_bytes()), put(folder, "e.pt", data)
    (folder / "policy.yaml").write_text(EYES.replace("BODY", body).replace("ENCODER", encoder))
    return load_bundle(folder)


def test_check_names_every_network_and_finds_the_deaf_one(eyes, tmp_path):
    place = "hurdles/one_low_carpet"
    told = probe_here(load_bundle(eyes), scene=place)
    assert re.search(r"^network +gives +numbers +rate", probe_page(told), re.MULTILINE)
    assert re.search(r"^encoder +encoder +8 +10 Hz", probe_page(told), re.MULTILINE)
    assert "does not react to its inputs" not in probe_page(told)
    told = probe_here(with_encoder(scripted(Deaf()), eyes, tmp_path), scene=place)
    assert not told.passed
    assert "fault: network `encoder`: `encoder` is the same at every step" in probe_page(told)


def test_show_names_every_network(eyes, split):
    text = card_page(card_summary(eyes / "policy.yaml"))
    assert re.search(
        r"^network     encoder: e\.pt, 0\.\d+ MB, SHA-256 \w{16}, torchscript, 10 Hz$",
        text,
        re.MULTILINE,
    )
    assert "encoder: input = depth\ninput = joints | encoder\n" in text
    assert "front: input = proprio | scandots | last_output | history\ninput h2 = front\n" in (
        card_page(card_summary(load_bundle(split).card_path))
    )


class Writing(nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        torch.save(x, "written.pt")
        return x


def test_a_hostile_second_file_writes_nothing_as_the_first(eyes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError):
        vet_bundle(with_encoder(scripted(Writing()), eyes, tmp_path), "go1")
    with pytest.raises(PolicyError, match=r"e\.pt: not a TorchScript file: it is a bare pickle"):
        check_bundle(with_encoder(b"\x80\x04\x95 a pickle", eyes, tmp_path))
    assert not list(tmp_path.glob("written*"))


def test_a_trial_planned_with_another_encoder_is_refused(make_job, library, eyes):
    job = make_job(policy=str(eyes))
    own = load_bundle(eyes).checkpoint_sha256
    result = run_trial(replace(job, checkpoint_digest=own), library=library)
    assert result.status == "error"
    assert "the trial was planned with" in result.error_text


class Unit(nn.Module):
    def forward(self, latent: torch.Tensor) -> torch.Tensor:
        return nn.functional.normalize(latent, dim=-1, p=2.0)


@pytest.mark.assets
@pytest.mark.skipif(not HIMLOCO.is_file(), reason=f"no weights at {HIMLOCO}")
def test_himloco_in_three_files_walks_as_in_one(make_job, library, tmp_path):
    himloco = torch.jit.load(str(HIMLOCO), "cpu")
    parts = {"estimator": himloco.estimator, "actor": himloco.actor, "unit": Unit()}
    said = {name: put(tmp_path, f"{name}.pt", scripted(module)) for name, module in parts.items()}
    card = load_bundle("examples/himloco-go2", checkpoint=HIMLOCO).card_path.read_text()
    text = re.sub(r"checkpoint:\n(  .*\n)+", f"checkpoint: {said['actor']}\n", card)
    frame = text[text.index("  obs:\n") :].replace("  obs:\n", "  now:\n")
    text += (
        frame[: frame.index("    history:")]
        + f"""\
networks:
  unit: {{adapter: torchscript, checkpoint: {said["unit"]}, inputs: [estimator.latent]}}
  estimator:
    adapter: torchscript
    checkpoint: {said["estimator"]}
    inputs: [obs]
    outputs: {{velocity: {{select: ["0:3"]}}, latent: {{select: ["3:19"]}}}}
inputs: [now, estimator.velocity, unit]
"""
    )
    (tmp_path / "policy.yaml").write_text(text)
    three = run_trial(make_job(policy=str(tmp_path), robot="go2", duration=4.0), library=library)
    whole = make_job(policy="examples/himloco-go2", robot="go2", checkpoint=HIMLOCO, duration=4.0)
    one = run_trial(whole, library=library)
    assert three.status == "ok", three.error_text
    assert (three.steps, three.action_digest) == (one.steps, one.action_digest)
    assert three.waypoints_reached == one.waypoints_reached > 0
