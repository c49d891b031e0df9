"""Tasks of other packages: the one of docs/tasks.md runs, and mistakes are told."""

import re
import sys
from pathlib import Path

import pytest
from pydantic import ValidationError

from nw_eval.rollout.job import TrialJob
from nw_eval.rollout.record import job_from_metadata, trial_metadata
from nw_eval.rollout.trial import run_trial
from nw_eval.suite.model import new_suite
from nw_eval.suite.trials import Trial
from nw_eval.tasks import registry, task_kinds

PAGE = Path(__file__).parents[2] / "docs" / "tasks.md"
SETTINGS = {
    "nw-eval": 1,
    "name": "strolling",
    "robot": "go1",
    "policy": "stand",
    "trials": 1,
    "seed": 1,
    "scenes": ["hurdles/one_low_carpet"],
}


def forget():
    registry._installed.cache_clear()
    registry._plugin.cache_clear()
    sys.modules.pop("stroll", None)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install the package of the page, and one that is broken."""
    text = PAGE.read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "stroll.py").write_text(code)
    info = tmp_path / "strolling-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: strolling\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[nw_eval.tasks]\nstroll = stroll:Stroll\ngone = no_such_module:Task\n"
        "nothing = stroll:Literal\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    forget()
    yield info
    forget()


def job_of(suite, mcap=None):
    trial = Trial(
        suite=suite.name,
        suite_digest=suite.digest,
        suite_seed=suite.seed,
        scene="hurdles/one_low_carpet",
        scene_digest="",
        task="hurdles",
        index=0,
    )
    return trial, TrialJob(
        trial=trial,
        robot="go1",
        task=suite.task,
        scores=suite.measured,
        scene=trial.scene,
        duration=suite.episode.duration,
        policy="stand",
        checkpoint_digest="",
        mcap=mcap,
    )


def run(suite):
    from dataclasses import replace

    from nw_eval.catalogue import get_scene
    from nw_eval.policies import load_bundle

    trial, job = job_of(suite)
    trial = replace(trial, scene_digest=get_scene(trial.scene).digest)
    digest = load_bundle("stand").checkpoint_digest
    return run_trial(replace(job, trial=trial, checkpoint_digest=digest))


@pytest.mark.usefixtures("package")
def test_the_task_of_the_page_runs_and_ends_as_it_says():
    assert "stroll" in task_kinds()
    result = run(new_suite({**SETTINGS, "task": {"kind": "stroll", "seconds": 0.5}}))
    assert (result.status, result.outcome, result.end_reason) == ("ok", "completed", "time")
    assert (result.steps, result.success, result.waypoints_total) == (25, 1.0, 0)
    assert result.task_kind == "stroll"


@pytest.mark.usefixtures("package")
def test_another_task_or_other_keys_of_one_are_other_trials():
    digests = {
        new_suite({**SETTINGS, "task": task}).digest
        for task in ("course", "stroll", {"kind": "stroll", "seconds": 3.0})
    }
    assert len(digests) == 3
    assert new_suite({**SETTINGS, "task": "course"}) == new_suite(SETTINGS)
    assert new_suite({**SETTINGS, "task": {"kind": "course"}}).digest == new_suite(SETTINGS).digest


def test_another_version_of_the_package_is_another_panel(package):
    suite = {**SETTINGS, "task": "stroll"}
    before = new_suite(suite).digest
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: strolling\nVersion: 1.1\n")
    forget()
    assert new_suite(suite).digest != before


@pytest.mark.usefixtures("package")
def test_a_log_says_which_task_it_was():
    _, job = job_of(new_suite({**SETTINGS, "task": {"kind": "stroll", "seconds": 3.0}}))
    assert job_from_metadata(trial_metadata(job)) == job
    _, plain = job_of(new_suite(SETTINGS))
    assert '"task": {"kind"' not in trial_metadata(plain)["job"]
    assert job_from_metadata(trial_metadata(plain)) == plain


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(
    ("task", "said"),
    [
        ("strol", "'strol' is no kind of task; did you mean 'stroll'"),
        ({"kind": "stroll", "seconds": "long"}, "task.seconds: input should be a valid number"),
        ({"kind": "stroll", "minutes": 1}, "task.minutes: extra inputs are not permitted"),
        ("gone", "task 'gone' of strolling is broken: ModuleNotFoundError"),
        ("nothing", "task 'nothing' of strolling has no reset, update, end, state, restore"),
        ({"kind": "course", "laps": 2}, "Extra inputs are not permitted"),
        (7, "valid dictionary"),
    ],
)
def test_a_mistake_is_told(task, said):
    with pytest.raises(ValidationError, match=re.escape(said)):
        new_suite({**SETTINGS, "task": task})
