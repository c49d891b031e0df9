"""`nw-eval train`, from its arguments to its exit code; no fault shows a traceback."""

import pytest

from nw_eval import cli
from nw_learn.config import find_config, load_config
from nw_learn.teacher.config import TeacherConfig
from nw_policies import load_bundle

CONFIG = """\
nw-train: 1
seed: 1
budget: {steps: 64}
ppo: {robots: 4, horizon: 8, minibatches: 2, epochs: 1, critic_first: 0}
courses: {variants: 1, levels: 1, start: [0, 0], scenes: [hurdles/one_low_carpet]}
overlap: false
phases:
  - {share: 1.0, timestep: 0.01, std: 0.2,
     tasks: {hurdles: 1.0, gaps: 0.0, ramps: 0.0, stairs: 0.0, flat: 0.0}}
"""


def run(*arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main([str(argument) for argument in arguments])
    return caught.value.code


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(CONFIG)
    return path


def test_a_teacher_is_trained_resumed_and_taken_out_as_a_policy(
    config, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nw_learn.curve.draw", lambda path, *_, **__: path.touch())
    assert run("train", "teacher", config) == 0
    assert "64 of 64 control steps" in capsys.readouterr().out
    folder = tmp_path / "runs" / "mine"
    assert {path.name for path in folder.iterdir()} >= {
        "config.yaml", "curve.parquet", "curve.png", "policy", "state.pt",
    }  # fmt: skip
    assert run("train", "teacher", "--resume", folder) == 0
    assert run("train", "export", folder, "--out", "policies/mine") == 0
    assert load_bundle("mine").card.name == "mine"
    assert run("train", "teacher", config) == 2
    assert "holds a training already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (("robots: 4", "robot: 4"), ":4:7: unknown key 'robot'; did you mean 'robots'?"),
        (("share: 1.0", "share: 0.4"), "the shares of the phases add up to 0.4; make them 1"),
        (("timestep: 0.01", "timestep: 0.02"), "a time step of 0.02 s is not known; use 0.005 or"),
        (("gaps: 0.0", "gaps: 0.5"), "the shares add up to 1.5; make them 1"),
        (("start: [0, 0]", "start: [2, 1]"), "start [2, 1] is not within the levels"),
        (("minibatches: 2", "minibatches: 5"), "does not divide into minibatches"),
        (
            ("hurdles/one_low_carpet", "hurdles/three_low"),
            ":5:50: courses.scenes: 'hurdles/three_low' is kept for evaluation",
        ),
        (("seed: 1", "seed: 1\nstart: go1-parkuor"), "did you mean 'go1-parkour'?"),
        (("seed: 1", "seed: 1\nstart: stand"), "start: 'stand' has no weights"),
        (("seed: 1", "seed: 1\nstart: gone.pt"), "start: no checkpoint"),
    ],
)
def test_a_fault_of_a_config_is_one_line_and_leaves_no_folder(
    config, tmp_path, capsys, change, fault
):
    config.write_text(CONFIG.replace(*change))
    assert run("train", "teacher", config, "--out", tmp_path / "run") == 2
    err = capsys.readouterr().err
    assert fault in err
    assert "Traceback" not in err
    assert not (tmp_path / "run").exists()


def test_arguments_that_contradict_each_other_are_a_usage_error(config, tmp_path, capsys):
    assert run("train", "teacher") == 2
    assert run("train", "teacher", "techer") == 2
    assert "no config 'techer'; did you mean 'teacher'?" in capsys.readouterr().err
    assert run("train", "teacher", config, "--resume", tmp_path) == 2
    assert run("train", "teacher", "--resume", tmp_path) == 2
    assert f"no training in {tmp_path}" in capsys.readouterr().err
    assert run("train", "export", tmp_path, "--out", tmp_path / "policy") == 2


def test_the_shipped_config_trains_further_what_is_shipped_at_the_evaluations_own_time_step():
    settings = load_config(find_config("teacher"), TeacherConfig)
    assert settings.start == "go1-parkour"
    assert settings.courses.scenes is None
    assert settings.phases[-1].timestep == 0.005
    middle = settings.budget.steps // 2
    assert [settings.phase_at(step) for step in (0, middle, settings.budget.steps - 1)] == [0, 0, 2]
