"""Tasks and scores of packages: those of docs/how-to/extending run and count.

What is wrong with one is told where it is wrong.
"""

import math
import re
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pydantic import ValidationError

from nw_base import plugins
from nw_base.errors import PluginError, SuiteError
from nw_base.plugins import ROBOTS, SCORES, TASKS, PluginWarning, identity_of
from nw_base.trials import Trial
from nw_eval import api
from nw_eval.suite import load_suite
from nw_eval.suite.model import new_suite
from nw_gate.results.provenance import read_run_info
from nw_policies import load_bundle
from nw_scenes.robots import find_robot
from nw_sim.catalogue import get_scene
from nw_sim.rollout.confined import start
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.record import job_from_metadata, trial_metadata
from nw_sim.rollout.trial import run_trial
from nw_sim.tasks import open_task, task_kinds
from nw_sim.tasks.task import TaskRules

PACKAGES = Path(__file__).parent / "packages"
REACH = (PACKAGES / "reach" / "reach.py").read_text(encoding="utf-8")
TILT = (PACKAGES / "max-tilt" / "max_tilt.py").read_text(encoding="utf-8")
SETTINGS = {
    "nw-eval": 1,
    "name": "reaching",
    "robot": "go1",
    "policy": "stand",
    "trials": 1,
    "seed": 1,
    "scenes": ["flat/carpet_room"],
    "episode": {"duration": 0.5},
}
SUITE = """\
nw-eval: 1
name: reaching
robot: go1
policy: stand
trials: 1
seed: 1
scenes: [flat/carpet_room]
episode: {duration: 0.5}
task: reach
scores: [max_tilt]
"""


@pytest.fixture
def reach(package):
    return package("reach", TASKS, {"reach": "reach:Reach"}, REACH)


@pytest.fixture
def tilt(package):
    return package("max_tilt", SCORES, {"max_tilt": "max_tilt:MaxTilt"}, TILT)


@pytest.fixture
def both(tmp_path, reach, tilt):  # noqa: ARG001
    path = tmp_path / "reaching.yaml"
    path.write_text(SUITE)
    return path


def job_of(suite, mcap=None):
    trial = Trial(
        suite=suite.name,
        suite_digest=suite.digest,
        suite_seed=suite.seed,
        scene="flat/carpet_room",
        scene_digest=get_scene("flat/carpet_room").digest,
        task="flat",
        index=0,
    )
    return TrialJob(
        trial=trial,
        robot="go1",
        task=suite.task,
        scores=suite.measured_by(),
        scene=trial.scene,
        duration=suite.episode.duration,
        policy=suite.policy,
        checkpoint_digest=load_bundle(suite.policy).checkpoint_digest,
        mcap=mcap,
    )


@pytest.mark.usefixtures("reach")
@pytest.mark.parametrize(
    ("ahead", "ends", "steps"),
    [(0.4, ("completed", "distance", 1.0), 1), (2.0, ("timeout", "time", 0.0), 25)],
)
def test_the_task_of_the_page_ends_as_it_says(ahead, ends, steps):
    assert "reach" in task_kinds()
    suite = new_suite({**SETTINGS, "task": {"kind": "reach", "ahead": ahead}})
    result = run_trial(job_of(suite))
    assert (result.status, result.task_kind) == ("ok", "reach")
    assert (result.outcome, result.end_reason, result.success) == ends
    assert result.steps == steps


@pytest.mark.usefixtures("reach")
def test_a_task_that_is_restored_continues_where_it_was():
    suite = new_suite({**SETTINGS, "task": {"kind": "reach", "ahead": 2.0}})
    first, second = (open_task(suite.task, TaskRules(duration=0.5)) for _ in range(2))
    first.distance, first.time, first.is_upright = 0.7, 0.48, False
    second.restore(first.state())
    assert (second.distance, second.time, second.end()) == (0.7, 0.48, "fell")


@pytest.mark.usefixtures("tilt")
def test_the_score_of_the_page_is_what_the_log_says(tmp_path):
    settings = {**SETTINGS, "policy": "go1-parkour", "scores": ("max_tilt",)}
    result = run_trial(job_of(new_suite(settings), mcap=tmp_path / "log.mcap"))
    ((name, value),) = result.scores
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [each.pose for *_, each in reader.iter_decoded_messages(topics=["/robot/odom"])]
    turns = [pose.orientation for pose in found][1:]  # The first is the start.
    tilts = [math.acos(1.0 - 2.0 * (q.x**2 + q.y**2)) for q in turns]
    assert len(tilts) == result.steps == 25
    assert (name, value) == ("max_tilt", pytest.approx(max(tilts), rel=1e-4))
    assert value > 0.0


