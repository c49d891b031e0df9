"""What a suite expects of each trial, and scores that are its own Python functions."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import nw_eval
from nw_base.errors import CodeError, UsageError
from nw_eval import cli
from nw_eval.cli.verbs.check import forecast_page
from nw_eval.suite.model import new_suite
from nw_gate.scores import Figures, ScoreSpec, Stretch, TrialEnd, score_class
from nw_gate.scores.own import Expectation, OwnScore, expectation_text, own_text
from nw_sim.tasks.course import Course

SUITE: dict[str, Any] = {
    "nw-eval": 1,
    "name": "own",
    "robot": "go1",
    "policy": "go1-parkour",
    "trials": 1,
    "seed": 11,
    "scenes": ("hurdles/one_low_carpet",),
    "record": "none",
}
JERK = """\
import numpy as np


def jerk(targets, figures):
    changes = np.diff(targets, 3, axis=0) / figures.control_period**3
    return np.sqrt(np.mean(changes**2))
"""
OWN = {"python": "smooth.py:jerk", "unit": "rad/s^3", "better": "lower", "range": (0.0, 2e5)}
FIGURES = Figures(
    control_period=0.02,
    timestep=0.005,
    mass=12.0,
    gravity=9.81,
    torque_limits=np.full(3, 20.0),
    joint_ranges=np.tile([-1.0, 1.0], (3, 1)),
)
END = TrialEnd(outcome="completed", seconds=1.0, success=1.0)


def opened(**expected):
    return score_class(expectation_text("it", Expectation(**expected)))(FIGURES)


def lasting(torques, bound):
    """Return the most instants in a row for which one motor is beyond a bound, one by one."""
    most, row = 0, [0, 0, 0]
    for instant in torques.reshape(-1, 3):
        for motor in range(3):
            row[motor] = row[motor] + 1 if abs(instant[motor]) > bound else 0
        most = max(most, *row)
    return most


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sizes", [(40,), (20, 20), (1, 7, 20, 12)])
def test_a_reading_may_be_beyond_its_bound_for_as_long_as_the_suite_says(seed, sizes):
    rng = np.random.Generator(np.random.PCG64(seed))
    torques = np.cumsum(rng.normal(0.0, 4.0, (sum(sizes) * 4, 3)), axis=0).reshape(-1, 4, 3)
    most = lasting(torques, 12.0)
    for instants in {max(most - 1, 0), most, most + 1}:
        score = opened(reading="torque", at_most=12.0, longer_than=instants * 0.005)
        start = 0
        for size in sizes:
            score.update(Stretch(FIGURES, torques=torques[start : start + size]))
            start += size
        assert score.value(END) == float(most <= instants)
        assert (score.moment() is None) == (most <= instants)


def test_the_moment_is_that_at_which_it_lasted_too_long():
    torques = np.zeros((40, 4, 3))
    torques[10:20, :, 1] = -25.0  # from 0.2 s to 0.4 s
    score = opened(reading="torque", at_most=23.7, longer_than=0.1)
    for start in (0, 20):
        score.update(Stretch(FIGURES, torques=torques[start : start + 20]))
    assert score.value(END) == 0.0
    assert score.moment() == pytest.approx(0.305)


@pytest.mark.parametrize(
    ("reading", "readings", "value"),
    [
        ("torque_share", {"torques": np.full((1, 4, 3), -10.0)}, 0.5),
        ("joint_rate", {"joint_rates": np.full((1, 4, 3), -3.0)}, 3.0),
        (
            "power",
            {"torques": np.full((1, 4, 3), 2.0), "joint_rates": np.full((1, 4, 3), 3.0)},
            18.0,
        ),
        ("foot_force", {"foot_forces": np.full((1, 4), 70.0)}, 70.0),
        ("speed", {"world_velocity": np.array([[3.0, -4.0, 9.0]])}, 5.0),
        (
            "roll",
            {"rotation": np.array([[1, 0, 0, 0, 0.6, 0.8, 0, -0.8, 0.6]])},
            np.arctan2(0.8, 0.6),
        ),
        ("pitch", {"rotation": np.array([[0.6, 0, -0.8, 0, 1, 0, 0.8, 0, 0.6]])}, np.arcsin(0.8)),
    ],
)
def test_each_reading_is_in_its_unit(reading, readings, value):
    for bound, kept in ((value * 1.001, 1.0), (value * 0.999, 0.0)):
        score = opened(reading=reading, at_most=bound)
        score.update(Stretch(FIGURES, **readings))
        assert score.value(END) == kept


def test_a_resumed_trial_keeps_counting():
    torques = np.full((20, 4, 3), 25.0)
    whole = opened(reading="torque", at_most=20.0, longer_than=0.5)
    whole.update(Stretch(FIGURES, torques=torques))
    later = opened(reading="torque", at_most=20.0, longer_than=0.5)
    later.restore(whole.state())
    assert later.value(END) == 1.0
    later.update(Stretch(FIGURES, torques=torques))
    assert later.value(END) == 0.0
    assert later.moment() == pytest.approx(0.505)


@pytest.mark.parametrize("bound", [6.0, 60.0, 1e6])
def test_a_score_that_is_undefined_keeps_to_no_bound(bound):
    within = opened(score="time_to_finish", at_most=bound)
    assert within.value(END) == 1.0
    assert within.value(TrialEnd(outcome="fell", seconds=1.0, success=0.5)) == 0.0


@pytest.mark.parametrize(
    ("expected", "said"),
    [
        ({"at_most": 1.0}, "name either a reading or a score"),
        ({"reading": "roll", "score": "mean_power", "at_most": 1.0}, "either a reading or a score"),
        ({"reading": "roll"}, "set either at_most or at_least"),
        ({"reading": "roll", "at_least": 0.1}, "at_least goes with a score"),
        ({"score": "mean_power", "at_most": 1.0, "longer_than": 1.0}, "longer_than goes with"),
        ({"score": "cost", "at_most": 1.0}, "'cost' is not a score"),
        ({"reading": "height", "at_most": 1.0}, "Input should be 'torque'"),
        ({"reading": "roll", "at_most": float("nan")}, "finite number"),
    ],
)
def test_an_expectation_that_cannot_be_kept_or_broken_is_refused(expected, said):
    with pytest.raises(ValidationError, match=said):
        new_suite({**SUITE, "expect": {"it": expected}})


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({**OWN, "range": (1.0, 1.0)}, "range 1 to 1 is empty"),
        ({**OWN, "undefined": 1e9}, "is not within its range"),
        ({**OWN, "python": "smooth:jerk"}, "should match pattern"),
        ({**OWN, "python": "smooth.py:Jerk"}, "must be lower case"),
        ({**OWN, "name": "mean_power"}, "is built in"),
        ({**OWN, "name": "success"}, "is built in"),
        ({**OWN, "name": "expect_it"}, "do not begin with expect_"),
    ],
)
def test_a_function_that_cannot_be_a_score_is_refused(own, said):
    with pytest.raises(ValidationError, match=said):
        new_suite({**SUITE, "scores": (own,)})


def test_check_says_what_a_gate_of_scores_alone_asks(tmp_path):
    gate = {"scores": {"mean_power": {"bar": 150.0, "max_drop": 60.0}}}
    (tmp_path / "own.yaml").write_text(json.dumps({**SUITE, "gate": gate}))
    page = forecast_page(nw_eval.check(tmp_path / "own.yaml"))
    assert "RAN" not in page
    asked = "mean_power by its bar 150 (95 % confidence); mean_power by its max_drop 60"
    assert f"no bar for success (gate.success_rate); {asked}" in page


def test_a_function_takes_no_name_of_a_score_of_the_task():
    task = {"kind": "stand"}
    own = {**OWN, "name": "position_drift"}
    with pytest.raises(ValidationError, match="'position_drift' is a score of the task"):
        new_suite({**SUITE, "task": task, "scores": (own,)})
    assert new_suite({**SUITE, "scores": (own,)}).measured


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("def jerk(torques)\n    return 0.0\n", r"smooth\.py:1: expected ':'"),
        ("def jork(torques):\n    return 0.0\n", "has no function 'jerk'; did you mean 'jork'"),
        ("def jerk(torqes):\n    return 0.0\n", "a parameter 'torqes', which is not a reading"),
    ],
)
def test_a_file_that_no_worker_could_use_is_refused_before_anything_runs(tmp_path, code, said):
    (tmp_path / "smooth.py").write_text(code)
    (tmp_path / "own.yaml").write_text(json.dumps({**SUITE, "scores": [OWN]}))
    with pytest.raises(UsageError, match=said):
        nw_eval.check(tmp_path / "own.yaml", allow_code=True)


@pytest.mark.parametrize("leaving", ["raise SystemExit(3)", "import os; os._exit(3)"])
def test_a_function_that_leaves_the_process_is_not_a_failure_of_the_policy(tmp_path, leaving):
    (tmp_path / "smooth.py").write_text(f"def jerk(torques):\n    {leaving}\n")
    own = OwnScore.model_validate(OWN)
    score = score_class(own_text(own, tmp_path), allow_code=True)(FIGURES)
    score.update(Stretch(FIGURES, torques=np.zeros((2, 4, 3))))
    with pytest.raises(RuntimeError, match="left the process"):
        score.value(END)
    assert os._exit.__module__ == "posix", "what others call ends the process"


def test_code_of_a_suite_lies_in_its_folder(tmp_path):
    folder = tmp_path / "suite"
    folder.mkdir()
    (tmp_path / "smooth.py").write_text(JERK)
    (folder / "linked.py").symlink_to(tmp_path / "smooth.py")
    for file in ("../smooth.py", str(tmp_path / "smooth.py"), "linked.py"):
        own = OwnScore.model_validate(OWN | {"python": f"{file}:jerk"})
        with pytest.raises(UsageError, match=r"leads out of .*; copy it beside the suite"):
            own_text(own, folder)


def test_a_suite_without_expectations_is_written_as_it_was():
    suite = new_suite(SUITE)
    assert not {"expect", "scores"} & suite.model_dump(by_alias=True).keys()
    expecting = new_suite({**SUITE, "expect": {"it": {"reading": "roll", "at_most": 0.5}}})
    assert expecting.digest == suite.digest, "what is expected changes no trial"
    assert expecting.content_digest != suite.content_digest


def test_what_is_expected_and_a_tasks_own_score_can_be_gated(monkeypatch):
    drift = ScoreSpec(
        name="drift", unit="m", better="lower", low=0.0, high=1.0, undefined=1.0, meaning="m"
    )
    gate = {"scores": {"drift": {"bar": 0.5}, "expect_it": {"bar": 0.9}}}
    settings = {**SUITE, "expect": {"it": {"reading": "roll", "at_most": 0.5}}, "gate": gate}
    with pytest.raises(ValidationError, match="'drift' is not a score"):
        new_suite(settings)
    monkeypatch.setattr(Course, "declared", (drift,))
    suite = new_suite(settings)
    assert list(suite.measured) == ["expect_it"], "the task measures its own"
    again = new_suite(json.loads(suite.model_dump_json(by_alias=True)))
    assert again.content_digest == suite.content_digest
    with pytest.raises(ValidationError, match="'expect_its' is not a score"):
        new_suite({**SUITE, "gate": {"scores": {"expect_its": {"bar": 0.9}}}})


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Write a suite with a function of its own into the current folder."""
    monkeypatch.chdir(tmp_path)

    def write(code=JERK, **more):
        (tmp_path / "smooth.py").write_text(code)
        settings = {
            **SUITE,
            "scores": ["mean_power", OWN],
            "expect": {
                "gentle": {"reading": "torque", "at_most": 1.0, "longer_than": 0.1},
                "smooth": {"score": "jerk", "at_most": 1e5},
                "on_time": {"score": "time_to_finish", "at_most": 6.0},
            },
            **more,
        }
        (tmp_path / "own.yaml").write_text(json.dumps(settings))
        return tmp_path / "own.yaml"

    return write


