"""Runs against a bank: rounds of its starts, an early end, a resume, other machines. Real rollouts.

All of them are of the shipped policy in two scenes, four seconds each, in this process.
"""

from __future__ import annotations

import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from nw_eval import api
from nw_eval.cli import main
from nw_eval.cli.text.judging.forecast import forecast_page
from nw_eval.engine import session
from nw_eval.engine.trials.attempts import Attempts
from nw_eval.errors import IncomparableError, UsageError
from nw_eval.files.shipped import shipped
from nw_eval.results.bank.build import bank_of_run
from nw_eval.results.bank.file import read_bank, write_bank
from nw_eval.results.journal import read_journal
from nw_eval.results.provenance import read_run_info
from nw_eval.results.row import rows_digest
from nw_eval.suite import load_suite

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
gate: {success_rate: 0.05, max_drop: 0.5, tolerate: 0.1, rounds: 4, confidence: 0.6}
"""
BANK = Path("reports/baselines/quick/shipped.parquet")
LIMP = {
    "control": {"action": "joint_position_offset"},
    "observations": {"body": {"sensor": "proprio", "terms": ["gravity", "joint_pos"]}},
}
ONE_LINE = MappingProxyType({"in_process": True})


class Ears:
    """A listener that remembers lines."""

    def __init__(self):
        self.lines = []

    def message(self, text):
        self.lines.append(text)

    def scene(self, name, fraction):
        pass

    def planned(self, *, total, finished):
        pass

    def trial(self, row):
        pass


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """A folder with a suite, the bank of its policy, a softer policy, and what both score."""
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
    bank = bank_of_run(whole.rows, whole.info, name="shipped", card="go1-parkour")
    (folder / BANK).parent.mkdir(parents=True)
    write_bank(folder / BANK, bank)
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
    """Write the bank anew, changed."""
    bank = change(read_bank(BANK))
    BANK.unlink()
    write_bank(BANK, bank)


def elsewhere(bank):
    """A bank of another class of machine."""
    machine = {**bank.panels[0].machine, "cpu": "elsewhere"}
    info = bank.manifest.panels[0].model_copy(update={"machine": machine})
    manifest = bank.manifest.model_copy(update={"panels": (info,)})
    return replace(bank, manifest=manifest, panels=(replace(bank.panels[0], machine=machine),))


@pytest.mark.nightly
def test_rows_of_rounds_are_those_of_a_plain_run_and_end_when_it_is_settled(project):
    ears = Ears()
    judged = against(ears=ears)
    plain = {row.trial_id: row for row in read_journal(project / "plain" / "journal.jsonl").rows}
    assert 2 <= len(judged.rows) < 8
    assert [row.digest for row in judged.rows] == [plain[r.trial_id].digest for r in judged.rows]
    met = [row.seed_index for row in judged.rows if row.scene == "hurdles/one_low_carpet"]
    assert met != list(range(len(met))), "the bank's order"

    info = judged.info
    rounds = len(judged.rows) // 2
    assert (info.drawn_from, info.stopped_after) == (4, rounds)
    assert sum(info.planned.values()) == len(judged.rows)
    assert judged.verdict.verdict == "PASS"
    assert judged.verdict.against.rounds == rounds
    assert f"{8 - 2 * rounds} of 8 trials need not run" in ears.lines[-1]
    assert api.report("run").verdict == judged.verdict
    page = Path("run/report.md").read_text()
    assert f"round {rounds} was enough, and {8 - 2 * rounds} of 8 need not run" in page
    assert "it is known" not in page, "a part of the panel was drawn"
    assert len(api.read_rows("run")) == 2 * rounds


def test_what_a_drop_is_due_to_is_found_in_the_very_trials_of_the_run():
    judged = against(all_rounds=True)
    found = api.find_cause(Path("run"), baseline="shipped", policy="go1-parkour", workers=1)
    again = api.read_rows(found.out / "new-control-new-sight" / "run")
    digests = {row.trial_id: row.state_digest for row in judged.rows}
    assert dict(zip(again.trial_id, again.state_digest, strict=True)) == digests
    assert len(digests) == 8
    first = api.find_cause(Path("run"), baseline="shipped", policy="go1-parkour", trials=1)
    round_ = {row.trial_id for row in judged.rows[:2]}
    assert set(api.read_rows(first.out / "old-control-old-sight" / "run").trial_id) == round_
    with pytest.raises(UsageError, match="drew its starts from the 4 of a bank"):
        api.find_cause(Path("run"), baseline="shipped", policy="go1-parkour", trials=5)
    with pytest.raises(IncomparableError, match="meets the starts of another run"):
        api.run(resume=first.out / "old-control-old-sight" / "run")


def test_a_run_that_was_killed_goes_on_elsewhere_without_the_bank_and_ends_at_the_same_round(
    project, tmp_path, monkeypatch
):
    whole = against("whole-run")
    shutil.copytree("whole-run", "cut")
    journal = Path("cut/journal.jsonl")
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:2]))
    Path("cut/trials.parquet").unlink()
    began = read_run_info(Path("cut/run.json")).model_copy(update={"stopped_after": None})
    session.write_run_info(
        Path("cut/run.json"),
        began.model_copy(update={"finished": None, "rows_digest": "", "trials_sha256": ""}),
    )
    assert api.report("cut").verdict.verdict == "INFRASTRUCTURE", "most of it is missing"
    BANK.unlink()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    resumed = api.run(None, resume=project / "cut", in_process=True)
    assert rows_digest(resumed.rows) == rows_digest(whole.rows)
    assert resumed.info.stopped_after == whole.info.stopped_after
    assert resumed.verdict == whole.verdict

    (project / "cut" / "bank" / "shipped.parquet").unlink()
    gone = api.report(project / "cut")
    assert gone.exit_code == 5
    assert "bank shipped" in gone.verdict.reasons[0]
    assert gone.verdict.reasons[1] == "the bar alone: PASS"
    with pytest.raises(IncomparableError, match="bank shipped, and neither its copy"):
        api.run(None, resume=project / "cut", in_process=True)


def test_the_policy_of_the_bank_passes_without_a_trial_by_what_the_bank_holds(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["run", "quick.yaml", "--baseline", "shipped", "--out", "same"])
    assert caught.value.code == 0
    out, err = capsys.readouterr()
    assert "go1-parkour is the policy of baseline shipped: nothing to run" in err
    assert "PASS" in out
    judged = api.report("same")
    assert (judged.rows, judged.info.stopped_after) == ((), 0)
    assert judged.verdict.against.basis == "same"
    whole = api.report("whole").verdict
    assert (judged.verdict.effect, judged.verdict.interval) == (whole.effect, whole.interval)
    assert judged.verdict.n == 8
    assert "the same policy" in Path("same/report.md").read_text()
    assert "it is known: " in Path("same/report.md").read_text()
    assert "Where the time went" not in Path("same/report.md").read_text()
    assert not Path("same/mcap").exists()
    assert api.run(None, resume=Path("same")).verdict == judged.verdict

    strict = SUITE.replace("success_rate: 0.05", "success_rate: 0.97")
    Path("quick.yaml").write_text(strict)
    assert api.run("quick.yaml", baseline="shipped", out=Path("below")).exit_code == 1


def test_the_policy_of_the_bank_drives_all_the_same_where_all_rounds_are_wanted(capsys):
    with pytest.raises(SystemExit) as caught:
        main(
            ["run", "quick.yaml", "--baseline", "shipped", "-n", "1", "--all-rounds", "--out", "d"]
        )
    assert caught.value.code == 0
    assert "nothing to run" not in capsys.readouterr().err
    judged = api.report("d")
    assert (len(judged.rows), judged.info.stopped_after) == (2, None)
    assert judged.verdict.against.basis == "same"
    known = {row.seed: row.state_digest for row in api.report("whole").rows}
    assert all(known[row.seed] == row.state_digest for row in judged.rows)
    assert judged.verdict.verdict == "PASS"


def test_without_a_bank_the_first_line_says_what_is_not_judged(monkeypatch):
    ears = Ears()

    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(session, "run_trials", stop)
    with pytest.raises(KeyboardInterrupt):
        against(ears=ears, baseline="none")
    assert "max_drop 0.5 was not judged: no baseline is named for ./soft" in ears.lines[0]
    assert "`nw-eval baseline save quick.yaml --policy ./soft`" in ears.lines[0]
    assert ears.lines[1].startswith("run folder: ")
    named_bank = SUITE.replace("gate: {", "gate: {baseline: shipped, ")
    Path("quick.yaml").write_text(named_bank)
    # It is for the suite's own policy, and for no other.
    assert api.plan("quick.yaml", policy="./soft").against is None
    Path("quick.yaml").write_text(named_bank.replace("policy: go1-parkour", "policy: ./soft"))
    named = api.plan("quick.yaml", policy="./soft")
    assert (named.against.info.name, named.suite.trials, named.drawn_from) == ("shipped", 4, 4)
    page = forecast_page(api.check("quick.yaml", policy="./soft"))
    assert "60 % sure; less than 0.5 below baseline shipped" in page
    assert "2 scenes, at most 4 in each" in page
    nothing = api.plan("quick.yaml", policy="./soft", baseline="none")
    assert (nothing.against, nothing.drawn_from) == (None, None)
    with pytest.raises(IncomparableError, match="has 4 starts in each scene, 5 rounds draw more"):
        api.plan("quick.yaml", policy="./soft", trials=5)


def test_a_bank_that_does_not_hold_is_refused_before_anything_is_run():
    forged(
        lambda bank: replace(
            bank,
            manifest=bank.manifest.model_copy(
                update={
                    "key": bank.manifest.key.model_copy(
                        update={"simulator": {**bank.manifest.key.simulator, "mujoco": "3.9"}}
                    )
                }
            ),
        )
    )
    with pytest.raises(
        IncomparableError, match=r"its seed is 6.*its mujoco is 4\.\S+, the bank's 3"
    ):
        against(seed=6)
    assert not Path("run").exists()


def test_a_fresh_panel_follows_from_the_checkpoint_and_from_nothing_else():
    own = load_suite("quick.yaml")
    soft, hard = (
        api.plan("quick.yaml", policy=policy, panel="fresh") for policy in ("./soft", "go1-parkour")
    )
    assert len({own.seed, soft.suite.seed, hard.suite.seed}) == 3
    assert [trial.index for trial in soft.trials[::2]] == list(range(4))
    Path("quick.yaml").write_text(SUITE.replace("seed: 5", "seed: 6"))
    assert api.plan("quick.yaml", policy="./soft", panel="fresh").suite.seed == soft.suite.seed
    with pytest.raises(UsageError, match="--seed 3 with --panel fresh"):
        api.plan("quick.yaml", panel="fresh", seed=3)

    Path("quick.yaml").write_text(SUITE)
    judged = against(panel="fresh", trials=1)
    assert (judged.info.panel, judged.info.drawn_from) == ("fresh", None)
    assert judged.info.suite["seed"] == soft.suite.seed
    assert judged.verdict.against.basis == "fresh"
    again = api.run(None, resume=Path("run"), in_process=True)
    assert rows_digest(again.rows) == rows_digest(judged.rows)


def test_where_the_bank_s_bits_are_repeated_its_panel_is_known_after_a_round():
    forged(elsewhere)
    ears = Ears()
    judged = against(ears=ears)
    assert "has not seen this class of machine" in ears.lines[1]
    own = api.read_rows("run/baseline")
    assert set(own.arm) == {"baseline"}
    assert sorted(own.scene) == ["hurdles/one_low_carpet", "hurdles/two_logs_park"]
    assert judged.info.baseline.checked == "bits"
    assert judged.verdict.against.basis == "panel"
    assert judged.verdict.verdict == "PASS"
    assert {row.arm for row in judged.rows} == {"candidate"}


@pytest.mark.nightly
def test_ctrl_c_while_the_bank_s_policy_runs_leaves_a_run_that_goes_on(monkeypatch):
    forged(elsewhere)
    with monkeypatch.context() as patch:
        patch.setattr(Attempts, "settle", lambda *_: os.kill(os.getpid(), signal.SIGINT))
        cut = against()
    assert (cut.interrupted, cut.verdict.verdict, cut.rows) == (True, "INFRASTRUCTURE", ())
    assert "8 trials missing" in cut.verdict.reasons[0]
    whole = api.run(None, resume=Path("run"), in_process=True)
    assert whole.verdict.verdict == "PASS"
    assert whole.info.baseline.checked == "bits"


def test_other_bits_need_a_bank_large_enough_for_a_sample():
    def other_ways(bank):
        starts = tuple(replace(start, trajectory="0" * 16) for start in bank.panels[0].starts)
        return elsewhere(replace(bank, panels=(replace(bank.panels[0], starts=starts),)))

    forged(other_ways)
    with pytest.raises(IncomparableError, match="has 4 starts in each scene; 4 rounds need 12"):
        against()
    assert not (Path("run") / "mcap" / "hurdles").exists(), "no trial of the candidate"


def test_where_the_bank_s_scores_are_out_of_line_the_run_is_invalid(capsys):
    def worse_there(bank):
        low = {"success": 0.0, "completed": False, "outcome": "fell", "waypoints_reached": 0}
        starts = tuple(
            replace(
                start,
                seed_index=index,
                trajectory="0" * 16,
                **(low if start.scene == "hurdles/one_low_carpet" else {}),
            )
            for start in bank.panels[0].starts[::4]
            for index in range(12)
        )
        manifest = bank.manifest.model_copy(update={"starts": 12})
        panel = replace(bank.panels[0], starts=starts)
        return elsewhere(replace(bank, manifest=manifest, panels=(panel,)))

    forged(worse_there)
    Path("quick.yaml").write_text(SUITE.replace("max_drop: 0.5", "max_drop: 0.2, false_alarm: 0.2"))
    words = "run quick.yaml --policy ./soft --baseline shipped --out run"
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    assert caught.value.code == 5
    out = " ".join(capsys.readouterr().out.split())
    assert "INVALID" in out
    assert "REGRESSED" not in out
    assert "beyond doubt in hurdles/one_low_carpet (1.00, the bank's 0.00)" in out
    assert not (Path("run") / "mcap" / "hurdles").exists(), "no trial of the candidate"
    assert api.report("run").exit_code == 5


def test_a_bank_whose_policy_is_not_here_says_where_to_name_it():
    def lost(bank):
        policy = bank.manifest.policy.model_copy(update={"card": "./gone"})
        moved = replace(bank, manifest=bank.manifest.model_copy(update={"policy": policy}))
        return elsewhere(moved)

    forged(lost)
    with pytest.raises(IncomparableError, match=r"cannot be run on it: .*gone.*--baseline-policy"):
        against()
    with pytest.raises(IncomparableError, match=r"\./soft is another one: checkpoint 1d9068e0"):
        against("other", baseline_policy="./soft")


@pytest.mark.nightly
def test_an_object_is_compared_with_a_bank_as_a_policy_by_name_is():
    judged = api.evaluate(lambda _: np.zeros(12), suite="quick.yaml", card=LIMP, baseline="shipped")
    assert (judged.verdict.verdict, judged.bank.name) == ("REGRESSED", "shipped")
    assert judged.verdict.against.word == "REGRESSED"
    assert len(judged.rows) < 8
    forged(elsewhere)
    again = api.evaluate(lambda _: np.zeros(12), suite="quick.yaml", card=LIMP, baseline="shipped")
    assert (again.verdict.against.basis, again.info.baseline.checked) == ("panel", "bits")


@pytest.mark.nightly
def test_each_cell_of_what_is_perturbed_is_compared_with_the_same_one_of_the_bank():
    text = SUITE.replace(", hurdles/two_logs_park", "").replace("trials: 4", "trials: 2")
    text = text.replace("max_drop: 0.5", "max_drop: 0.2").replace(
        "record: none", "record: none\nperturb: {friction: [0.25, 1.0]}"
    )
    Path("slippery.yaml").write_text(text.replace("quick", "slippery"))
    whole = api.run("slippery.yaml", baseline="none", in_process=True)
    bank = bank_of_run(whole.rows, whole.info, name="shipped", card="go1-parkour")
    write_bank(Path("slippery.parquet").with_stem("shipped"), bank)
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
    """Run so many parts of two rounds against the bank."""
    words = [f"{index}/{number}" for index in range(1, number + 1)]
    return [against(f"part-{word[0]}", shard=word, trials=2, **changes) for word in words]


@pytest.mark.nightly
def test_parts_run_all_rounds_and_are_judged_against_their_bank_once_they_are_merged(project):
    ears = Ears()
    parts = parts_of(2, ears=ears)
    assert [(part.verdict.verdict, len(part.rows)) for part in parts] == [("RAN", 2), ("RAN", 2)]
    assert not [line for line in ears.lines if "enough" in line]
    assert "part 2 of 2: 2 trials of all 2 rounds; `nw-eval merge` judges the whole" in ears.lines
    BANK.unlink()  # Every part has a copy, and so has the merged run.
    merged = api.merge(["part-2", "part-1"], out="merged")
    plain = {row.trial_id: row for row in read_journal(project / "plain" / "journal.jsonl").rows}
    assert [row.digest for row in merged.rows] == [plain[r.trial_id].digest for r in merged.rows]
    assert (merged.info.drawn_from, merged.info.stopped_after) == (4, None)
    again = api.judge("merged")
    assert merged.verdict.verdict == again.verdict.verdict
    assert merged.verdict.against == again.verdict.against
    assert merged.verdict.against.word == "PASS"


def test_parts_of_the_baselines_own_policy_have_nothing_to_run_and_pass_together():
    parts = parts_of(2, policy="go1-parkour")
    assert [(part.verdict.verdict, len(part.rows)) for part in parts] == [("RAN", 0), ("RAN", 0)]
    merged = api.merge(["part-1", "part-2"], out="merged")
    assert (merged.verdict.verdict, len(merged.rows)) == ("PASS", 0)


@pytest.mark.nightly
def test_a_part_sees_for_itself_what_the_bank_is_on_its_machine():
    forged(elsewhere)
    parts = parts_of(2)
    for part in parts:
        assert part.info.baseline.checked == "bits"
        assert read_run_info(part.folder / "baseline" / "run.json").shard is None
    merged = api.merge([part.folder for part in parts], out="merged")
    assert (merged.verdict.against.word, merged.info.baseline.checked) == ("PASS", "bits")