@pytest.mark.usefixtures("reach")
def test_another_task_or_other_keys_of_one_are_other_trials():
    digests = {
        new_suite({**SETTINGS, "task": task}).digest
        for task in ("course", "reach", {"kind": "reach", "ahead": 3.0})
    }
    assert len(digests) == 3
    assert new_suite({**SETTINGS, "task": "course"}) == new_suite(SETTINGS)
    assert new_suite({**SETTINGS, "task": {"kind": "course"}}).digest == new_suite(SETTINGS).digest


def test_the_version_of_a_tasks_package_names_other_trials_and_that_of_a_scores_package_does_not(
    both, package
):
    first = load_suite(both)
    assert first.plugins == {"scores.max_tilt": "max_tilt 1.0", "tasks.reach": "reach 1.0"}
    package("reach", TASKS, {"reach": "reach:Reach"}, version="1.1")
    second = load_suite(both)
    assert second.plugins["tasks.reach"] == "reach 1.1"
    assert second.digest != first.digest
    package("max_tilt", SCORES, {"max_tilt": "max_tilt:MaxTilt"}, version="1.1")
    third = load_suite(both)
    assert third.plugins["scores.max_tilt"] == "max_tilt 1.1"
    assert (third.digest == second.digest, third.content_digest == second.content_digest) == (
        True,
        False,
    )
    gated = new_suite({**SETTINGS, "gate": {"scores": {"max_tilt": {"bar": 1.0}}}})
    assert gated.plugins == {"scores.max_tilt": "max_tilt 1.1"}
    assert gated.digest == new_suite(SETTINGS).digest


def test_code_that_changes_under_one_version_is_another_engine(both, reach, tilt):
    from nw_eval.engine.provenance import journal_header

    before = journal_header(api.plan(str(both))).engine
    for module, key in ((reach, "tasks.reach"), (tilt, "scores.max_tilt")):
        module.write_text(module.read_text() + "\n# changed\n")
        after = journal_header(api.plan(str(both))).engine
        assert {name for name in before if before[name] != after[name]} == {key}
        before = after


def test_a_run_says_whose_they_are_and_is_judged_where_they_are_not_installed(
    both, tmp_path, reach, tilt
):
    api.run(str(both), out=tmp_path / "run", in_process=True)
    info = read_run_info(tmp_path / "run" / "run.json")
    assert info.plugins == {
        "scores.max_tilt": identity_of(SCORES, "max_tilt"),
        "tasks.reach": identity_of(TASKS, "reach"),
    }
    for module in (reach, tilt):
        (module.parent / f"{module.stem}.dist-info" / "entry_points.txt").unlink()
        module.unlink()
    plugins.installed.cache_clear()
    judged = api.judge(tmp_path / "run")
    assert judged.verdict.verdict == "RAN"
    (row,) = judged.rows
    assert row.task_kind == "reach"
    assert dict(row.scores)["max_tilt"] > 0.0
    with pytest.raises(SuiteError) as caught:
        api.run(resume=tmp_path / "run", in_process=True)
    assert "scores.max_tilt: it is to be max_tilt 1.0, and is not installed" in str(caught.value)
    assert "tasks.reach: it is to be reach 1.0, and is not installed" in str(caught.value)


@pytest.mark.nightly
def test_results_are_taken_over_until_the_code_of_a_package_changes(
    both, tmp_path, tilt, monkeypatch
):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "1")
    both.write_text(SUITE.replace("trials: 1", "trials: 3"))
    start.renew()  # Workers are forked from where the packages are.

    def taken_over(name):
        run = api.run(str(both), out=tmp_path / name, workers=1)
        return sum(row.cached for row in run.rows)

    assert taken_over("first") == 0
    assert taken_over("second") == 2  # One runs all the same.
    tilt.write_text(TILT + "\n# changed\n")
    assert taken_over("third") == 0


@pytest.mark.usefixtures("reach")
def test_a_log_says_which_task_it_was():
    job = job_of(new_suite({**SETTINGS, "task": {"kind": "reach", "ahead": 3.0}}))
    assert job_from_metadata(trial_metadata(job)) == job
    plain = job_of(new_suite(SETTINGS))
    assert '"task": {"kind"' not in trial_metadata(plain)["job"]
    assert job_from_metadata(trial_metadata(plain)) == plain


