"""A log may be a stranger's, and the card beside it too: a replay does what its caller allowed."""

import hashlib
import json
import socket
import sys
from pathlib import Path

import pytest
from mcap.writer import Writer

from nw_base.errors import PolicyError
from nw_eval import api, cli
from nw_policies import load_bundle
from nw_policies.serve import serving
from nw_sim.catalogue import get_scene
from nw_sim.rollout.record import TRIAL, VERDICT, trial_metadata
from nw_sim.rollout.replaying.takeover import replay

sys.path.insert(0, str(Path(__file__).parents[2] / "hostile"))
from torchscript import CRAFTED

HEAD = """\
nw-policy: 1
name: gift
robot: go1
control: {action: joint_position_offset, scale: 0.25}
"""
BODY = "observations:\n  body: {sensor: proprio, terms: [gravity]}\n"
CARDS = {
    "policy": HEAD + BODY + "adapter: python:gift_policy:Policy\n",
    "sensor": HEAD + "adapter: zero\nobservations:\n  seen: {sensor: 'gift_sensor:Sensor'}\n",
}
CODE = """\
from pathlib import Path
import numpy as np

Path(__file__).with_name("ran").touch()

class Policy:
    def __init__(self, bundle): pass
    def act(self, observation): return [0.0] * 12

class Sensor:
    shape, dtype = (1,), np.float32
    def __init__(self, robot): pass
    def measure(self, moment): return np.zeros(1, np.float32)
"""


@pytest.fixture
def forge(make_job, tmp_path):
    """Return a maker of logs whose every field a stranger chose."""

    def make(card, **fields):
        path = tmp_path / "policy.yaml"
        path.write_text(card)
        metadata = trial_metadata(make_job(policy=str(path), duration=0.2))
        job = {**json.loads(metadata["job"]), "allow_code": True, **fields}
        job["trial"]["scene_digest"] = get_scene(job["scene"]).digest
        log = tmp_path / "gift.mcap"
        with log.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            writer.add_metadata(TRIAL, {**metadata, "job": json.dumps(job)})
            writer.add_metadata(VERDICT, {"status": "ok"})
            writer.finish()
        return log

    return make


@pytest.mark.parametrize("kind", CARDS)
def test_a_log_that_allows_code_runs_none(kind, forge, tmp_path):
    (tmp_path / f"gift_{kind}.py").write_text(CODE)
    log = forge(CARDS[kind])
    picture = tmp_path / "sheet.png"
    with pytest.raises(PolicyError, match="--allow-code"):
        replay(log)
    with pytest.raises(PolicyError, match="--allow-code"):
        api.replay(log, picture=picture, policy=str(tmp_path))
    assert not (tmp_path / "ran").exists()
    assert not picture.exists()
    replayed = replay(log, allow_code=True)
    assert (tmp_path / "ran").exists()
    assert replayed.result.status == "ok", replayed.result.error_text
    assert replayed.logged.job.allow_code


def test_a_server_is_asked_only_for_a_card_that_the_caller_names(forge, tmp_path):
    remote = HEAD + BODY + "adapter: remote\noptions: {url: 'ws://127.0.0.1:PORT'}\n"
    with socket.create_server(("127.0.0.1", 0)) as listener:
        log = forge(remote.replace("PORT", str(listener.getsockname()[1])))
        with pytest.raises(PolicyError, match=r"asks a policy on a server; add --policy .* trust"):
            replay(log)
        listener.setblocking(False)
        with pytest.raises(BlockingIOError):
            listener.accept()
    with serving(load_bundle("stand")) as address:
        (tmp_path / "policy.yaml").write_text(remote.replace("127.0.0.1:PORT", address.url[5:]))
        replayed = replay(log, policy=str(tmp_path))
    assert replayed.result.steps > 0


def test_a_device_in_place_of_weights_is_not_read(forge, tmp_path):
    log = forge(HEAD + "adapter: zero\n", checkpoint="/dev/null")
    weights = f"checkpoint: {{file: w.onnx, sha256: {'f' * 64}}}\n"
    (tmp_path / "policy.yaml").write_text(HEAD + BODY + "adapter: onnx\n" + weights)
    with pytest.raises(PolicyError, match="/dev/null: the checkpoint is not a file"):
        replay(log)


CRAFTED_CARD = (
    HEAD
    + """\
adapter: torchscript
checkpoint: {file: policy.pt, sha256: %s}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""
)


@pytest.mark.parametrize("door", ["replay", "check", "run"])
def test_no_door_opens_a_script_that_writes_while_it_is_opened(
    door, forge, tmp_path, monkeypatch, capsys
):
    data = CRAFTED["saves a file while it is opened, hidden by case"]()
    (tmp_path / "policy.pt").write_bytes(data)
    log = forge(CRAFTED_CARD % hashlib.sha256(data).hexdigest())
    monkeypatch.chdir(tmp_path)
    arguments = {
        "replay": ["replay", str(log)],
        "check": ["policies", "check", str(tmp_path)],
        "run": ["run", "smoke", "-p", str(tmp_path), "--out", str(tmp_path / "out")],
    }
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments[door])
    assert ended.value.code == 2
    assert "has a member 'CODE/__torch__/" in capsys.readouterr().err
    assert not list(tmp_path.rglob("ran"))
