"""How many trials a gate needs: from a baseline, and from the rows of a run; nothing is run."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import ends
from PIL import Image
from saved_runs import info_of, row_of, save

import nw_eval
from nw_base.errors import IncomparableError, UsageError
from nw_eval import api
from nw_eval.suite import load_suite
from nw_gate.limits.ladder import Ladder
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline import (
    BaselineKey,
    BaselinePolicy,
    BaselineResults,
    Manifest,
    Panel,
    PanelInfo,
    Start,
)
from nw_gate.results.baseline_file import read_baseline, write_baseline
from nw_gate.results.provenance import (
    PolicyInfo,
    SceneInfo,
)

SUITE = """\
nw-eval: 1
name: two
robot: go1
policy: stand
trials: 30
seed: 7
episode: {duration: 6.0}
scenes: [flat/carpet_room, hurdles/one_low_carpet]
gate: {max_drop: 0.2, rounds: 20, least_starts: 1}
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    path = tmp_path_factory.mktemp("suite") / "two.yaml"
    path.write_text(SUITE)
    return path


@pytest.fixture(scope="module")
def plan(suite):
    return api.plan(suite)


def reached(index):
    """One trial of ten misses a waypoint."""
    return 3 if index % 10 == 4 else 4


@pytest.fixture(scope="module")
def run(plan, tmp_path_factory):
    """The folder of a run of the suite with 57 of 60 trials whole."""
    suite = plan.suite
    scenes = {
        scene.name: SceneInfo(digest=scene.digest, task=scene.task, trials=30)
        for scene in plan.scenes
    }
    policy = PolicyInfo(name="trot", checkpoint_digest="cc" * 32)
    rows = [row_of(trial, reached(trial.index), policy="trot") for trial in plan.trials]
    path = tmp_path_factory.mktemp("runs") / "week"
    return save(path, info_of(suite, scenes, id="week", policy=policy), rows).path


@pytest.fixture(scope="module")
def baseline(plan, tmp_path_factory):
    """A baseline of the suite with 30 initial states in each scene."""
    path = tmp_path_factory.mktemp("baselines") / "shipped.parquet"
    manifest = Manifest(
        name="shipped",
        suite="two",
        starts=30,
        key=BaselineKey(
            suite_digest=plan.suite.digest,
            seed=7,
            protocol="strict",
            scenes={scene.name: scene.digest for scene in plan.scenes},
            simulator={"mujoco": "4.0.0"},
        ),
        policy=BaselinePolicy(name="trot", card_digest="ca" * 32, checkpoint_digest="cc" * 32),
        panels=(PanelInfo(machine={"cpu": "x"}, saved="now", by="us", rows_digest="00" * 32),),
    )
    starts = sorted(
        (
            Start(
                scene=trial.scene,
                task=trial.task,
                seed_index=trial.index,
                success=reached(trial.index) / 4,
                completed=reached(trial.index) == 4,
                waypoints_reached=reached(trial.index),
                waypoints_total=4,
                outcome="completed" if reached(trial.index) == 4 else "fell",
                end_reason="waypoints",
                trajectory="0" * 16,
            )
            for trial in plan.trials
        ),
        key=lambda start: (start.scene, start.seed_index),
    )
    panel = Panel(machine={"cpu": "x"}, starts=tuple(starts))
    write_baseline(path, BaselineResults(manifest=manifest, panels=(panel,)))
    return path


def test_a_baseline_says_how_many_trials_convict_a_drop(suite, baseline):
    planned = api.plan_trials(suite, baseline=str(baseline), detect=0.4, workers=2)
    assert planned.source == "baseline shipped of trot"
    assert (planned.outset.scenes, planned.outset.starts, planned.outset.known) == (2, 30, True)
    assert planned.outset.baseline == pytest.approx(0.975)
    assert planned.outset.budget == 40
    assert len(planned.dropped.regressed) == 60
    assert planned.dropped.regressed[-1] > 0.95
    assert planned.dropped.regressed[0] < 0.5
    at_margin = next(point for point in planned.curve if point.drop == 0.2)
    assert at_margin.passed <= 0.05 + 0.021
    # 60 trials of at most 6 s, two at a time, at .06 s a second; and the start.
    assert planned.minutes(60) == pytest.approx((4 + 60 * 0.06 * 6 / 2) / 60)


