"""Real runs against a baseline: starts in a drawn order, an early end, a resume, other machines.

All rollouts are of the shipped policy, or a softer one, in two scenes, four seconds each.
"""

import os
import re
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from threading import Thread
from time import sleep
from types import MappingProxyType

import numpy as np
import pytest
from command_line import ends

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_base.files.shipped import shipped
from nw_eval import api
from nw_eval.api.plans import rechecked
from nw_eval.cli.verbs.check import forecast_page
from nw_eval.engine import session
from nw_eval.engine.rounds import Attempts
from nw_eval.reporting.headline import headline
from nw_eval.suite import load_suite
from nw_gate.results.baseline import trajectory
from nw_gate.results.baseline_file import baseline_of_run, read_baseline, write_baseline
from nw_gate.results.ended import write_trials
from nw_gate.results.journal import read_journal, write_journal
from nw_gate.results.provenance import StopInfo, read_run_info
from nw_gate.results.row import rows_digest
from nw_gate.results.run_folder import RunFolder

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: go1-parkour
trials: 4
seed: 5
episode: {duration: 4.0}
scenes: [hurdles/one_low_carpet, hurdles/two_logs_park]
record: none
gate:
  {success_rate: 0.05, max_drop: 0.5, tolerate: 0.1, rounds: 4, least_starts: 1, confidence: 0.8}
"""
BASELINE = Path("reports/baselines/quick/shipped.parquet")
LIMP = {
    "control": {"action": "joint_position_offset"},
    "observations": {"body": {"sensor": "proprio", "terms": ["gravity", "joint_pos"]}},
}
ONE_LINE = MappingProxyType({"in_process": True})


class Ears:
    """A listener that remembers lines, and sends Ctrl-C after some trials if it is to."""

    def __init__(self, trials=None):
        self.lines = []
        self.left = trials

    def message(self, text):
        self.lines.append(text)

    def scene(self, name, fraction):
        pass

    def planned(self, *, total, finished):
        pass

    def trial(self, _row):
        if self.left is not None:
            self.left -= 1
            if self.left == 0:
                os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """A folder with a suite, the baseline of its policy, a softer policy, and what both score."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "quick.yaml").write_text(SUITE)
    shutil.copytree(shipped("policies") / "go1-parkour", folder / "soft")
    card = folder / "soft" / "policy.yaml"
    text = card.read_text().replace("kp: 20", "kp: 19").replace("name: go1-parkour", "name: soft")
    card.write_text(text)
    quick = folder / "quick.yaml"
    whole = api.run(quick, out=folder / "whole", baseline="none", in_process=True)
    soft = str(folder / "soft")
    api.run(quick, policy=soft, out=folder / "plain", baseline="none", in_process=True)
    baseline = baseline_of_run(whole.rows, whole.info, name="shipped", card="go1-parkour")
    (folder / BASELINE).parent.mkdir(parents=True)
    write_baseline(folder / BASELINE, baseline)
    return folder


@pytest.fixture(autouse=True)
def project(scored, tmp_path, monkeypatch):
    """A copy of that folder to work in."""
    folder = tmp_path / "project"
    shutil.copytree(scored, folder)
    monkeypatch.chdir(folder)
    return folder


def against(name="run", ears=None, **changes):
    asked_for = {"policy": "./soft", "baseline": "shipped", **ONE_LINE, **changes}
    return api.run("quick.yaml", out=Path(name), listener=ears, **asked_for)


def forged(change):
    """Write the baseline anew, changed."""
    baseline = change(read_baseline(BASELINE))
    BASELINE.unlink()
    write_baseline(BASELINE, baseline)


def elsewhere(baseline):
    """A baseline of another machine type."""
    machine = {**baseline.panels[0].machine, "cpu": "elsewhere"}
    info = baseline.manifest.panels[0].model_copy(update={"machine": machine})
    manifest = baseline.manifest.model_copy(update={"panels": (info,)})
    return replace(
        baseline, manifest=manifest, panels=(replace(baseline.panels[0], machine=machine),)
    )


def other_ways(baseline):
    """A baseline of another machine type, on which its policy goes other ways."""
    starts = tuple(replace(start, trajectory="0" * 16) for start in baseline.panels[0].starts)
    return elsewhere(replace(baseline, panels=(replace(baseline.panels[0], starts=starts),)))


def ran(report):
    """What is the same of the trials of a run whoever runs them, and in whatever order they end."""
    return {row.trial_id: row.digest for row in report.rows}