def test_a_function_of_the_suite_runs_where_the_caller_allows_code(written, tmp_path, capsys):
    suite = written()
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", str(suite), "--out", "refused"])
    assert ended.value.code == 2
    assert (
        "score 'jerk' is Python code, smooth.py:jerk; add --allow-code" in capsys.readouterr().err
    )
    assert not (tmp_path / "refused").exists()
    report = nw_eval.run(
        nw_eval.Request(suite=str(suite), allow_code=True), out=tmp_path / "run", workers=1
    )
    scores = dict(report.rows[0].scores)
    assert set(scores) == {
        *("mean_power", "jerk", "expect_gentle", "expect_smooth", "expect_on_time")
    }
    assert [scores[f"expect_{name}"] for name in ("gentle", "smooth", "on_time")] == [0.0, 1.0, 1.0]
    page = (tmp_path / "run" / "report.md").read_text()
    assert "torque is never above 1 N m for more than 0.1 s" in page
    assert "0 of 1" in page
    (log,) = (tmp_path / "run").rglob("*.mcap")
    found = nw_eval.log_scores(log, allow_code=True)
    assert found.values["jerk"] == pytest.approx(scores["jerk"], rel=1e-9)
    assert 0.1 < found.moments["expect_gentle"] < 1.0
    with pytest.raises(CodeError, match="'jerk' is Python code"):
        nw_eval.log_scores(log, scores=["jerk"])
    assert "jerk" not in nw_eval.log_scores(log).values