@pytest.mark.usefixtures("reach", "tilt")
@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"task": "raech"}, "'raech' is not a kind of task; did you mean 'reach'"),
        ({"task": {"kind": "reach", "ahead": "far"}}, "task.ahead: input should be a valid number"),
        ({"task": {"kind": "reach", "laps": 1}}, "task.laps: extra inputs are not permitted"),
        ({"task": {"kind": "course", "laps": 2}}, "Extra inputs are not permitted"),
        ({"task": 7}, "valid dictionary"),
        ({"scores": ("max_tlit",)}, "'max_tlit' is not a score; did you mean 'max_tilt'"),
        ({"gate": {"scores": {"max_tlit": {"bar": 1.0}}}}, "'max_tlit' is not a score"),
        ({"gate": {"scores": {"max_tilt": {"bar": 9.0}}}}, "bar 9 is not between 0 and 3.2"),
    ],
)
def test_a_mistake_in_a_suite_is_reported(settings, said):
    with pytest.raises(ValidationError, match=re.escape(said)):
        new_suite({**SETTINGS, **settings})


@pytest.mark.parametrize("group", [TASKS, SCORES])
@pytest.mark.parametrize(
    ("point", "said"),
    [
        ("mine:NOTHING", "cannot be imported: AttributeError"),
        ("no_such_module:X", "cannot be imported: ModuleNotFoundError"),
        ("mine:number", "(mine:number) is a int, no subclass of nw_eval."),
        ("mine:Fraction", "(mine:Fraction) is a ABCMeta, no subclass of nw_eval."),
        ("mine:Other", "(mine:Other) is the "),
    ],
)
def test_a_broken_package_is_reported_where_a_suite_names_it(package, group, point, said):
    bases = {TASKS: REACH.replace("Reach(", "Other("), SCORES: TILT.replace("MaxTilt(", "Other(")}
    more = "\nfrom fractions import Fraction\nnumber = 1\n"
    package("broken", group, {"mine": point}, "")
    package("mine", group, {}, bases[group] + more)
    settings = {"task": "mine"} if group == TASKS else {"scores": ("mine",)}
    with pytest.raises(ValidationError) as caught:
        new_suite({**SETTINGS, **settings})
    assert "plug-in 'mine' of broken (" in str(caught.value)
    assert said in str(caught.value)


def test_a_task_without_settings_and_one_that_refuses_are_reported(package, reach):  # noqa: ARG001
    text = REACH.replace("settings = ReachSettings\n", "settings = dict\n")
    package("reach", TASKS, {"reach": "reach:Reach"}, text)
    with pytest.raises(ValidationError, match=r"plug-in 'reach' of reach .* has no `settings`"):
        new_suite({**SETTINGS, "task": "reach"})


def test_a_task_whose_class_takes_something_else_is_reported_when_it_is_opened(package):
    text = REACH.replace("(self, settings, rules)", "(self, settings)")
    package("reach", TASKS, {"reach": "reach:Reach"}, text)
    suite = new_suite({**SETTINGS, "task": "reach"})
    with pytest.raises(PluginError, match=r"plug-in 'reach' of .* cannot be opened: TypeError"):
        open_task(suite.task, TaskRules())


@pytest.mark.parametrize(
    ("group", "text", "settings"),
    [
        (TASKS, REACH, {"task": "reach"}),
        (SCORES, TILT, {"scores": ("max_tilt",)}),
        (SCORES, TILT, {"gate": {"scores": {"max_tilt": {"bar": 1.0}}}}),
    ],
)
def test_a_name_that_two_packages_claim_is_an_error_that_names_both(package, group, text, settings):
    name, cls = ("reach", "Reach") if group == TASKS else ("max_tilt", "MaxTilt")
    for owner in ("first", "second"):
        package(owner, group, {name: f"{owner}:{cls}"}, text)
    said = (
        f"'{name}' is claimed by two packages: plug-in '{name}' of first (first:{cls}) and "
        f"plug-in '{name}' of second (second:{cls}); uninstall one of them"
    )
    with pytest.raises(ValidationError, match=re.escape(said)):
        new_suite({**SETTINGS, **settings})


@pytest.mark.parametrize(
    ("group", "name", "use"),
    [
        (TASKS, "course", lambda: new_suite({**SETTINGS, "task": "course"})),
        (SCORES, "mean_power", lambda: new_suite({**SETTINGS, "scores": ("mean_power",)})),
        (ROBOTS, "go1", lambda: find_robot("go1")),
    ],
)
def test_a_built_in_name_stays_the_built_in_one(package, group, name, use):
    package("usurper", group, {name: "usurper:X"}, "raise RuntimeError")
    with pytest.warns(PluginWarning, match=f"of usurper .* is ignored: '{name}' is built in"):
        use()


def test_nothing_of_a_package_is_imported_before_a_suite_names_it(package):
    package("loud", TASKS, {"loud": "loud:X"}, "raise RuntimeError('imported')")
    assert "loud" in task_kinds()
    new_suite(SETTINGS)
    with pytest.raises(ValidationError, match="RuntimeError: imported"):
        new_suite({**SETTINGS, "task": "loud"})
