"""Limits in a gate, from a saved baseline to the verdict, with a policy and its weakened copies."""

import json
import shutil
from dataclasses import replace

import pytest

from nw_base.errors import StoreError, SuiteError
from nw_eval import api
from nw_eval.cli import main
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline_file import read_baseline, write_baseline
from nw_gate.results.provenance import read_run_info
from nw_gate.results.run_folder import RunFolder, check_plain
from nw_policies import find_card

SUITE = """\
nw-eval: 1
name: steps
robot: go1
policy: go1-parkour
trials: 6
seed: 7
record: none
scenes: [hurdles/one_low_carpet]
gate:
  baseline: go1-parkour
  max_drop: 0.3
  limits:
    stairs/up: {max_drop: 0.04}
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A suite with a limit, its baseline, and the same policy with four fifths of its stiffness."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "steps.yaml").write_text(SUITE)
    shutil.copytree(find_card("go1-parkour").parent, folder / "soft")
    card = folder / "soft/policy.yaml"
    card.write_text(card.read_text().replace("kp: 20", "kp: 16"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        saved = api.save_baseline("./steps.yaml", trials=30, workers=2)
    assert saved.action == "new"
    return folder


@pytest.fixture(autouse=True)
def _here(project, monkeypatch):
    """Commands are typed in the project's folder."""
    monkeypatch.chdir(project)


