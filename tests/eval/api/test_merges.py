"""Parts of a run put together: the run that it would have been, or one line that says why not.

Rows are drawn, and logs are a few bytes; test_parts.py runs real parts.
"""

import json
import os
import random
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import ends
from saved_runs import info_of, row_of, save

from nw_base.errors import IncomparableError, NwEvalError, StoreError, UsageError
from nw_eval import api
from nw_eval.engine.order import in_order, shard_of
from nw_eval.suite import expand, new_suite
from nw_gate.results.journal import read_journal
from nw_gate.results.parquet import read_rows
from nw_gate.results.provenance import (
    CacheInfo,
    PolicyInfo,
    SceneInfo,
    code_info,
    machine_info,
)
from nw_gate.results.request import Request, Shard
from nw_gate.results.row import rows_digest

PLACES = [
    SimpleNamespace(name=f"hurdles/{name}", task="hurdles", digest=2 * name[0] * 16)
    for name in ("aa", "bb", "cc")
]
GATE = {"success_rate": 0.3, "tiers": {"hurdles/aa": "critical"}}
ENGINE = {"mujoco": "4.0.0", "cpu": "some", "code": "c0de"}
LOG = b"what happened"


def suite_of(**changes):
    facts = {"name": "quick", "robot": "go1", "policy": "stand", "seed": 5, "scenes": ["hurdles/*"]}
    return new_suite({"nw-eval": 1, **facts, "trials": 4, "gate": GATE, **changes})


def logged_row(trial):
    return row_of(trial, mcap_path=f"mcap/{trial.scene}/{trial.id}.mcap", mcap_bytes=len(LOG))


@pytest.fixture
def written(tmp_path):
    """Return what writes the folder of a part: `written("one", "1/3", row=..., **of run.json)`."""

    def write(name, of=None, *, rows=row_of, suite=None, places=PLACES, ended=True, **facts):
        suite = suite or suite_of()
        trials, shard = shard_of(expand(suite, places), Shard.of(of) if of else None)
        counts = Counter(trial.scene for trial in trials)
        scenes = {
            place.name: SceneInfo(digest=place.digest, task=place.task, trials=counts[place.name])
            for place in places
        }
        facts = {
            "finished": "2026-11-22T11:01:05Z",
            "wall_s": 60.0,
            "request": Request(suite="quick", shard=of),
            "policy": PolicyInfo(name="stand", card_digest="p", checkpoint_digest="cc" * 32),
            "shard": shard,
            "code": code_info(),
            "machine": machine_info(),
            "engine": ENGINE,
            **facts,
        }
        kept = [row for trial in in_order(trials) if (row := rows(trial)) is not None]
        for row in kept:
            if row.mcap_path == f"mcap/{row.scene}/{row.trial_id}.mcap":
                log = tmp_path / name / row.mcap_path
                log.parent.mkdir(parents=True, exist_ok=True)
                log.write_bytes(LOG)
        return save(
            tmp_path / name, info_of(suite, scenes, id=name, **facts), kept, ended=ended
        ).path

    return write


@pytest.fixture
def logged(written):
    return [written(f"part-{index}", f"{index}/3", rows=logged_row) for index in (1, 2, 3)]


@pytest.fixture
def parts(written):
    return [written(f"part-{index}", f"{index}/3") for index in (1, 2, 3)]


def bytes_of(folder):
    return [(folder / name).read_bytes() for name in ("journal.jsonl", "trials.parquet")]


def test_a_merged_run_is_the_run_without_parts_whatever_order_and_however_often(
    parts, written, tmp_path
):
    whole = written("whole")
    first, second, third = parts
    merged = api.merge(parts, out=tmp_path / "a" / "merged")
    assert merged.verdict.verdict == "PASS"
    assert (merged.verdict.n, merged.verdict.planned) == (12, 12)
    assert merged.info.rows_digest == api.report(whole).info.rows_digest
    assert read_journal(merged.folder / "journal.jsonl").rows == merged.rows
    for number, runs in enumerate(
        (
            [third, first, second],
            [first, second, second, third, first],
            [third, merged.folder, first],
        )
    ):
        again = api.merge(runs, out=tmp_path / str(number) / "merged")
        assert bytes_of(again.folder) == bytes_of(merged.folder)
        assert again.info.parts == merged.info.parts
        assert again.verdict == merged.verdict
    assert [str(part.shard) for part in merged.info.parts] == [f"part {k} of 3" for k in (1, 2, 3)]
    assert (merged.info.wall_s, merged.info.shard, merged.info.request.shard) == (180.0, None, None)


