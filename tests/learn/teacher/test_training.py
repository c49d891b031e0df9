"""A training can be lived with: the same curve from the same seed, and after SIGKILL."""

import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch

from nw_base.errors import StoreError, UsageError
from nw_learn.curve import read_curve
from nw_learn.folder import TrainFolder, read_state
from nw_learn.teacher.policy import Actor, export_checkpoint
from nw_learn.teacher.training import resume_teacher, train_teacher
from nw_policies import load_bundle
from nw_policies.networks.onnx_graph import open_session

SAVES_AT_ONCE = """
import os, signal, sys
from functools import partial
from pathlib import Path
from nw_learn import curve
from nw_learn.teacher import training

curve.draw = lambda *_: None  # Pictures take most of the time, and have tests of their own.

class Killed(training.Keeper):
    def after(self, step, state, **options):
        if step == 384:  # The state is that of two updates; the third is lost.
            os.kill(os.getpid(), signal.SIGKILL)
        return super().after(step, state, **options)

training.Keeper = partial(Killed, save_every=0.0)
training.train_teacher(Path(sys.argv[1]), Path(sys.argv[2]), say=print)
"""


@pytest.fixture(autouse=True)
def undrawn(whole, monkeypatch):
    """Draw no picture: it takes most of the time, and has tests of its own."""
    assert (whole / "run" / "curve.png").stat().st_size > 10_000
    monkeypatch.setattr("nw_learn.curve.draw", lambda *_, **__: None)


def quiet(_line):
    """Say nothing."""


@pytest.mark.nightly
def test_a_training_that_was_killed_continues_to_the_same_curve_and_the_same_policy(
    whole, tmp_path
):
    command = [sys.executable, "-c", SAVES_AT_ONCE, str(whole / "tiny.yaml"), str(tmp_path / "run")]
    killed = subprocess.run(command, check=False, capture_output=True, text=True, timeout=240)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert read_state(tmp_path / "run" / "state.pt")["step"] == 256
    assert resume_teacher(tmp_path / "run", say=quiet).is_done
    for name in ("curve.parquet", "policy/policy.onnx"):
        assert (tmp_path / "run" / name).read_bytes() == (whole / "run" / name).read_bytes()


def test_one_thread_and_two_give_the_same_curve(whole, tmp_path):
    path = tmp_path / "one.yaml"
    path.write_text((whole / "tiny.yaml").read_text() + "overlap: false\n")
    train_teacher(path, tmp_path / "run", say=quiet)
    one, two = (read_curve(folder / "run" / "curve.parquet") for folder in (tmp_path, whole))
    assert one == two


def test_another_seed_gives_another_curve_and_a_checkpoint_is_a_beginning(whole, tmp_path):
    path = tmp_path / "other.yaml"
    text = (whole / "tiny.yaml").read_text().replace("seed: 5", "seed: 6")
    path.write_text(
        f"{text}start: {whole / 'run' / 'checkpoints' / '0002.pt'}\n".replace("512", "128")
    )
    lines = []
    train_teacher(path, tmp_path / "run", say=lines.append)
    other, first = (read_curve(folder / "run" / "curve.parquet")[0] for folder in (tmp_path, whole))
    assert other[0] == first[0]
    assert other[1]["reward/second"] != first[1]["reward/second"]
    # Its critic has learnt before, so that the policy learns at once.
    assert "divergence/mean" in other[1]
    assert "divergence/mean" not in first[1]
    assert any(line.startswith("128 of 128 control steps") for line in lines)


def test_a_training_begins_from_nothing_at_all(whole, tmp_path):
    path = tmp_path / "nothing.yaml"
    path.write_text((whole / "tiny.yaml").read_text().replace("512", "128") + "start: nothing\n")
    train_teacher(path, tmp_path / "run", say=quiet)
    state = read_state(tmp_path / "run" / "state.pt")["actor"]
    # What never changes, such as the commanded speed, is 0 once it is normalised.
    assert state["mean"][10:13].tolist() == pytest.approx([0.8, 1.0, 0.0])
    assert state["inverse_std"].max() <= 20.0


def test_a_checkpoint_is_a_policy_that_can_be_evaluated(whole, tmp_path):
    assert [path.stem for path in TrainFolder(whole / "run").checkpoints] == ["0001", "0002"]
    assert export_checkpoint(whole / "run", 1, tmp_path / "mine").stem == "0001"
    bundle, shipped = load_bundle(tmp_path / "mine"), load_bundle("go1-parkour")
    assert bundle.card.name == "mine"
    assert bundle.card.observations == shipped.card.observations
    assert bundle.card.control == shipped.card.control
    actor = Actor()
    actor.load_state_dict(read_state(whole / "run" / "checkpoints" / "0001.pt")["actor"])
    row = np.random.default_rng(0).normal(size=(1, 332)).astype(np.float32)
    session = open_session((tmp_path / "mine" / "policy.onnx").read_bytes())
    (action,) = session.run(None, {"obs": row})
    assert action == pytest.approx(actor(torch.from_numpy(row)).detach().numpy(), abs=1e-5)
    with pytest.raises(UsageError, match="has no checkpoint 9; there are: 1, 2"):
        export_checkpoint(whole / "run", 9, tmp_path / "none")


def test_a_state_of_another_config_is_not_gone_on_with(whole, tmp_path):
    shutil.copytree(whole / "run", tmp_path / "run")
    config = tmp_path / "run" / "config.yaml"
    config.write_text(config.read_text().replace("seed: 5", "seed: 6"))
    with pytest.raises(StoreError, match="was trained by another config"):
        resume_teacher(tmp_path / "run", say=quiet)


def test_a_state_that_lacks_a_part_is_an_error_on_one_line(whole, tmp_path):
    shutil.copytree(whole / "run", tmp_path / "run")
    state = read_state(tmp_path / "run" / "state.pt")
    del state["episodes"]["trails"]
    torch.save(state, tmp_path / "run" / "state.pt")
    with pytest.raises(StoreError, match="is not a state of this training: KeyError"):
        resume_teacher(tmp_path / "run", say=quiet)


def test_minutes_end_a_process_that_can_be_resumed(whole, tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text((whole / "tiny.yaml").read_text().replace("512}", "512, minutes: 0.00001}"))
    trained = train_teacher(path, tmp_path / "run", say=quiet)
    assert (trained.step, trained.is_done, trained.is_interrupted) == (128, False, False)
    config = tmp_path / "run" / "config.yaml"
    config.write_text((whole / "tiny.yaml").read_text())  # The minutes are no part of the curve.
    assert resume_teacher(tmp_path / "run", say=quiet).is_done
    found = (tmp_path / "run" / "curve.parquet").read_bytes()
    assert found == (whole / "run" / "curve.parquet").read_bytes()