@pytest.fixture(scope="module")
def soft(project, tmp_path_factory):
    """The judged run of the softer policy."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        return run(tmp_path_factory.mktemp("soft") / "run")


def run(out, policy="./soft", **changes):
    return api.run("./steps.yaml", policy=policy, baseline="go1-parkour", out=out, **changes)


def exit_code(*argv):
    with pytest.raises(SystemExit) as left:
        main([str(each) for each in argv])
    return left.value.code


def steps(found):
    (limit,) = found.verdict.limits
    return limit


def test_a_baseline_has_the_limit_of_each_ladder_that_its_suite_names(project):
    saved = read_baseline(project / "reports/baselines/steps/go1-parkour.parquet")
    limit = Limit.from_dict(saved.manifest.limits["stairs/up"].limit)
    # On fixed rungs, 24 trials each, this policy completes 23 at 0.20 m, 17 at 0.22, 0 at 0.24.
    assert (limit.lower.value, limit.upper.value) in {(0.20, 0.24), (0.20, 0.22), (0.22, 0.24)}
    assert limit.confidence == pytest.approx(1 - 0.005 / 1.995), "false_alarm is shared by two"


def test_saving_again_measures_nothing():
    again = api.save_baseline("./steps.yaml", trials=30)
    assert again.action == "unchanged"


@pytest.mark.nightly
def test_verifying_a_baseline_covers_its_limits_and_a_diff_shows_them(project, tmp_path, capsys):
    file = project / "reports/baselines/steps/go1-parkour.parquet"
    saved = read_baseline(file)
    kept = saved.manifest.limits["stairs/up"]
    options = ("--trials", "100%", "--suite", "./steps.yaml")
    assert exit_code("baseline", "verify", file, *options) == 0
    count = 30 + len(kept.limit["trials"])
    said = f"re-run: {count} of {count} trials are identical to the baseline, drawn from {count}"
    assert said in capsys.readouterr().out
    # The first trial of the ladder is said to have ended otherwise.
    (rung, done), *others = kept.limit["trials"]
    limit = {**kept.limit, "trials": [[rung, 1 - done], *others]}
    limits = {"stairs/up": kept.model_copy(update={"limit": limit})}
    other = tmp_path / "go1-parkour.parquet"
    manifest = saved.manifest.model_copy(update={"limits": limits})
    write_baseline(other, replace(saved, manifest=manifest))
    assert (
        exit_code("baseline", "verify", other, "--trials", "100%", "--suite", "./steps.yaml") == 5
    )
    printed = capsys.readouterr().out
    assert f"completed {bool(1 - done)} -> {bool(done)}" in printed
    assert "1 row of baseline go1-parkour differs" in printed
    manifest = saved.manifest.model_copy(update={"limits": {}})
    write_baseline(other, replace(saved, manifest=manifest))
    assert exit_code("baseline", "diff", file, other) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    (line,) = [line for line in lines if line[:1] == ["stairs/up"]]
    assert line[-1] == "none"


def test_a_policy_whose_limit_is_lower_is_regressed_within_twenty_trials_of_the_ladder(soft):
    limit = steps(soft)
    assert limit.word == "REGRESSED"
    assert soft.verdict.verdict == "REGRESSED"
    assert soft.exit_code == 1
    assert "the limit of stairs/up" in soft.verdict.regressed_by
    assert len(limit.candidate.trials) <= 20
    assert limit.candidate.upper.value <= 0.20


def test_candidate_and_baseline_met_other_initial_states(project, soft):
    saved = read_baseline(project / "reports/baselines/steps/go1-parkour.parquet")
    tried = Limit.from_dict(saved.manifest.limits["stairs/up"].limit).tried
    (nested,) = (soft.folder / "limits/stairs-up").iterdir()
    rungs = json.loads((nested / "ladder.json").read_text())["cells"]
    first = {scene: tried[number] for number, (scene, _) in enumerate(rungs)}
    rows = api.report(nested).rows
    assert rows
    assert all(row.seed_index >= first[row.scene] for row in rows)


def test_a_report_of_the_run_says_the_same_from_its_rows(soft):
    again = api.report(soft.folder)
    assert steps(again) == steps(soft)
    assert again.verdict.verdict == "REGRESSED"


def test_pages_and_json_have_the_limit_in_metres(soft, capsys):
    table = " ".join((soft.folder / "report.md").read_text().split())
    assert "| stairs/up | none |" in table
    assert "max\\_drop 0.04 m" in table or "max_drop 0.04 m" in table
    assert 'id="limits"' in (soft.folder / "report.html").read_text()
    assert exit_code("report", soft.folder, "--json") == 1
    shown = json.loads(capsys.readouterr().out)["limits"]["stairs/up"]
    assert (shown["verdict"], shown["unit"], shown["cleared"]) == ("REGRESSED", "m", None)
    assert shown["baseline_cleared"] >= 0.20


def test_junit_has_a_case_for_the_ladder(soft, tmp_path):
    assert exit_code("report", soft.folder, "--junit", tmp_path / "out.xml") == 1
    text = (tmp_path / "out.xml").read_text()
    assert '<testcase name="stairs/up" classname="nw.steps"' in text
    assert 'type="regressed"' in text


def test_verify_covers_the_trials_of_the_ladder(soft, tmp_path):
    copied = tmp_path / "run"
    shutil.copytree(soft.folder, copied)
    assert api.verify(copied, trials=1, policy="./soft").exit_code == 0
    journal = copied / "limits/stairs-up/candidate/journal.jsonl"
    journal.write_text(journal.read_text().replace('"completed":false', '"completed":true', 1))
    assert api.verify(copied, offline=True).exit_code == 4


def test_the_baselines_own_policy_has_its_limit_without_a_trial(tmp_path):
    found = run(tmp_path / "same", policy="go1-parkour")
    assert (steps(found).word, found.verdict.verdict) == ("PASS", "PASS")
    assert steps(found).candidate is None
    assert not (found.folder / "limits").exists()


def test_parts_are_merged_with_the_ladder_that_the_first_one_climbed(soft, tmp_path):
    parts = [run(tmp_path / f"{i}", shard=f"{i}/2") for i in (1, 2)]
    assert (parts[0].folder / "limits").exists()
    assert not (parts[1].folder / "limits").exists()
    merged = api.merge([part.folder for part in parts], out=tmp_path / "whole")
    assert steps(merged).word == "REGRESSED"
    assert steps(merged).candidate == steps(soft).candidate


def test_a_climb_that_was_cut_goes_on_with_resume(soft, tmp_path):
    cut = tmp_path / "cut"
    shutil.copytree(soft.folder, cut)
    shutil.rmtree(cut / "limits")
    assert steps(api.report(cut)).word == "INFRASTRUCTURE"
    assert api.report(cut).exit_code == 4
    resumed = api.run(resume=cut)
    assert steps(resumed).candidate == steps(soft).candidate
    assert resumed.verdict.verdict == "REGRESSED"


@pytest.mark.nightly
def test_where_the_saved_limit_does_not_hold_the_baselines_policy_climbs_first(project, tmp_path):
    file = project / "reports/baselines/steps/go1-parkour.parquet"
    saved = read_baseline(file)
    limits = {
        name: limit.model_copy(update={"machine": {"processor": "another"}})
        for name, limit in saved.manifest.limits.items()
    }
    other = tmp_path / "go1-parkour.parquet"
    manifest = saved.manifest.model_copy(update={"limits": limits})
    write_baseline(other, replace(saved, manifest=manifest))
    found = api.run("./steps.yaml", policy="./soft", baseline=str(other), out=tmp_path / "run")
    limit = steps(found)
    assert limit.word == "REGRESSED"
    assert limit.baseline == Limit.from_dict(saved.manifest.limits["stairs/up"].limit)
    nested = read_run_info(found.folder / "limits/stairs-up/baseline/run.json")
    assert nested.policy.name == "go1-parkour"


def test_at_least_needs_no_baseline(tmp_path):
    text = SUITE.replace("  baseline: go1-parkour\n  max_drop: 0.3\n", "")
    for least, word, code in ((0.16, "PASS", 0), (0.26, "REGRESSED", 1)):
        suite = tmp_path / f"{least}.yaml"
        suite.write_text(text.replace("{max_drop: 0.04}", f"{{at_least: {least}}}"))
        found = api.run(suite, out=tmp_path / f"{least}", record="none")
        assert (steps(found).word, found.verdict.verdict, found.exit_code) == (word, word, code)
        assert len(steps(found).candidate.trials) <= 15


def test_without_a_baseline_a_drop_is_not_judged_and_the_reason_says_so(tmp_path):
    found = api.run("./steps.yaml", policy="./soft", out=tmp_path / "run", baseline="none")
    assert steps(found).word is None
    assert any("max_drop is not judged without a baseline" in x for x in found.verdict.reasons)


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ("stairs/upp: {max_drop: 0.04}", "there is no ladder 'stairs/upp'"),
        ("stairs/up: {at_least: 9}", "at_least 9 m is beyond the hardest rung"),
        (
            "open/field+turn_rate: {max_drop: 0.2}",
            r"open/field\+turn_rate: the policy does not observe yaw",
        ),
        ("stairs/up: {max_drop: 0.04, trials: 4}", "4 trials cannot decide .* needs 5 at least"),
        ("stairs/up: {}", "neither at_least nor max_drop is set"),
        ("stairs/up: {max_drop: 0.04, tolerate: 0.1}", "tolerate 0.1 is over max_drop"),
        ("stairs/up: {max_dropp: 0.04}", "max_dropp"),
    ],
)
def test_a_limit_that_cannot_be_used_is_said_at_its_line(limits, said, tmp_path):
    suite = tmp_path / "steps.yaml"
    suite.write_text(SUITE.replace("stairs/up: {max_drop: 0.04}", limits))
    with pytest.raises(SuiteError, match=said) as error:
        api.check(suite)
    assert error.value.problems[0].line == 13


def test_a_damaged_file_of_the_ladder_is_named(soft, tmp_path, capsys):
    copied = tmp_path / "run"
    shutil.copytree(soft.folder, copied)
    file = copied / "limits/stairs-up/candidate/ladder.json"
    file.write_text(file.read_text().replace('"cells"', '"sells"'))
    assert exit_code("report", copied) == 4
    assert "ladder.json is damaged" in capsys.readouterr().err


def test_compare_puts_limits_side_by_side(project, soft):
    file = project / "reports/baselines/steps/go1-parkour.parquet"
    found = api.compare([file, soft.folder])
    first, second = found.limits["stairs/up"]
    assert first.lower.value >= 0.20
    assert second == steps(soft).candidate


def test_the_runs_on_a_ladder_of_another_policy_are_refused(soft, tmp_path):
    other = run(tmp_path / "other", policy="stand")
    shutil.rmtree(other.folder / "limits")
    shutil.copytree(soft.folder / "limits", other.folder / "limits")
    with pytest.raises(StoreError, match=r"is not of this run: its policy is "):
        api.report(other.folder)


def test_rungs_with_other_values_than_the_ladder_has_are_refused(soft, tmp_path):
    copied = tmp_path / "run"
    shutil.copytree(soft.folder, copied)
    file = copied / "limits/stairs-up/candidate/ladder.json"
    said = json.loads(file.read_text())
    file.write_text(json.dumps({**said, "rungs": [2 * value for value in said["rungs"]]}))
    with pytest.raises(StoreError, match=r"is the rung 0\.08 of stairs/up, not 0\.16"):
        api.report(copied)


def test_links_to_reused_logs_of_a_ladder_are_the_runs_own(soft, tmp_path):
    copied = tmp_path / "run"
    shutil.copytree(soft.folder, copied)
    nested = copied / "limits/stairs-up/candidate"
    for name in ("mcap", "cached"):
        (nested / name / "one").mkdir(parents=True)
    (nested / "cached/one/two.mcap").write_bytes(b"log")
    (nested / "mcap/one/two.mcap").symlink_to("../../cached/one/two.mcap")
    check_plain(RunFolder(path=copied))
    (nested / "mcap/one/three.mcap").symlink_to("../../../../../run.json")
    with pytest.raises(StoreError, match=r"three\.mcap is a symbolic link"):
        check_plain(RunFolder(path=copied))


def test_a_run_without_a_baseline_goes_on_with_one(tmp_path):
    alone = api.run("./steps.yaml", policy="./soft", baseline="none", out=tmp_path / "run")
    assert steps(alone).word is None
    found = api.run(resume=alone.folder, baseline="go1-parkour")
    assert steps(found).word == "REGRESSED"
