"""A whole training of seconds: rounds, policies, and going on after a SIGKILL."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from student_parts import SMALL, small_config

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_learn.config import load_config
from nw_learn.curve import read_curve
from nw_learn.folder import TrainFolder
from nw_learn.progress import Keeper
from nw_learn.student.config import StudentConfig
from nw_learn.student.driving import training_scenes
from nw_learn.student.train import Learner, StudentTraining, resume_student
from nw_policies import load_bundle

PROGRAM = """
import sys
from pathlib import Path
from nw_learn.config import load_config
from nw_learn.folder import TrainFolder
from nw_learn.progress import Keeper
from nw_learn.student.config import StudentConfig
from nw_learn.student.train import StudentTraining

if __name__ == "__main__":
    Keeper.__init__.__kwdefaults__["save_every"] = 0.0
    folder = TrainFolder(Path(sys.argv[1]))
    config = load_config(folder.config, StudentConfig)
    StudentTraining(config, folder, say=lambda line: print(line, flush=True), workers=1).run()
"""


def begun(path, text):
    path.mkdir()
    config = path.parent / f"{path.name}.yaml"
    config.write_text(text)
    folder = TrainFolder.begin(path, config)
    return load_config(folder.config, StudentConfig), folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A training that nothing interrupts."""
    config, folder = begun(tmp_path_factory.mktemp("student") / "whole", SMALL)
    trained = StudentTraining(config, folder, say=lambda _: None, workers=1).run()
    assert (trained.is_done, trained.policy.name) == (True, "round-2")
    return folder


def test_a_training_leaves_a_policy_of_each_round_and_a_frozen_one_beside_it(config, whole):
    for number in (0, 1, 2):
        assert load_bundle(whole.path / "policies" / f"round-{number}").name == "pupil"
        frozen = load_bundle(whole.path / "policies" / f"round-{number}-frozen")
        assert frozen.name == "pupil-frozen"
        assert "depth" not in frozen.card.observations
    rows = read_curve(whole.path / "curve.parquet")
    assert rows[-1][0] >= config.budget.steps
    rounds = [row for _, row in rows if "driving/all" in row]
    assert [row["round/number"] for row in rounds] == [1.0, 2.0]
    assert [row["trajectories/so far"] for row in rounds] == [2.0, 4.0]
    assert rows[-1][1]["learning/loss"] < rounds[0]["learning/loss"]


def test_a_training_does_not_go_on_under_another_config(whole):
    with pytest.raises(IncomparableError, match="of another config"):
        StudentTraining(small_config(seed=4), whole, say=lambda _: None)


class Dies(BaseException):
    """Ends a process where it stands."""


def same_as(whole, cut):
    """Whether a training that went on came to what one came to that nothing had interrupted."""
    curves = [read_curve(folder.path / "curve.parquet") for folder in (whole, cut)]
    files = [folder.path / "policies" / "round-2" / "policy.onnx" for folder in (whole, cut)]
    return curves[0] == curves[1] and files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.nightly
def test_a_training_goes_on_in_the_middle_of_a_round(tmp_path, config, whole, monkeypatch):
    _, cut = begun(tmp_path / "cut", SMALL)
    step = Learner.step

    def deadly(self, *arguments, **options):
        if options["number"] == 2 and options["step"] == 7:
            raise Dies
        return step(self, *arguments, **options)

    monkeypatch.setattr("nw_learn.curve.draw", lambda *_: None)  # It takes a second.
    with monkeypatch.context() as patched:
        patched.setattr(Learner, "step", deadly)
        patched.setitem(Keeper.__init__.__kwdefaults__, "save_every", 0.0)
        with pytest.raises(Dies):
            StudentTraining(config, cut, say=lambda _: None, workers=1).run()
    state = cut.load_state()
    assert (state["round"], state["step"]) == (2, 7)
    assert resume_student(cut.path, say=lambda _: None, workers=1).is_done
    assert same_as(whole, cut)


def test_a_training_that_has_ended_takes_more_rounds_as_if_it_had_been_planned_with_them(
    tmp_path, config, whole
):
    budget = f"steps: {config.budget.steps}"
    first = SMALL.replace("rounds: 2", "rounds: 1").replace(
        budget, f"steps: {config.budget.steps // 2}"
    )
    _, short = begun(tmp_path / "short", first)
    assert resume_student(short.path, say=lambda _: None, workers=1).policy.name == "round-1"
    short.config.write_text(SMALL.replace(budget, f"steps: {config.budget.steps + 2}"))
    with pytest.raises(IncomparableError, match="of another config"):
        resume_student(short.path, say=lambda _: None, workers=1)
    short.config.write_text(SMALL)
    assert resume_student(short.path, say=lambda _: None, workers=1).is_done
    assert same_as(whole, short)


@pytest.mark.nightly
def test_a_training_goes_on_after_a_sigkill_as_if_nothing_had_happened(tmp_path, config, whole):
    _, cut = begun(tmp_path / "cut", SMALL)
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    child = subprocess.Popen([sys.executable, program, cut.path], start_new_session=True)
    deadline = time.monotonic() + 120.0
    while not cut.state.exists() and child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(child.pid, signal.SIGKILL)
    child.wait()
    assert 0 < cut.load_state()["samples"] < config.budget.steps
    assert resume_student(cut.path, say=lambda _: None, workers=1).is_done
    assert same_as(whole, cut)


def test_nobody_learns_in_a_scene_that_evaluations_are_for():
    names = [found.scene.name for found in training_scenes(["hurdles/*"])]
    assert len(names) == 11
    assert "hurdles/three_low" not in names
    with pytest.raises(UsageError, match="may not be used for training"):
        training_scenes(["hurdles/three_low"])


def test_a_training_begins_with_the_network_of_another(tmp_path, whole):
    state = whole.path / "state.pt"
    config, folder = begun(tmp_path / "more", SMALL + f"start: {state}\n")
    StudentTraining(config, folder, say=lambda _: None)
    first, last = (
        there.path / "policies" / name / "policy.onnx"
        for there, name in ((folder, "round-0"), (whole, "round-2"))
    )
    assert first.read_bytes() == last.read_bytes()
    assert config.digest != small_config().digest


def test_the_learning_rate_falls_from_round_to_round_and_within_each():
    learns = small_config().learns.model_dump() | {"learning_rate": 1e-3, "later_rounds": 0.5}
    config = small_config(learns=learns)
    begins = [config.learns.rate(number, done=0.02) for number in (1, 2, 3)]
    np.testing.assert_allclose(begins, [1e-3, 5e-4, 2.5e-4], rtol=2e-3)
    ends = [config.learns.rate(number, done=1.0) for number in (1, 2, 3)]
    np.testing.assert_allclose(ends, [1e-5, 5e-6, 2.5e-6])
    assert config.digest != small_config().digest


def test_a_network_to_begin_with_must_be_there_and_of_the_same_sizes(tmp_path, whole):
    config, folder = begun(tmp_path / "gone", SMALL + "start: gone.pt\n")
    with pytest.raises(UsageError, match=r"start: no file .*gone\.pt"):
        StudentTraining(config, folder, say=lambda _: None)
    text = SMALL.replace("width: 16, heads", "width: 32, heads") + f"start: {whole.path}/state.pt\n"
    config, folder = begun(tmp_path / "wide", text)
    with pytest.raises(StoreError, match=r"of another network: .*size mismatch"):
        StudentTraining(config, folder, say=lambda _: None)