def test_trials_are_those_of_a_plain_run_in_a_drawn_order_and_end_with_the_one_that_settles_it(
    project,
):
    ears = Ears()
    judged = against(ears=ears)
    plain = {row.trial_id: row for row in read_journal(project / "plain" / "journal.jsonl").rows}
    assert 2 <= len(judged.rows) < 8
    assert [row.digest for row in judged.rows] == [plain[r.trial_id].digest for r in judged.rows]
    order = [(trial.scene, trial.index) for trial in api.plan(
        "quick.yaml", policy="./soft", baseline="shipped"
    ).trials]  # fmt: skip
    assert len(set(order)) == 8
    assert order != sorted(order), "one random order of all pairs"
    count = len(judged.rows)
    assert {(row.scene, row.seed_index) for row in judged.rows} == set(order[:count])

    info = judged.info
    assert (info.run, info.drawn_from) == (2, 4)
    assert (info.stop.first, info.stop.followed) == (count, ())
    assert sum(info.planned.values()) == count
    assert judged.verdict.verdict == "PASS"
    found = judged.verdict.against
    assert (found.basis, found.claim, found.trials, found.budget) == ("panel", "fresh", count, 8)
    assert f"decided after {count} of 8 trials; the rest were skipped" in ears.lines
    assert api.report("run").verdict == judged.verdict
    page = Path("run/report.md").read_text()
    assert f"{count} of at most 8 were judged" in page
    assert "is exactly" not in page, "a part of the panel was drawn"
    assert len(api.read_rows("run")) == count


def test_one_worker_and_two_end_with_the_same_rows_and_the_same_verdict():
    one, two, here = (
        against(name, in_process=in_process, workers=workers)
        for name, workers, in_process in (("one", 1, False), ("two", 2, False), ("here", 1, True))
    )
    assert ran(one) == ran(two)
    assert rows_digest(one.rows) == rows_digest(two.rows) == rows_digest(here.rows)
    assert one.info.stop == two.info.stop == here.info.stop
    assert one.verdict == two.verdict == here.verdict
    # Who looks at the bar too, which comes later, goes on with the same order.
    Path("quick.yaml").write_text(SUITE.replace("success_rate: 0.05", "success_rate: 0.6"))
    more = against("more", workers=2, in_process=False)
    assert len(more.rows) > len(one.rows)
    assert ran(one).items() < ran(more).items()
    assert more.verdict.against.trials == one.verdict.against.trials


def test_a_run_that_was_interrupted_continues_and_ends_with_the_same_trial():
    whole = against("whole-run")
    cut = against("cut", ears=Ears(trials=1))
    assert (cut.interrupted, cut.info.stop) == (True, None)
    assert 1 <= len(cut.rows) < len(whole.rows)
    assert cut.verdict.verdict == "INFRASTRUCTURE"
    assert "--resume runs them" in cut.verdict.reasons[0]
    resumed = api.run(None, resume=Path("cut"), workers=2)
    assert ran(resumed) == ran(whole)
    assert (resumed.info.stop, resumed.verdict) == (whole.info.stop, whole.verdict)


@pytest.mark.nightly
def test_what_a_drop_is_due_to_is_found_in_the_very_trials_of_the_run():
    judged = against(all_rounds=True)
    found = api.find_cause(Path("run"), baseline="shipped", policy="go1-parkour", workers=1)
    again = api.read_rows(found.out / "new-control-new-sight" / "run")
    digests = {row.trial_id: row.state_digest for row in judged.rows}
    assert dict(zip(again.trial_id, again.state_digest, strict=True)) == digests
    assert len(digests) == 8
    first = api.find_cause(Path("run"), baseline="shipped", policy="go1-parkour", trials=1)
    ordered = [trial.id for trial in api.plan(
        "quick.yaml", policy="./soft", baseline="shipped"
    ).trials]  # fmt: skip
    assert set(api.read_rows(first.out / "old-control-old-sight" / "run").trial_id) == set(
        ordered[:2]
    )
    with pytest.raises(UsageError, match="drew its initial states from the 4 of a baseline"):
        api.find_cause(Path("run"), baseline="shipped", policy="go1-parkour", trials=5)
    with pytest.raises(IncomparableError, match="chose its trials"):
        api.run(resume=first.out / "old-control-old-sight" / "run")


def test_a_killed_run_continues_elsewhere_without_the_baseline_and_ends_with_the_same_trial(
    project, tmp_path, monkeypatch
):
    whole = against("whole-run")
    shutil.copytree("whole-run", "cut")
    journal = Path("cut/journal.jsonl")
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:2]))  # The header, and a trial.
    Path("cut/trials.parquet").unlink()
    began = read_run_info(Path("cut/run.json")).model_copy(update={"stop": None})
    session.write_run_info(
        Path("cut/run.json"),
        began.model_copy(update={"finished": None, "rows_digest": "", "trials_sha256": ""}),
    )
    assert api.report("cut").verdict.verdict == "INFRASTRUCTURE", "most of it is missing"
    BASELINE.unlink()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    resumed = api.run(None, resume=project / "cut", in_process=True)
    assert rows_digest(resumed.rows) == rows_digest(whole.rows)
    assert resumed.info.stop == whole.info.stop
    assert resumed.verdict == whole.verdict

    (project / "cut" / "bank" / "shipped.parquet").unlink()
    gone = api.report(project / "cut")
    assert gone.exit_code == 5
    assert "baseline shipped" in gone.verdict.reasons[0]
    assert gone.verdict.reasons[1] == "the bar alone: PASS"
    with pytest.raises(IncomparableError, match="baseline shipped, and neither its copy"):
        api.run(None, resume=project / "cut", in_process=True)