def test_each_gated_score_is_forecast(suite, baseline, tmp_path):
    gated = tmp_path / "gated.yaml"
    asked = "scores: {mean_power: {max_drop: 60, tolerate: 10, range: [0, 300]}}"
    gated.write_text(suite.read_text().replace("rounds: 20", f"rounds: 20, {asked}"))
    plain = read_baseline(baseline)
    (panel,) = plain.panels
    starts = tuple(
        replace(start, scores=(("mean_power", 100.0 + start.seed_index),)) for start in panel.starts
    )
    manifest = plain.manifest.model_copy(update={"scores": ("mean_power",)})
    scored = tmp_path / "shipped.parquet"
    write_baseline(
        scored, BaselineResults(manifest=manifest, panels=(replace(panel, starts=starts),))
    )
    planned = api.plan_trials(gated, baseline=str(scored), detect=0.4, workers=2)
    assert isinstance(planned, api.TrialPlan)
    (found,) = planned.scores
    assert found.spec.name == "mean_power"
    assert found.level == pytest.approx(114.5)
    by_change = {change: (passed, regressed) for change, passed, regressed in found.points}
    assert by_change[0.0] == (1.0, 0.0)
    assert by_change[60.0][0] <= 0.05 + 0.05
    assert by_change[120.0] == (0.0, 1.0)
    assert api.plan_trials(gated, baseline=str(baseline), detect=0.4, workers=2).scores == ()


def test_a_run_is_taken_for_the_baseline_of_a_baseline_that_is_not_there_yet(suite, run):
    planned = api.plan_trials(suite, run=run, workers=2)
    assert planned.source == "run week of trot"
    assert (planned.outset.starts, planned.outset.known) == (200, False), "as a save would take"
    assert planned.detect == 0.2
    again = api.plan_trials(suite, run=run, workers=2)
    assert (planned.curve, planned.dropped) == (again.curve, again.dropped)


def test_without_a_baseline_or_a_run_there_is_nothing_to_plan_with(suite, run):
    with pytest.raises(
        UsageError, match="no baseline to plan with, and has none; name one with --base"
    ):
        api.plan_trials(suite)
    with pytest.raises(UsageError, match="has no baseline 'gone'"):
        api.plan_trials(suite, baseline="gone")
    with pytest.raises(UsageError, match="exclude each other"):
        api.plan_trials(suite, baseline="gone", run=run)