def test_another_code_is_another_job_and_another_baseline(written):
    first = nw_eval.plan(nw_eval.Request(suite=str(written()), allow_code=True))
    measured, plugins = first.suite.measured_by(), first.plugins
    second = nw_eval.plan(
        nw_eval.Request(suite=str(written(JERK + "\n# Mended.\n")), allow_code=True)
    )
    assert measured != second.suite.measured_by()
    assert first.suite.digest == second.suite.digest
    assert plugins.keys() == {"scores.jerk"}
    assert plugins["scores.jerk"].startswith("smooth.py:jerk ")
    assert plugins != second.plugins, "what baselines compare"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("raise ValueError('not today')", "cannot be loaded: ValueError: not today"),
        ("raise SystemExit", "cannot be loaded: SystemExit"),
        ("import os; jerk = os._exit(0)", "cannot be loaded: SystemExit: 0"),
        ("if 0: jerk = 1", "cannot be loaded: AttributeError"),
        ("jerk = lambda target: 0.0", "has a parameter 'target', which is not a reading"),
    ],
)
def test_code_that_cannot_be_used_is_named(written, code, said):
    suite = nw_eval.plan(nw_eval.Request(suite=str(written(code)), allow_code=True)).suite
    text = next(each for each in suite.measured_by() if each.startswith("jerk="))
    with pytest.raises(UsageError, match=said):
        score_class(text, allow_code=True)