def test_the_policy_of_the_baseline_runs_one_start_of_each_scene_and_the_rest_is_taken_over(capsys):
    assert ends("run", "quick.yaml", "--baseline", "shipped", "--out", "same") == 0
    out, err = capsys.readouterr()
    assert "go1-parkour is the policy of baseline shipped: 1 initial state per scene re-run" in err
    judged = api.report("same")
    over = "2 trials re-run and identical"
    assert f"PASS · same policy as baseline shipped: {over}" in " ".join(out.split())
    assert sorted(row.scene for row in judged.rows) == [
        "hurdles/one_low_carpet",
        "hurdles/two_logs_park",
    ]
    once = {"hurdles/one_low_carpet": 1, "hurdles/two_logs_park": 1}
    assert judged.info.stop == StopInfo(first=2, trials=once)
    assert judged.verdict.against.basis == "same"
    whole = api.report("whole").verdict
    assert (judged.verdict.success, judged.verdict.interval) == (whole.success, whole.interval)
    assert judged.verdict.n == 8
    for page in ("report.md", "report.html"):
        assert over in Path("same", page).read_text()
    assert api.verify("same").exit_code == 0, "the trials that ran are found and run again"
    assert api.run(None, resume=Path("same")).verdict == judged.verdict

    three = api.run("quick.yaml", baseline="shipped", recheck=3, in_process=True, out=Path("three"))
    assert len(three.rows) == 6
    assert "6 trials re-run and identical" in headline(three.verdict, three.info)
    with pytest.raises(UsageError, match="--recheck 0: give at least 1"):
        api.run("quick.yaml", baseline="shipped", recheck=0)
    with pytest.raises(
        IncomparableError,
        match="has 4 initial states in each scene, and 5 trials of each draw more",
    ):
        api.run("quick.yaml", baseline="shipped", recheck=5, in_process=True)

    strict = SUITE.replace("success_rate: 0.05", "success_rate: 0.97")
    Path("quick.yaml").write_text(strict)
    assert api.run("quick.yaml", baseline="shipped", out=Path("below")).exit_code == 1


def as_the_policy(run):
    """What writes into a baseline that the policy of a run is its own, with perfect results."""

    def change(baseline):
        own = {
            name: getattr(run.info.policy, name) for name in ("card_digest", "checkpoint_digest")
        }
        policy = baseline.manifest.policy.model_copy(update=own)
        best = {"success": 1.0, "completed": True, "outcome": "completed"}
        starts = tuple(
            replace(start, **best, waypoints_reached=start.waypoints_total)
            for start in baseline.panels[0].starts
        )
        manifest = baseline.manifest.model_copy(update={"policy": policy})
        return replace(
            baseline, manifest=manifest, panels=(replace(baseline.panels[0], starts=starts),)
        )

    return change


@pytest.mark.parametrize("all_rounds", [False, True])
@pytest.mark.parametrize("place", ["here", "elsewhere"])
def test_a_baseline_that_claims_to_be_the_candidates_own_is_invalid_once_a_start_has_run(
    place, all_rounds
):
    claim = as_the_policy(api.report("plain"))
    # The bits of the policy itself: with other ones nothing is claimed of this machine type.
    own = {(row.scene, row.seed_index): trajectory(row) for row in api.report("plain").rows}

    def with_bits(baseline):
        starts = tuple(
            replace(start, trajectory=own[start.scene, start.seed_index])
            for start in baseline.panels[0].starts
        )
        return replace(baseline, panels=(replace(baseline.panels[0], starts=starts),))

    forged(claim if place == "here" else lambda baseline: elsewhere(with_bits(claim(baseline))))
    shown = against(all_rounds=all_rounds)
    assert shown.rows, "some of it ran"
    assert shown.verdict.verdict == "INVALID"
    assert shown.exit_code == 5
    text = " ".join(shown.verdict.reasons)
    if place == "here":
        assert "is not what its own policy does" in text
        named = r"scene hurdles/\S+ start [0-3]: (success 0\S*, the baseline's 1.0|bits \w{16}, )"
        assert re.search(named, text)
    else:
        assert "the same actions, other results" in text


def test_starts_that_run_again_are_drawn_when_the_run_begins_and_no_file_says_which():
    drawn = {
        tuple(trial.id for trial in rechecked(plan, seed).trials[:2])
        for plan in [api.plan("quick.yaml", baseline="shipped")]
        for seed in range(20)
    }
    assert len(drawn) > 5
    first = api.run("quick.yaml", baseline="shipped", in_process=True, out=Path("first"))
    assert first.info.is_recheck
    more = api.run(None, resume=Path("first"), recheck=3, in_process=True)
    assert {row.trial_id for row in first.rows} < {row.trial_id for row in more.rows}


def test_a_baseline_says_which_of_its_starts_are_not_what_its_policy_does(capsys):
    assert ends("baseline", "verify", BASELINE, "--suite", "quick.yaml", "--share", "25%") == 0
    out = capsys.readouterr().out
    assert "re-run: 2 of 2 trials are identical to the baseline, drawn from 8" in out

    def one_wrong(baseline):
        first = baseline.panels[0].starts[0]
        starts = (
            replace(first, success=0.0, waypoints_reached=0, completed=False, outcome="fell"),
        )
        panel = replace(baseline.panels[0], starts=(*starts, *baseline.panels[0].starts[1:]))
        return replace(baseline, panels=(panel,))

    forged(one_wrong)
    before = sorted(Path().rglob("*"))
    assert ends("baseline", "verify", BASELINE, "--suite", "quick.yaml", "--trials", "8") == 5
    out = capsys.readouterr().out
    assert out.startswith("scene hurdles/one_low_carpet start 0: success ")
    assert "INVALID: 1 row of baseline shipped differs" in out
    assert "re-run: 7 of 8 trials" in out
    assert sorted(Path().rglob("*")) == before, "nothing is written into the project"
    forged(as_the_policy(api.report("plain")))
    with pytest.raises(IncomparableError, match="cannot be verified here: policy c"):
        api.verify_baseline(BASELINE, suite="quick.yaml", policy="go1-parkour")