def test_a_merged_folder_is_judged_again_and_anything_else_in_the_way_is_left_alone(
    parts, tmp_path
):
    out = tmp_path / "merged"
    merged = api.merge(parts, out=out)
    before = bytes_of(out)
    assert api.merge([*parts, out], out=out).verdict == merged.verdict
    assert bytes_of(out) == before
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "precious").write_text("a thing")
    for where, why in (
        (taken, "is not empty, and no merged run"),
        (parts[0], "already holds another run"),
    ):
        with pytest.raises(UsageError, match=f"{why}.*choose another folder with --out"):
            api.merge(parts, out=where)
    assert [path.name for path in taken.iterdir()] == ["precious"]
    assert not [path.name for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_part_that_is_missing_is_named(parts, tmp_path):
    with pytest.raises(StoreError, match=r"4 trials of 12 missing: there is no part 2 of 3 \(4 tr"):
        api.merge([parts[0], parts[2]], out=tmp_path / "merged")
    with pytest.raises(StoreError, match=r"no part 1 of 3 .*; there is no part 3 of 3 "):
        api.merge([parts[1]], out=tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_trials_that_a_part_lacks_are_named_with_what_runs_them(parts, written, tmp_path):
    seen = []

    def some(trial):
        seen.append(trial.id)
        return row_of(trial) if len(seen) < 3 else None

    cut = written("cut", "2/3", rows=some, ended=False, interrupted=True)
    with pytest.raises(StoreError) as caught:
        api.merge([parts[0], cut, parts[2]], out=tmp_path / "merged")
    assert str(caught.value) == (
        f"2 trials of 12 missing: {cut} (part 2 of 3) lacks 2 trials, first {seen[2]}; "
        f"`--resume {cut}` runs them; merge once every part has run to its end"
    )
    # What another folder has of it is missing no more.
    assert api.merge([parts[0], cut, parts[1], parts[2]], out=tmp_path / "merged").passed


def test_two_results_of_one_trial_are_refused_with_the_names_of_both_folders(
    parts, written, tmp_path
):
    changed = []

    def better(trial):
        changed.append(trial.id)
        return row_of(trial, reached=3 if len(changed) == 2 else 4)

    other = written("tampered", "2/3", rows=better)
    with pytest.raises(StoreError) as caught:
        api.merge([*parts, other], out=tmp_path / "merged")
    message = str(caught.value)
    assert f"trial {changed[1]} has two different results: " in message
    assert f"in {parts[1]} (part 2 of 3)" in message
    assert f"in {other} (part 2 of 3)" in message
    assert "\n" not in message


def test_what_only_clocks_and_hosts_say_of_a_result_is_taken_from_one_folder_in_any_order(
    parts, written, tmp_path
):
    twin = written("twin", "2/3", rows=lambda trial: row_of(trial, host="b", wall_s=1.0))
    one = api.merge([*parts, twin], out=tmp_path / "x" / "merged")
    two = api.merge([twin, *reversed(parts)], out=tmp_path / "y" / "merged")
    assert bytes_of(one.folder) == bytes_of(two.folder)
    assert len(one.info.parts) == 4


CHANGED = {
    "mujoco": ({"engine": {**ENGINE, "mujoco": "4.1.0"}}, "mujoco is 4.0.0 in .*, 4.1.0 in"),
    "cpu": ({"engine": {"mujoco": "4.0.0", "code": "c0de"}}, "cpu is some in .*, none in"),
    "checkpoint": (
        {"policy": PolicyInfo(name="stand", card_digest="p", checkpoint_digest="dd" * 32),
         "rows": lambda trial: row_of(trial, checkpoint_digest="dd" * 32)},
        "checkpoint is cccc.* in .*, dddd",
    ),
    "suite": ({"suite": suite_of(seed=6)}, "suite.seed is 5 in .*, 6 in"),
    "gate": ({"suite": suite_of(gate={"success_rate": 0.2})}, "suite.gate is {'success_rate': 0.3"),
    "trials": ({"suite": suite_of(trials=5)}, "suite.trials is 4 in .*, 5 in .*; plan is"),
    "scene": ({"places": [SimpleNamespace(name="hurdles/aa", task="hurdles",
                                                     digest="ee" * 32), *PLACES[1:]]},
              "scene hurdles/aa is aaaa.* in .*, eeee"),
    "a scene more": ({"places": PLACES[:2]}, "scene hurdles/cc is cccc.* in .*, none in"),
    "panel": ({"panel": "fresh"}, "panel is pinned in .*, fresh in"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGED)
def test_parts_of_different_runs_are_refused_field_by_field(name, parts, written, tmp_path):
    changes, words = CHANGED[name]
    other = written("other", "3/3", **changes)
    with pytest.raises(IncomparableError, match=f"^not of one run: .*{words}") as caught:
        api.merge([parts[0], parts[1], other], out=tmp_path / "merged")
    assert f"in {parts[0]} (part 1 of 3), " in str(caught.value)
    assert f"in {other} (part 3 of 3)" in str(caught.value)


def test_parts_of_another_number_and_whole_runs_and_nothing_are_refused(parts, written, tmp_path):
    half = written("half", "2/2")
    with pytest.raises(IncomparableError, match=r"number of parts is 3 in .*, 2 in .*half"):
        api.merge([parts[0], half], out=tmp_path / "merged")
    whole = written("whole")
    with pytest.raises(
        UsageError, match="whole is not a part of a run: all of its trials ran together"
    ):
        api.merge([*parts, whole], out=tmp_path / "merged")
    with pytest.raises(UsageError, match="nothing to merge"):
        api.merge([], out=tmp_path / "merged")
    only = api.merge([written("only", "1/1")], out=tmp_path / "merged")
    assert only.info.rows_digest == api.report(whole).info.rows_digest


def test_errors_stay_errors_until_a_later_attempt_has_a_result(parts, written, tmp_path):
    def failing(trial):
        return row_of(trial, reached=None, error_type="crashed", error_text="signal 11")

    crashed = written("crashed", "2/3", rows=failing)
    merged = api.merge([parts[0], crashed, parts[2]], out=tmp_path / "merged")
    assert (merged.verdict.verdict, merged.exit_code) == ("INFRASTRUCTURE", 4)
    assert merged.verdict.errors == 4
    again = written("again", "2/3", rows=lambda trial: replace(failing(trial), attempt=2))
    twice = api.merge([again, parts[0], crashed, parts[2]], out=tmp_path / "twice")
    assert {row.attempt for row in twice.rows if row.status == "error"} == {2}
    assert api.merge([crashed, merged.folder, *parts], out=tmp_path / "whole").passed


def test_logs_are_linked_and_what_is_not_there_is_said(logged, tmp_path):
    lost, short = sorted(logged[1].rglob("*.mcap"))[:2]
    lost.unlink()
    short.write_bytes(LOG[:-1])
    merged = api.merge(logged, out=tmp_path / "merged")
    assert "2 logs missing, or not of the size in its row: " in merged.verdict.reasons[-1]
    logs = list(merged.folder.rglob("*.mcap"))
    assert len(logs) == 10
    assert all(log.read_bytes() == LOG and log.stat().st_nlink == 2 for log in logs)
    there = {log.relative_to(part) for part in logged for log in part.rglob("*.mcap")}
    assert {log.relative_to(merged.folder) for log in logs} == there - {
        short.relative_to(logged[1])
    }


def test_logs_are_copied_where_no_link_can_be(logged, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    logs = list(api.merge(logged, out=tmp_path / "merged").folder.rglob("*.mcap"))
    assert len(logs) == 12
    assert all(log.read_bytes() == LOG and log.stat().st_nlink == 1 for log in logs)


PLACES_OF_NO_LOG = (
    *("../secret", "run.json", "/etc/passwd", "mcap/../run.json", "mcap/hurdles/aa/other.mcap"),
    *("../mcap/{}/{}.mcap", "mcap/x/../{}/{}.mcap", "/mcap/{}/{}.mcap", "{}/{}.mcap"),
)


@pytest.mark.parametrize("path", PLACES_OF_NO_LOG)
def test_a_row_that_names_another_place_than_its_logs_is_refused(path, parts, written, tmp_path):
    (tmp_path / "secret").write_bytes(LOG)

    def row(trial):
        return row_of(trial, mcap_path=path.format(trial.scene, trial.id), mcap_bytes=len(LOG))

    evil = written("evil", "3/3", rows=row)
    with pytest.raises(StoreError, match="where no trial of a run belongs"):
        api.merge([*parts[:2], evil], out=tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_no_link_leads_out_of_a_part(logged, tmp_path):
    (tmp_path / "secret").write_bytes(LOG)
    for part in logged:
        (part / "foxglove.json").symlink_to(tmp_path / "secret")
    log = min(logged[2].rglob("*.mcap"))
    log.unlink()
    log.symlink_to(tmp_path / "secret")
    merged = api.merge(logged, out=tmp_path / "merged")
    assert len(list(merged.folder.rglob("*.mcap"))) == 11
    assert not (merged.folder / "foxglove.json").exists()
    assert "1 log missing" in merged.verdict.reasons[-1]


@pytest.mark.parametrize("name", ["run.json", "journal.jsonl", "trials.parquet"])
@pytest.mark.parametrize("count", [2, pytest.param(30, marks=pytest.mark.nightly)])
def test_a_damaged_part_is_one_line_or_does_no_harm(name, count, parts, tmp_path):
    whole = api.merge(parts, out=tmp_path / "whole")
    rng = random.Random(7)
    data = (parts[1] / name).read_bytes()
    kept = tmp_path / "kept"
    shutil.copytree(parts[1], kept)
    for number in range(count):
        shutil.rmtree(parts[1])
        shutil.copytree(kept, parts[1])
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        (parts[1] / name).write_bytes(damaged[: None if number % 2 else rng.randrange(len(data))])
        if name == "run.json":
            with pytest.raises(NwEvalError, match=r"part-2") as caught:
                api.merge(parts, out=tmp_path / f"merged-{number}")
            assert "\n" not in str(caught.value)
        else:  # The rows have two copies.
            assert api.merge(parts, out=tmp_path / f"merged-{number}").rows == whole.rows


def test_an_invalid_folder_or_a_false_plan_is_one_line(parts, written, tmp_path):
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "nowhere"):
        with pytest.raises(UsageError, match="is not the folder of a run"):
            api.merge([*parts, folder], out=tmp_path / "merged")
    _, known = shard_of(expand(suite_of(), PLACES), Shard(index=1, count=2))
    for index in (1, 2):
        shard = known.model_copy(update={"index": index, "plan": "00" * 32})
        written(f"liar-{index}", f"{index}/2", shard=shard)
    with pytest.raises(StoreError, match="its plan is not that of its suite and its scenes"):
        api.merge([tmp_path / "liar-1", tmp_path / "liar-2"], out=tmp_path / "merged")
    with pytest.raises(StoreError, match="the plan that it is part 1 of 2 of is another one"):
        api.report(tmp_path / "liar-1")


def test_a_part_alone_has_no_verdict(parts, written, tmp_path):
    shown = api.report(parts[0])
    assert (shown.verdict.verdict, shown.exit_code) == ("RAN", 0)
    # These rows have no logs.
    assert shown.verdict.reasons[:-1] == (
        "part 1 of 3: `nw-eval merge` joins all parts and judges the run",
    )
    page = (parts[0] / "report.md").read_text()
    assert page.startswith("# RAN · part 1 of 3 · ")
    assert "is exactly" not in page
    refused = "run part-1 is part 1 of 3, which is not the whole run"
    with pytest.raises(UsageError, match=refused):
        api.judge(parts[0])
    with pytest.raises(UsageError, match=refused):
        api.record_verdict(shown, tmp_path / "ledger.jsonl")
    with pytest.raises(UsageError, match=refused):
        api.save_baseline("hurdles", run=parts[0])

    # A part that met no critical scene, and one of informational scenes alone, ran as any other.
    for tier in ("critical", "informational"):
        suite = suite_of(trials=1, gate={**GATE, "tiers": {"hurdles/*": tier}})
        alone = written(tier, "1/3", suite=suite)
        assert api.report(alone).verdict.verdict == "RAN"


def test_a_part_with_errors_or_gaps_says_so(written):
    gaps = written("gaps", "1/3", rows=lambda trial: row_of(trial) if trial.index else None)
    judged = api.report(gaps).verdict
    assert judged.verdict == "INFRASTRUCTURE"
    assert judged.reasons[0].endswith("--resume runs them")


def test_the_command_merges_judges_and_shows(parts, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("STEP_SUMMARY", "OUTPUT"):
        monkeypatch.setenv(f"GITHUB_{name}", str(tmp_path / name))
    assert (
        ends(
            "merge",
            *map(str, parts),
            "--out",
            "merged",
            "--junit",
            "junit.xml",
            "--github",
            "--ledger",
            "ledger.jsonl",
        )
        == 0
    )
    shown = capsys.readouterr().out
    assert "PASS · completed " in shown
    assert "report: merged/report.md and report.html" in shown
    assert "3 parts, run on" in (tmp_path / "merged" / "report.md").read_text()
    assert "verdict" in (tmp_path / "junit.xml").read_text()
    assert "report-path" in (tmp_path / "OUTPUT").read_text()
    assert (tmp_path / "STEP_SUMMARY").read_text().startswith("# PASS: quick, stand\n")
    assert len((tmp_path / "ledger.jsonl").read_text().splitlines()) >= 1

    assert ends("merge", str(parts[0]), "--out", "other", "--junit", "junit.xml") == 4
    told = capsys.readouterr().err
    assert told.startswith("error: 8 trials of 12 missing: there is no part 2 of 3 (4 trials")
    assert told.count("\n") == 1
    assert "no part 2 of 3" in (tmp_path / "junit.xml").read_text()


def test_rows_of_the_merged_file_are_those_of_its_journal(parts, tmp_path):
    merged = api.merge(parts, out=tmp_path / "merged")
    rows, metadata = read_rows(merged.folder / "trials.parquet")
    assert rows_digest(rows) == metadata["rows_digest"] == merged.info.rows_digest
    saved = json.loads((merged.folder / "run.json").read_text())
    assert {name: scene["trials"] for name, scene in saved["scenes"].items()} == {
        place.name: 4 for place in PLACES
    }


@pytest.mark.parametrize("name", ["x\x1b[2J\u202e", "a b;$(touch owned)"])
def test_names_of_strangers_show_as_text(name, written, tmp_path, capsys):
    part = written(name, "1/2")
    assert ends("merge", part, "--out", str(tmp_path / "merged")) == 4
    told = capsys.readouterr().err
    assert "\x1b" not in told
    assert "\u202e" not in told
    assert Path("owned").exists() is False


def test_what_a_part_found_of_the_cache_of_trials_holds_for_the_whole(written, tmp_path):
    found = CacheInfo(reexecuted=2, differing=("trial x came out otherwise",))
    doubted = written("one", "1/2", cache=found)
    parts = [doubted, written("two", "2/2", cache=CacheInfo(reexecuted=1))]
    assert api.report(doubted).verdict.verdict == "INFRASTRUCTURE"
    merged = api.merge(parts, out=tmp_path / "merged")
    assert merged.info.cache == CacheInfo(reexecuted=3, differing=found.differing)
    assert merged.verdict.verdict == "INFRASTRUCTURE"
    again = api.merge([*parts, merged.folder], out=tmp_path / "again")
    assert again.info.cache == merged.info.cache