def test_a_file_that_is_not_there_is_named_before_anything_runs(written, tmp_path):
    suite = written()
    (tmp_path / "smooth.py").unlink()
    with pytest.raises(UsageError, match=r"cannot read .*smooth\.py of score 'jerk'"):
        nw_eval.plan(nw_eval.Request(suite=str(suite), allow_code=True))


@pytest.mark.parametrize("outcome", ["fell", "collided", "policy_failed"])
def test_a_trial_that_is_cut_short_keeps_no_reading_and_no_score_that_grows(outcome):
    end = TrialEnd(outcome=outcome, seconds=0.36, success=0.0)
    calm = {"torques": np.zeros((18, 4, 3)), "joint_rates": np.zeros((18, 4, 3))}
    for expected in (
        {"reading": "torque", "at_most": 60.0},
        {"score": "mean_power", "at_most": 100.0},
    ):
        score = opened(**expected)
        score.update(Stretch(FIGURES, **calm))
        assert score.value(END) == 1.0
        assert score.value(end) == 0.0
    far = opened(score="distance_before_fall", at_least=2.0)
    far.update(Stretch(FIGURES, position=np.array([[0.0, 0, 0], [3.0, 0, 0]])))
    assert far.value(end) == 1.0, "it went so far before it fell"
    near = opened(score="distance_before_fall", at_most=15.0)
    near.update(Stretch(FIGURES, position=np.array([[0.0, 0, 0], [3.0, 0, 0]])))
    assert near.value(END) == 1.0
    assert near.value(end) == 0.0, "it fell before it could go too far"


def test_a_reading_that_is_not_a_number_keeps_no_bound_and_one_that_was_not_taken_is_undefined():
    for value in (np.nan, np.inf, -np.inf):
        score = opened(reading="torque", at_most=60.0)
        score.update(Stretch(FIGURES, torques=np.full((2, 4, 3), value)))
        assert score.value(END) == 0.0
    assert opened(reading="torque", at_most=60.0).value(END) is None


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ((-1.7e308, 1.7e308), "is wider than 1e\\+300"),
        ((0.0, 1.7e308), "is wider than 1e\\+300"),
        ((0.0, 5e-324), "is narrower than 1e-300"),
        ((float("-inf"), 0.0), "finite number"),
        ((0.0, float("nan")), "finite number"),
        ((0.0, -0.0), "is empty"),
    ],
)
def test_a_range_of_invalid_width_is_refused(ends, said):
    with pytest.raises(ValidationError, match=said):
        new_suite({**SUITE, "scores": ({**OWN, "range": ends},)})
    with pytest.raises(ValidationError, match=said):
        ScoreSpec(
            name="x", unit="", better="lower", low=ends[0], high=ends[1], undefined=0, meaning=""
        )


@pytest.mark.parametrize(
    "gate",
    [{"bar": 1e-300}, {"bar": 0.0}, {"bar": 2e5}, {"bar": 1.0, "range": (0.0, 2e-323)}],
)
def test_a_bar_that_is_one_with_an_end_of_the_range_is_refused(gate):
    with pytest.raises(ValidationError, match=r"too near to one|narrower"):
        new_suite({**SUITE, "scores": (OWN,), "gate": {"scores": {"jerk": gate}}})


def test_what_is_not_a_number_counts_as_undefined():
    spec = OwnScore.model_validate({**OWN, "undefined": 1e5}).spec
    for value in (None, float("nan"), float("inf"), float("-inf")):
        assert spec.counted(value) == 1e5