def test_the_policy_of_the_baseline_drives_all_the_same_where_all_rounds_are_wanted(capsys):
    assert (
        ends("run", "quick.yaml", "--baseline", "shipped", "-n", "1", "--all-rounds", "--out", "d")
        == 0
    )
    assert "come from the baseline" not in capsys.readouterr().out
    judged = api.report("d")
    assert (len(judged.rows), judged.info.stop) == (2, None)
    assert judged.verdict.against.basis == "same"
    assert "2 trials re-run and identical" in headline(judged.verdict, judged.info)
    known = {row.seed: row.state_digest for row in api.report("whole").rows}
    assert all(known[row.seed] == row.state_digest for row in judged.rows)
    assert judged.verdict.verdict == "PASS"


def test_what_runs_again_runs_though_the_cache_of_trials_has_its_results(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("NW_EVAL_CACHE_GB", "1")
    api.run("quick.yaml", baseline="none", workers=1, out=Path("kept"))
    again = api.run("quick.yaml", baseline="shipped", workers=1, out=Path("again"))
    assert [row.cached for row in again.rows] == [False, False]
    every = api.run("quick.yaml", baseline="shipped", workers=1, all_rounds=True, recheck=2)
    ran = [row.scene for row in every.rows if not row.cached]
    assert len(every.rows) == 8
    assert min(ran.count(scene) for scene in set(ran)) >= 2, "the cache may draw one more"
    words = f"re-run and identical, {8 - len(ran)} reused from the cache and identical"
    assert words in headline(every.verdict, every.info)


def test_without_a_baseline_the_first_line_says_what_is_not_judged(monkeypatch):
    ears = Ears()

    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(Attempts, "run", stop)
    with pytest.raises(KeyboardInterrupt):
        against(ears=ears, baseline=None)
    assert "max_drop 0.5 was ignored: ./soft has no baseline in this suite" in ears.lines[0]
    assert "`nw-eval baseline save quick.yaml --policy ./soft`" in ears.lines[0]
    assert any(line.startswith("run folder: ") for line in ears.lines[1:])
    named_baseline = SUITE.replace("  {success_rate", "  {baseline: shipped, success_rate")
    Path("quick.yaml").write_text(named_baseline)
    # It is for the suite's own policy, and for no other.
    assert api.plan("quick.yaml", policy="./soft").against is None
    Path("quick.yaml").write_text(named_baseline.replace("policy: go1-parkour", "policy: ./soft"))
    named = api.plan("quick.yaml", policy="./soft")
    assert (named.against.info.name, named.suite.trials, named.drawn_from) == ("shipped", 4, 4)
    page = forecast_page(api.check("quick.yaml", policy="./soft"))
    assert "(80 % confidence); less than 0.5 below baseline shipped" in page
    assert "2 scenes; a maximum: the run stops when the verdict is decided" in page
    nothing = api.plan("quick.yaml", policy="./soft", baseline="none")
    assert (nothing.against, nothing.drawn_from) == (None, None)
    with pytest.raises(
        IncomparableError,
        match="has 4 initial states in each scene, and 5 trials of each draw more",
    ):
        api.plan("quick.yaml", policy="./soft", trials=5)


def test_a_baseline_that_does_not_hold_is_refused_before_anything_is_run():
    forged(
        lambda baseline: replace(
            baseline,
            manifest=baseline.manifest.model_copy(
                update={
                    "key": baseline.manifest.key.model_copy(
                        update={"simulator": {**baseline.manifest.key.simulator, "mujoco": "3.9"}}
                    )
                }
            ),
        )
    )
    with pytest.raises(
        IncomparableError, match=r"its seed is 6.*its mujoco is 4\.\S+, the baseline's 3"
    ):
        against(seed=6)
    assert not Path("run").exists()


def test_a_fresh_panel_follows_from_the_checkpoint_and_from_nothing_else():
    own = load_suite("quick.yaml")
    soft, hard = (
        api.plan("quick.yaml", policy=policy, panel="fresh") for policy in ("./soft", "go1-parkour")
    )
    assert len({own.seed, soft.suite.seed, hard.suite.seed}) == 3
    met = [(trial.scene, trial.index) for trial in soft.trials]
    assert len(met) == 8
    for scene in {scene for scene, _ in met}:
        own_starts = [index for name, index in met if name == scene]
        assert own_starts == list(range(len(own_starts))), "trials 0, 1, ... of each scene"
    Path("quick.yaml").write_text(SUITE.replace("seed: 5", "seed: 6"))
    assert api.plan("quick.yaml", policy="./soft", panel="fresh").suite.seed == soft.suite.seed
    with pytest.raises(UsageError, match="--seed 3 with --seed-set fresh"):
        api.plan("quick.yaml", panel="fresh", seed=3)

    Path("quick.yaml").write_text(SUITE)
    judged = against(panel="fresh", trials=1)
    assert (judged.info.panel, judged.info.drawn_from) == ("fresh", None)
    assert judged.info.suite["seed"] == soft.suite.seed
    assert judged.verdict.against.basis == "fresh"
    again = api.run(None, resume=Path("run"), in_process=True)
    assert rows_digest(again.rows) == rows_digest(judged.rows)


@pytest.mark.nightly
def test_where_the_baseline_s_bits_are_repeated_its_panel_counts_as_on_its_own_machine():
    seen = against("seen")
    forged(elsewhere)
    ears = Ears()
    judged = against(ears=ears)
    assert "baseline shipped has no results for this machine type" in ears.lines[1]
    own = api.read_rows("run/baseline")
    assert set(own.arm) == {"baseline"}
    order = [trial.id for trial in api.plan(
        "quick.yaml", policy="./soft", baseline="shipped"
    ).trials]  # fmt: skip
    assert set(own.trial_id) == set(order[:16]), "the first of the candidate's order"
    assert judged.info.baseline.checked == "bits"
    assert judged.verdict.against.basis == "panel"
    assert {row.arm for row in judged.rows} == {"candidate"}
    assert judged.verdict.against == seen.verdict.against
    assert ran(judged) == ran(seen)


def test_where_bits_differ_the_baselines_policy_runs_beside_the_candidate_from_the_same_starts():
    forged(other_ways)
    ears = Ears()
    judged = against(ears=ears)
    assert any(
        "slightly different results from the one that saved baseline shipped" in line
        for line in ears.lines
    )
    found = judged.verdict.against
    assert (judged.info.baseline.checked, found.basis, found.claim) == (
        "control",
        "control",
        "fresh",
    )
    assert judged.verdict.verdict == "PASS"
    # As many trials of either arm as were judged, from the same starts.
    own, mine = api.read_rows("run/baseline"), api.read_rows("run")
    assert set(own.trial_id) == set(mine.trial_id)
    assert (found.control, len(mine)) == (found.trials, found.trials)
    known = {row.trial_id: row.state_digest for row in api.report("whole").rows}
    assert dict(zip(own.trial_id, own.state_digest, strict=True)) == {
        name: known[name] for name in own.trial_id
    }
    pairs = own.set_index("trial_id").success - mine.set_index("trial_id").success
    assert found.drop == pytest.approx(pairs.mean())
    page = Path("run/report.md").read_text()
    assert "of go1-parkour that ran here from the same initial states" in page
    assert api.report("run").verdict == judged.verdict
    assert api.judge("run").verdict.against == found
    assert api.verify("run").exit_code == 0


def test_a_run_with_a_control_is_the_same_whatever_the_workers_and_after_an_interrupt():
    forged(other_ways)
    whole = against("whole-run", workers=2, in_process=False)
    one = against("one", workers=1, in_process=False)
    assert ran(one) == ran(whole)
    cut = against("cut", ears=Ears(trials=1))
    assert cut.interrupted
    assert (cut.verdict.verdict, cut.info.baseline.checked) == ("INFRASTRUCTURE", "control")
    resumed = api.run(None, resume=Path("cut"), workers=2)
    assert ran(resumed) == ran(whole)
    for other in (one, resumed):
        assert (other.info.stop, other.verdict) == (whole.info.stop, whole.verdict)
        arm = api.read_rows(other.folder / "baseline")
        assert set(arm.trial_id) == {row.trial_id for row in other.rows}


def test_a_baseline_that_claims_too_much_of_a_machine_with_other_bits_convicts_nobody():
    def perfect(baseline):
        best = {"success": 1.0, "completed": True, "outcome": "completed", "end_reason": ""}
        starts = tuple(
            replace(start, **best, waypoints_reached=start.waypoints_total)
            for start in baseline.panels[0].starts
        )
        return replace(baseline, panels=(replace(baseline.panels[0], starts=starts),))

    Path("quick.yaml").write_text(SUITE.replace("max_drop: 0.5", "max_drop: 0.3, false_alarm: 0.4"))
    forged(perfect)
    here = against("here")
    assert here.verdict.against.word == "REGRESSED"
    forged(other_ways)
    judged = against(all_rounds=True)
    assert judged.verdict.against.word != "REGRESSED"
    assert judged.verdict.exit_code in {0, 3}
    drawn = api.plan("quick.yaml", policy="./soft", baseline="shipped").trials
    compared = [trial.id for trial in drawn[: judged.verdict.against.trials]]
    whole = api.read_rows("whole")
    known = whole[whole.trial_id.isin(compared)].groupby("scene").success.mean()
    assert {item.scene: item.baseline for item in judged.verdict.against.scenes} == pytest.approx(
        dict(known)
    )


def test_ctrl_c_while_the_baseline_s_policy_runs_leaves_a_run_that_continues(monkeypatch):
    forged(elsewhere)
    with monkeypatch.context() as patch:
        patch.setattr(Attempts, "settle", lambda *_: os.kill(os.getpid(), signal.SIGINT))
        cut = against()
    assert (cut.interrupted, cut.verdict.verdict, cut.rows) == (True, "INFRASTRUCTURE", ())
    assert "8 trials missing" in cut.verdict.reasons[0]
    whole = api.run(None, resume=Path("run"), in_process=True)
    assert whole.verdict.verdict == "PASS"
    assert whole.info.baseline.checked == "bits"


@pytest.mark.nightly
def test_ctrl_c_while_more_of_the_control_runs_stops_both_and_both_continue():
    # More pairs than run of the control at first, and so sure a gate that all of them are needed.
    Path("quick.yaml").write_text(
        SUITE.replace("trials: 4", "trials: 12")
        .replace("rounds: 4", "rounds: 12")
        .replace("confidence: 0.6", "confidence: 0.9999")
    )
    whole = api.run("quick.yaml", baseline="none", workers=2, out=Path("more"))
    BASELINE.unlink()
    write_baseline(
        BASELINE, baseline_of_run(whole.rows, whole.info, name="shipped", card="go1-parkour")
    )
    forged(other_ways)
    straight = against("straight", in_process=False, workers=2)
    assert len(straight.rows) > 16
    journal = Path("run/baseline/journal.jsonl")

    def interrupt():
        while not journal.exists() or journal.read_bytes().count(b"\n") < 1 + 17:
            sleep(0.005)
        os.kill(os.getpid(), signal.SIGINT)

    watch = Thread(target=interrupt, daemon=True)
    watch.start()
    cut = against(in_process=False, workers=2)
    watch.join()
    assert cut.interrupted
    assert cut.verdict.verdict == "INFRASTRUCTURE"
    assert len(cut.rows) < len(straight.rows)
    resumed = api.run(None, resume=Path("run"), workers=2)
    assert (ran(resumed), resumed.info.stop) == (ran(straight), straight.info.stop)
    assert resumed.verdict == straight.verdict
    own = api.read_rows("run/baseline")
    assert set(own.trial_id) == set(ran(straight))


@pytest.mark.parametrize("same_bits", [True, False])
def test_on_a_machine_type_that_the_baseline_has_not_seen_its_own_policy_runs_and_is_not_invalid(
    same_bits,
):
    def change(baseline):
        starts = tuple(replace(start, trajectory="0" * 16) for start in baseline.panels[0].starts)
        panel = baseline.panels[0] if same_bits else replace(baseline.panels[0], starts=starts)
        return elsewhere(replace(baseline, panels=(panel,)))

    forged(change)
    judged = against(policy=None)
    assert judged.verdict.verdict == "PASS"
    found = judged.verdict.against.again
    assert (found.equal, found.taken_over) == (same_bits, same_bits)
    assert judged.verdict.n == (8 if same_bits else len(judged.rows))
    assert not Path("run/baseline").exists(), "its own trials show what the baseline is here"
    if not same_bits:
        told = headline(judged.verdict, judged.info)
        assert "same policy as baseline shipped, but this machine or version computes" in told
        said = " ".join(judged.verdict.reasons)
        assert "its trials are compared with the baseline's like those of a new policy" in said


def test_a_small_baseline_cannot_check_a_machine_with_other_results_and_the_run_is_invalid():
    Path("quick.yaml").write_text(SUITE.replace(" least_starts: 1,", ""))
    forged(lambda baseline: elsewhere(other_ways(baseline)))
    judged = against(policy=None)
    assert (judged.verdict.verdict, judged.verdict.exit_code) == ("INVALID", 5)
    assert (
        "has 4 initial states in each scene; a claim about new initial states needs 30"
        in (judged.verdict.reasons[0])
    )
    assert len(judged.rows) == 2, "no further trial would help"
    assert (judged.folder / "report.md").exists()
    # On fresh starts no bits can be the baseline's: that is known before anything runs.
    with pytest.raises(IncomparableError, match="needs 30"):
        against("fresh", policy=None, panel="fresh")


def test_the_same_bits_with_other_results_make_the_run_invalid(capsys):
    def better(baseline):
        best = {"success": 1.0, "completed": True, "outcome": "completed"}
        starts = tuple(
            replace(start, **best, waypoints_reached=start.waypoints_total)
            for start in baseline.panels[0].starts
        )
        return elsewhere(replace(baseline, panels=(replace(baseline.panels[0], starts=starts),)))

    forged(better)
    words = "run quick.yaml --policy ./soft --baseline shipped --out run"
    assert ends(*words.split()) == 5
    out = " ".join(capsys.readouterr().out.split())
    assert "INVALID" in out
    assert "REGRESSED" not in out
    assert "go1-parkour does: the same actions, other results" in out
    assert "the baseline's 1.0" in out
    assert not (Path("run") / "mcap" / "hurdles").exists(), "no trial of the candidate"
    assert api.report("run").exit_code == 5


def test_a_baseline_whose_policy_is_not_here_says_where_to_name_it():
    def lost(baseline):
        policy = baseline.manifest.policy.model_copy(update={"card": "./gone"})
        moved = replace(baseline, manifest=baseline.manifest.model_copy(update={"policy": policy}))
        return elsewhere(moved)

    forged(lost)
    with pytest.raises(IncomparableError, match=r"cannot be run on it: .*gone.*--baseline-policy"):
        against()
    with pytest.raises(IncomparableError, match=r"\./soft is another one: checkpoint 1d9068e0"):
        against("other", baseline_policy="./soft")


@pytest.mark.nightly
def test_an_object_is_compared_with_a_baseline_as_a_policy_by_name_is():
    Path("quick.yaml").write_text(SUITE.replace("max_drop: 0.5", "max_drop: 0.5, false_alarm: 0.2"))
    judged = api.evaluate(lambda _: np.zeros(12), suite="quick.yaml", card=LIMP, baseline="shipped")
    assert (judged.verdict.verdict, judged.baseline.name) == ("REGRESSED", "shipped")
    assert judged.verdict.against.word == "REGRESSED"
    assert len(judged.rows) < 8
    forged(elsewhere)
    again = api.evaluate(lambda _: np.zeros(12), suite="quick.yaml", card=LIMP, baseline="shipped")
    assert (again.verdict.against.basis, again.info.baseline.checked) == ("panel", "bits")


@pytest.mark.nightly
def test_each_cell_of_what_is_perturbed_is_compared_with_the_same_one_of_the_baseline():
    text = SUITE.replace(", hurdles/two_logs_park", "").replace("trials: 4", "trials: 2")
    text = text.replace("max_drop: 0.5", "max_drop: 0.2").replace(
        "record: none", "record: none\nperturb: {friction: [0.25, 1.0]}"
    )
    Path("slippery.yaml").write_text(text.replace("quick", "slippery"))
    whole = api.run("slippery.yaml", baseline="none", in_process=True)
    baseline = baseline_of_run(whole.rows, whole.info, name="shipped", card="go1-parkour")
    write_baseline(Path("slippery.parquet").with_stem("shipped"), baseline)
    judged = api.run(
        "slippery.yaml",
        policy="./soft",
        baseline="./shipped.parquet",
        trials=2,
        in_process=True,
    )
    scenes = judged.verdict.against.scenes
    icy, usual = sorted(scenes, key=lambda one: one.perturbation)
    assert [one.perturbation for one in (icy, usual)] == [
        (("friction", 0.25),),
        (("friction", 1.0),),
    ]
    for scene in scenes:
        known = [row.success for row in whole.rows if row.perturbation == scene.perturbation]
        assert scene.baseline == np.mean(known)
        mine = [row.success for row in judged.rows if row.perturbation == scene.perturbation]
        assert (scene.candidate, scene.trials) == (np.mean(mine), len(mine))
    assert icy.baseline < usual.baseline


def parts_of(number, **changes):
    """Run so many parts of two trials of each scene, on average, against the baseline."""
    words = [f"{index}/{number}" for index in range(1, number + 1)]
    return [against(f"part-{word[0]}", shard=word, trials=2, **changes) for word in words]


@pytest.mark.nightly
def test_parts_run_all_trials_and_are_judged_against_their_baseline_once_they_are_merged(project):
    ears = Ears()
    parts = parts_of(2, ears=ears)
    assert [(part.verdict.verdict, len(part.rows)) for part in parts] == [("RAN", 2), ("RAN", 2)]
    assert not [line for line in ears.lines if "enough" in line]
    assert "part 2 of 2: 2 trials; `nw-eval merge` judges the whole run" in ears.lines
    BASELINE.unlink()  # Every part has a copy, and so has the merged run.
    merged = api.merge(["part-2", "part-1"], out="merged")
    plain = {row.trial_id: row for row in read_journal(project / "plain" / "journal.jsonl").rows}
    assert [row.digest for row in merged.rows] == [plain[r.trial_id].digest for r in merged.rows]
    assert (merged.info.drawn_from, merged.info.stop) == (4, None)
    again = api.judge("merged")
    assert merged.verdict.verdict == again.verdict.verdict
    assert merged.verdict.against == again.verdict.against
    assert merged.verdict.against.word == "PASS"


def test_parts_of_the_baselines_own_policy_run_and_are_compared_with_it_once_they_are_merged():
    parts = parts_of(2, policy="go1-parkour")
    assert [(part.verdict.verdict, len(part.rows)) for part in parts] == [("RAN", 2), ("RAN", 2)]
    merged = api.merge(["part-1", "part-2"], out="merged")
    assert (merged.verdict.verdict, len(merged.rows)) == ("PASS", 4)
    assert "4 trials re-run and identical" in headline(merged.verdict, merged.info)


def test_a_part_sees_for_itself_what_the_baseline_is_on_its_machine():
    forged(elsewhere)
    parts = parts_of(2)
    for part in parts:
        assert part.info.baseline.checked == "bits"
        own = api.read_rows(part.folder / "baseline")
        assert set(own.trial_id) == {row.trial_id for each in parts for row in each.rows}
    merged = api.merge([part.folder for part in parts], out="merged")
    assert (merged.verdict.against.word, merged.info.baseline.checked) == ("PASS", "bits")


def rewritten(folder, change):
    """Write the rows of a run's folder anew, with all sums of theirs."""
    folder = RunFolder(path=folder)
    contents = read_journal(folder.journal)
    rows = change(contents.rows)
    write_journal(folder.journal, contents.header, rows)
    session.write_run_info(
        folder.run_json, write_trials(folder, read_run_info(folder.run_json), rows)
    )


def bits_of(folder):
    """State digest and success of the rows of a folder, by trial."""
    rows = api.read_rows(folder)
    return dict(zip(rows.trial_id, zip(rows.state_digest, rows.success, strict=True), strict=True))


@pytest.mark.parametrize("starts", [2, pytest.param(9, marks=pytest.mark.nightly)])
def test_parts_with_a_control_merge_to_the_rows_and_the_verdict_of_the_run_and_of_its_control(
    starts,
):
    if starts > 4:  # More than all parts look at first.
        Path("quick.yaml").write_text(SUITE.replace("trials: 4", f"trials: {starts}"))
        more = api.run("quick.yaml", baseline="none", workers=2, out=Path("more"))
        BASELINE.unlink()
        write_baseline(
            BASELINE, baseline_of_run(more.rows, more.info, name="shipped", card="go1-parkour")
        )
    forged(other_ways)
    changes = {"trials": starts, "in_process": False}
    whole = against("whole-run", all_rounds=True, workers=2, **changes)
    order = [trial.id for trial in api.plan(
        "quick.yaml", policy="./soft", baseline="shipped", trials=starts
    ).trials]  # fmt: skip
    parts = [
        against(f"part-{index}", shard=f"{index}/3", workers=workers, **changes)
        for index, workers in ((1, 1), (2, 2), (3, 2))
    ]
    for index, part in enumerate(parts):
        assert (part.verdict.verdict, part.info.baseline.checked) == ("RAN", "control")
        # All parts ask the same trials whether bits are others; the rest is its own.
        assert set(bits_of(part.folder / "baseline")) == {*order[:16], *order[index::3]}
        assert set(order[index::3]) == {row.trial_id for row in part.rows}
    BASELINE.unlink()  # Every part has a copy, and so has the merged run.
    merged = api.merge([parts[2].folder, parts[0].folder, parts[1].folder], out="merged")
    assert rows_digest(merged.rows) == rows_digest(whole.rows)
    assert bits_of("merged/baseline") == bits_of("whole-run/baseline")
    assert (merged.verdict, merged.info.stop) == (whole.verdict, whole.info.stop)
    found = merged.verdict.against
    assert (found.basis, found.control, len(merged.rows)) == ("control", 2 * starts, 2 * starts)
    # It is a run like any other, and so is the run beside it.
    shutil.copy("merged/bank/shipped.parquet", BASELINE)
    for name in ("merged", "whole-run"):
        assert api.judge(name).verdict == whole.verdict
        assert api.judge(name, baseline="shipped").verdict == whole.verdict
    assert api.verify("merged").exit_code == 0
    again = api.merge(["merged", "part-2"], out="again")
    assert again.verdict == whole.verdict
    assert bits_of("again/baseline") == bits_of("merged/baseline")


def test_parts_of_machines_with_different_bits_and_parts_without_their_control_are_refused():
    kept = BASELINE.read_bytes()
    forged(elsewhere)
    alike = against("alike", shard="1/2", trials=2)
    BASELINE.write_bytes(kept)
    forged(other_ways)
    cut = against("cut", ears=Ears(trials=1), shard="1/2", trials=2)
    assert (cut.interrupted, cut.info.baseline.checked) == (True, "control")
    one = api.run(None, resume=Path("cut"), in_process=True)
    two = against("part-2", shard="2/2", trials=2)

    def saved(report, folder, **known):
        """A part as another machine would have written it."""
        path = Path(shutil.copytree(report.folder, folder)) / "run.json"
        info = read_run_info(path)
        baseline = info.baseline.model_copy(update=known)
        session.write_run_info(path, info.model_copy(update={"baseline": baseline}))
        return folder

    # Some bits of the baseline's policy are as elsewhere, and those of one machine are not.
    sha256 = two.info.baseline.sha256
    mixed = saved(alike, "mixed", sha256=sha256)
    with pytest.raises(IncomparableError, match=r"^not of one run: the baseline's policy repro"):
        api.merge([mixed, two.folder], out="merged")
    early = saved(one, "early", checked=None)
    with pytest.raises(IncomparableError, match=r"early \(part 1 of 2\) ended before the baseline"):
        api.merge([two.folder, early], out="merged")
    nested = Path(saved(one, "other")) / "baseline"
    rewritten(nested, lambda rows: [replace(row, state_digest="f" * 16) for row in rows])
    with pytest.raises(
        IncomparableError, match=r"^not of one run: trial \S+ of the baseline's pol"
    ):
        api.merge([nested.parent, two.folder], out="merged")
    short = Path(saved(one, "short"))
    rewritten(short / "baseline", lambda rows: [
        row for row in rows if row.trial_id != one.rows[0].trial_id
    ])  # fmt: skip
    with pytest.raises(StoreError, match="lacks 1 trial of its control, the baseline's policy go1"):
        api.merge([short, two.folder], out="merged")
    assert not Path("merged").exists()
    assert api.merge([one.folder, two.folder], out="merged").verdict.against.basis == "control"