def test_a_suite_that_names_no_baseline_is_planned_with_the_only_one_that_there_is(
    suite, baseline, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    folder = Path("reports/baselines/two")
    folder.mkdir(parents=True)
    shutil.copy(baseline, folder)
    assert api.plan_trials(suite).source == api.plan_trials(suite, baseline=str(baseline)).source
    other = replace(
        read_baseline(baseline),
        manifest=read_baseline(baseline).manifest.model_copy(update={"name": "b"}),
    )
    write_baseline(folder / "b.parquet", other)
    with pytest.raises(UsageError, match=f"no baseline to plan with, and has b, {baseline.stem};"):
        api.plan_trials(suite)


@pytest.mark.parametrize("drop", [0.0, -0.1, 0.975, float("nan")])
def test_a_drop_that_no_policy_has_is_refused(suite, baseline, drop):
    with pytest.raises(UsageError, match=r"mean success is 0\.975; give a drop between"):
        api.plan_trials(suite, baseline=str(baseline), detect=drop)


def test_a_run_or_a_baseline_of_other_scenes_is_refused(suite, run, baseline):
    other = suite.with_name("other.yaml")
    other.write_text(SUITE.replace("flat/carpet_room, ", ""))
    for source in ({"run": run}, {"baseline": str(baseline)}):
        with pytest.raises(IncomparableError, match="flat/carpet_room is in one of them only"):
            api.plan_trials(other, **source)
    other.write_text(SUITE.replace("seed: 7", "seed: 8"))
    with pytest.raises(IncomparableError, match="its suite digest is"):
        api.plan_trials(other, run=run)


def test_a_baseline_that_max_drop_is_too_large_for_is_refused(suite, run):
    other = suite.with_name("lax.yaml")
    other.write_text(SUITE.replace("max_drop: 0.2", "max_drop: 0.98"))
    with pytest.raises(IncomparableError, match=r"no policy can be worse by max_drop 0\.98"):
        api.plan_trials(other, run=run)


def test_with_a_run_the_baseline_that_the_suite_names_need_not_be_there(suite, run):
    other = suite.with_name("named.yaml")
    other.write_text(SUITE.replace("rounds: 20", "rounds: 20, baseline: gone"))
    with pytest.raises(UsageError, match="has no baseline 'gone'"):
        api.plan_trials(other)
    assert api.plan_trials(other, run=run).source == "run week of trot"


def test_the_page_says_trials_minutes_and_the_curve(suite, run, tmp_path, capsys):
    png = tmp_path / "curve.png"
    assert ends("plan", suite, "--run", run, "--detect", "0.4", "--out", str(png)) == 0
    page = capsys.readouterr().out
    assert "two: at most 40 trials in 2 scenes" in page
    assert "a policy 0.4 worse is REGRESSED in 80 % within" in page
    assert "an equally good policy passes in 80 % within" in page
    assert "drop  REGRESSED" in page
    assert page.count("\n0.") == 15
    with Image.open(png) as picture:
        assert picture.size == (800, 560)
    assert png.stat().st_size < 100_000


def test_a_drop_that_no_number_of_trials_convicts_is_called_so(suite, run, capsys):
    assert ends("plan", suite, "--run", run, "--detect", "0.04") == 0
    page = capsys.readouterr().out
    assert "a policy 0.04 worse is REGRESSED at most in" in page
    assert "even with all initial states" in page


SCENES = ("hurdles/one_low_carpet", "flat/carpet_room")
RUNGS = (0.3, 0.34)
RUNG_SCENES = tuple(f"hurdles/bar@{value}" for value in RUNGS)


def climb(tmp_path, *, digest="cc" * 32, protocol="strict"):
    """Return what a search for limits leaves: ten trials at each of two rungs, half completed."""
    path = tmp_path / "rungs.yaml"
    text = SUITE.replace("flat/carpet_room, hurdles/one_low_carpet", ", ".join(RUNG_SCENES))
    text = text.replace("seed: 7", "seed: 8").replace("trials: 30", "trials: 10")
    path.write_text(text + f"protocol: {protocol}\n")
    plan = api.plan(path)
    infos = {
        scene.name: SceneInfo(digest=scene.digest, task=scene.task, trials=10)
        for scene in plan.scenes
    }
    policy = PolicyInfo(name="trot", checkpoint_digest=digest)
    rows = [row_of(trial, 4 if trial.index % 2 else 1, policy="trot") for trial in plan.trials]
    folder = tmp_path / "limits"
    save(folder / "hurdles-bar" / "1", info_of(plan.suite, infos, policy=policy), rows)
    rungs = tuple(rung.value for rung in nw_eval.rungs_of("hurdles/bar"))
    trials = tuple((rungs.index(value), bool(index % 2)) for value in RUNGS for index in range(10))
    limit = Limit(
        ladder=Ladder(name="height of the bars", rungs=rungs, unit="m"),
        share=0.5,
        confidence=0.95,
        width=2,
        trials=trials,
        staked=len(trials),
    )
    entry = {"policy": "trot", "ladder": "hurdles/bar", "run": "hurdles-bar/1"}
    limits = {"nw-limits": 1, "limits": [{**entry, "limit": limit.as_dict()}]}
    (folder / "limits.json").write_text(json.dumps(limits))
    return folder


@pytest.fixture
def climbed(tmp_path):
    return climb(tmp_path)


@pytest.fixture
def fine(suite):
    """The suite with a gate that takes more trials."""
    path = suite.with_name("fine.yaml")
    path.write_text(SUITE.replace("max_drop: 0.2, rounds: 20", "max_drop: 0.15, rounds: 100"))
    return path


def test_a_suite_of_measured_rungs_is_proposed_and_can_be_checked(
    fine, run, climbed, tmp_path, capsys
):
    file = tmp_path / "sharp.yaml"
    words = ["plan", fine, "--run", run, "--limits", climbed, "--write-suite", file]
    assert ends(*words) == 0
    page = capsys.readouterr().out
    assert "adds hurdles/bar@0.3" in page
    assert f"written to {file}" in page
    assert ends("check", file) == 0
    written = load_suite(file)
    assert written.name == "sharp"
    assert set(written.scenes) <= {*SCENES, *RUNG_SCENES}
    assert written.seed == 9, "neither the suite's nor that of the search"
    assert (written.gate.max_drop, written.gate.baseline) == (0.15, None)
    assert written.gate.rounds * len(written.scenes) <= 200


def test_a_proposal_in_another_folder_still_names_the_ladders_of_its_gate(
    suite, run, climbed, tmp_path
):
    own = suite.parent / "my-steps"
    for name, height in (("low", 0.1), ("high", 0.2)):
        scene = {"nw-scene": 1, "name": name, "task": "hurdles", "licence": "MIT"}
        scene["trail"] = [[2.0, 0.0, height], [4.0, 0.0, 0.0]]
        box = {"center": [2.0, 0.0, height / 2], "half_size": [0.5, 1.0, height / 2]}
        (own / name).mkdir(parents=True)
        (own / name / "scene.yaml").write_text(json.dumps(scene))
        (own / name / "collision.yaml").write_text(json.dumps({"boxes": [box]}))
    rungs = [{"value": 0.1, "scene": "low"}, {"value": 0.2, "scene": "high"}]
    text = {"nw-ladder": 1, "name": "lab/steps", "parameter": "step", "unit": "m", "rungs": rungs}
    (own / "ladder.yaml").write_text(json.dumps(text))
    limits = "my-steps: {at_least: 0.1}, my-steps/low+payload: {at_least: 1}"
    gate = f"max_drop: 0.15, rounds: 100, limits: {{{limits}, stairs/up: {{at_least: 0.1}}}}"
    path = suite.with_name("fine.yaml")
    path.write_text(SUITE.replace("max_drop: 0.2, rounds: 20", gate))
    api.check(path)
    file = tmp_path / "written" / "sharp.yaml"
    file.parent.mkdir()
    api.plan_trials(path, run=run, limits=[climbed], write_suite=file)
    api.check(file)
    assert set(load_suite(file).gate.limits) == {
        f"../../{suite.parent.name}/my-steps",
        f"../../{suite.parent.name}/my-steps/low+payload",
        "stairs/up",
    }


def test_a_plan_is_json_with_what_each_scene_tells(fine, run, climbed, capsys):
    assert ends("plan", fine, "--run", run, "--limits", climbed, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert {each["scene"] for each in found["items"]} == {*SCENES, *RUNG_SCENES}
    assert {each["scene"] for each in found["items"] if each["in_suite"]} == {*SCENES}
    proposed = found["proposal"]["proposed"]["worse"]["trials"]
    assert proposed < found["proposal"]["today"]["worse"]["trials"]


def test_without_measured_rungs_the_page_says_what_measures_them(suite, run, capsys):
    assert ends("plan", suite, "--run", run) == 0
    page = capsys.readouterr().out
    assert "nw-eval limits hurdles/bar hurdles/block hurdles/clearance" in page
    assert "Proposed" not in page


def test_what_nothing_can_be_proposed_of_is_said(suite, run, climbed, tmp_path):
    file = tmp_path / "sharp.yaml"
    with pytest.raises(UsageError, match=r"holds no limits \(no limits\.json in it\)"):
        api.plan_trials(suite, run=run, limits=[tmp_path])
    with pytest.raises(UsageError, match="a suite 'two' is what it was planned with"):
        api.plan_trials(suite, run=run, limits=[climbed], write_suite=tmp_path / "two.yaml")
    with pytest.raises(UsageError, match=r"no suite of these scenes finds a drop of 0\.2 in fewer"):
        api.plan_trials(suite, run=run, write_suite=file)
    assert not file.exists()


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"digest": "dd" * 32}, UsageError, "limits of trot and none of trot, whose results"),
        ({"protocol": "neverwhere-2026"}, IncomparableError, "its protocol is neverwhere-2026"),
    ],
)
def test_limits_that_do_not_belong_to_the_results_are_refused(
    suite, run, tmp_path, changes, error, message
):
    with pytest.raises(error, match=message):
        api.plan_trials(suite, run=run, limits=[climb(tmp_path, **changes)])
