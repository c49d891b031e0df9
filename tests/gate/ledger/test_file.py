"""A ledger keeps every verdict, also where gates are killed or end at once."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from typing import IO

import pytest

from nw_base.errors import StoreError
from nw_gate import ledger as ledger_file
from nw_gate.absolute import judge
from nw_gate.ledger import append_entry, append_verdict, read_ledger
from nw_gate.results.provenance import (
    BaselineInfo,
    PolicyInfo,
    RunInfo,
    SceneInfo,
    code_info,
    machine_info,
)
from nw_gate.results.seal import seal
from nw_gate.settings import Gate


@pytest.fixture
def entries(make_entry):
    return [make_entry(days=day, checkpoint=day) for day in range(4)]


@pytest.fixture
def ledger(tmp_path, entries):
    path = tmp_path / "gates" / "ledger.jsonl"
    for entry in entries:
        append_entry(path, entry)
    return path


def test_verdicts_come_back_in_their_order(ledger, entries):
    contents = read_ledger(ledger)
    assert contents.entries == tuple(entries)
    assert contents.dropped is None
    assert len(ledger.read_bytes().splitlines()) == 5


def test_a_torn_line_is_dropped_and_cut_off_before_the_next(ledger, entries):
    ledger.write_bytes(ledger.read_bytes() + b'{"verdict":{"time"')  # A kill while it was written.
    contents = read_ledger(ledger)
    assert contents.entries == tuple(entries)
    assert "ledger.jsonl:6: dropped a line that was cut off" in str(contents.dropped)
    append_entry(ledger, entries[3])
    assert read_ledger(ledger).entries == (*entries, entries[3])


@pytest.mark.parametrize("cut", [1, 30, 2000])
def test_an_end_that_was_cut_off_is_missed(ledger, entries, cut):
    ledger.write_bytes(ledger.read_bytes()[:-cut])
    for use in (read_ledger, lambda path: append_entry(path, entries[0])):
        with pytest.raises(
            StoreError, match=r"and had 4: \d verdicts? cut off; .*ledger.jsonl.head"
        ):
            use(ledger)


def test_whole_lines_that_were_cut_off_are_missed_by_either_head(ledger, entries):
    head = read_ledger(ledger).last_sum
    lines = ledger.read_bytes().splitlines(keepends=True)
    ledger.write_bytes(b"".join(lines[:-1]))
    with pytest.raises(StoreError, match="ends after 3 verdicts, and had 4: 1 verdict cut off"):
        read_ledger(ledger)
    # Whoever removes the head beside it too is found out by one that was kept elsewhere.
    ledger.with_name("ledger.jsonl.head").unlink()
    assert read_ledger(ledger).entries == tuple(entries[:3])
    with pytest.raises(StoreError, match=f"has the sum {head}: its end was cut off"):
        read_ledger(ledger, head=head)


def test_a_ledger_that_was_rewritten_is_not_the_one_of_its_head(ledger, entries):
    anew = ledger.with_name("anew.jsonl")
    for entry in (entries[0], *entries[2:], entries[0]):
        append_entry(anew, entry)
    ledger.write_bytes(anew.read_bytes())
    with pytest.raises(StoreError, match=r"ledger\.jsonl:5: not the line that was written"):
        read_ledger(ledger)


def test_a_head_that_was_kept_elsewhere_holds_as_a_ledger_grows(ledger, entries):
    head = read_ledger(ledger).last_sum
    append_entry(ledger, entries[1])
    assert len(read_ledger(ledger, head=head).entries) == 5


def test_a_ledger_of_an_older_version_has_no_head_and_is_read_and_added_to(tmp_path, entries):
    path = tmp_path / "l.jsonl"
    added = {"computes", "tiers", "trajectories"}
    text, last_sum = seal(json.dumps({"ledger": 1}))
    for entry in entries[:2]:
        values = entry.model_dump(mode="json", exclude=added)
        for key in ("scene_drop", "scenes", "critical"):
            del values["baseline"][key]
        line, last_sum = seal(json.dumps({"verdict": values}), last_sum)
        text += line
    path.write_text(text)
    assert read_ledger(path).entries == tuple(entries[:2])
    append_entry(path, entries[2])
    assert read_ledger(path).entries == tuple(entries[:3])
    assert json.loads(path.with_name("l.jsonl.head").read_text())["verdicts"] == 3


def test_a_head_that_is_damaged_is_named(ledger):
    head = ledger.with_name("ledger.jsonl.head")
    head.write_text(head.read_text().replace('"verdicts": 4', '"verdicts": 3'))
    with pytest.raises(StoreError, match=r"ledger.jsonl.head: damaged \(its checksum is"):
        read_ledger(ledger)


def test_a_first_line_that_was_torn_is_started_again(tmp_path, entries):
    path = tmp_path / "l.jsonl"
    path.write_bytes(b'{"ledg')
    append_entry(path, entries[0])
    assert read_ledger(path).entries == (entries[0],)


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_a_verdict_that_one_would_rather_forget_is_missed(ledger, place):
    lines = ledger.read_bytes().splitlines(keepends=True)
    del lines[place]
    ledger.write_bytes(b"".join(lines))
    with pytest.raises(StoreError, match=rf"ledger\.jsonl:{place + 1}: damaged \(its checksum is"):
        read_ledger(ledger)


def test_nothing_is_appended_to_a_ledger_that_is_damaged(ledger, entries):
    damaged = ledger.read_bytes().replace(b'"word":"PASS"', b'"word":"RAN"', 1)
    ledger.write_bytes(damaged)
    with pytest.raises(StoreError, match="damaged"):
        append_entry(ledger, entries[0])
    assert ledger.read_bytes() == damaged


def test_three_hundred_kinds_of_damage_are_never_read_as_other_verdicts(ledger, entries):
    whole, rng, refused = ledger.read_bytes(), random.Random(4), 0
    for _ in range(300):
        data = bytearray(whole)
        at = rng.randrange(len(data))
        match rng.choice(["flip", "cut", "remove"]):
            case "flip":
                data[at] ^= 1 << rng.randrange(8)
            case "cut":
                del data[at:]
            case "remove":
                del data[at : at + rng.choice([1, 9, 300])]
        ledger.write_bytes(bytes(data))
        try:
            found = read_ledger(ledger).entries
        except StoreError:
            refused += 1
        else:
            assert found == tuple(entries)
    assert refused == 300


@pytest.mark.parametrize(
    ("record", "sentence"),
    [
        ({"row": {}}, "is not a ledger"),
        ({"ledger": 2}, "a ledger of version 2, this nw-eval reads 1"),
        (["ledger"], "damaged"),
    ],
)
def test_another_kind_of_file_is_told_apart(tmp_path, record, sentence):
    path = tmp_path / "l.jsonl"
    text = json.dumps(record) if isinstance(record, list) else seal(json.dumps(record))[0]
    path.write_text(text.rstrip() + "\n")
    with pytest.raises(StoreError, match=sentence):
        read_ledger(path)


def test_a_value_that_no_verdict_has_is_named(tmp_path, entries):
    path = tmp_path / "l.jsonl"
    head, last_sum = seal(json.dumps({"ledger": 1}))
    values = {**entries[0].model_dump(mode="json"), "confidence": 7}
    path.write_text(head + seal(json.dumps({"verdict": values}), last_sum)[0])
    with pytest.raises(StoreError, match=r"l\.jsonl:2: confidence: input should be less than 1"):
        read_ledger(path)


APPEND = """
import sys
from pathlib import Path
from nw_gate.ledger import LedgerEntry
from nw_gate.ledger import append_entry

entry = LedgerEntry.model_validate_json(Path(sys.argv[2]).read_text())
for _ in range(10):
    append_entry(Path(sys.argv[1]), entry)
"""


def test_processes_that_share_a_ledger_lose_no_line(tmp_path, entries):
    path = tmp_path / "l.jsonl"
    processes = []
    for number, entry in enumerate(entries[:2]):
        (own := tmp_path / f"{number}.json").write_text(entry.model_dump_json())
        command = [sys.executable, "-c", APPEND, str(path), str(own)]
        processes.append(subprocess.Popen(command))
    assert [process.wait() for process in processes] == [0, 0]
    found = read_ledger(path)
    assert found.dropped is None
    assert [found.entries.count(entry) for entry in entries[:2]] == [10, 10]


def test_a_line_that_another_machine_writes_over_is_added_once_more(tmp_path, entries, monkeypatch):
    """On a share whose locks are of one machine alone: no local file can be made to do that."""
    path = tmp_path / "l.jsonl"
    append_entry(path, entries[0])
    write, begun = ledger_file._write, path.read_bytes()

    def write_over(handle: IO[bytes], data: bytes) -> None:
        write(handle, data)
        if times:
            times.pop()
            path.write_bytes(begun)

    monkeypatch.setattr(ledger_file, "_write", write_over)
    times = [1, 2]
    append_entry(path, entries[1])
    assert read_ledger(path).entries == tuple(entries[:2])
    times, begun = [1] * 5, path.read_bytes()
    with pytest.raises(StoreError, match="was written over 5 times while a verdict was added"):
        append_entry(path, entries[2])


def test_a_verdict_is_kept_with_who_was_judged_on_what_and_how(tmp_path, run_scene):
    rows = [*run_scene("a", [4, 4, 2]), *run_scene("b", [0, 4, 4])]
    run = RunInfo(
        id="r1",
        started="2026-11-22T09:00:00+00:00",
        suite_file="suites/hurdles.yaml",
        suite={"name": "hurdles"},
        suite_digest="aa" * 32,
        policy=PolicyInfo(name="p", card_digest="bb" * 32, checkpoint_digest="cc" * 32),
        scenes={name: SceneInfo(digest="dd" * 32, task="t", trials=3) for name in "ab"},
        code=code_info(),
        machine=machine_info(),
    )
    gate = Gate(success_rate=0.5, tiers={"b": "critical"})
    verdict = judge(rows, gate, run.planned)
    baseline = BaselineInfo(name="b", path="b.parquet", sha256="ee" * 32)
    kept = append_verdict(tmp_path / "l.jsonl", verdict, run, rows, baseline=baseline)
    (entry,) = read_ledger(tmp_path / "l.jsonl").entries
    assert entry == kept
    assert (entry.word, entry.trials, entry.success) == (verdict.verdict, 6, verdict.success)
    assert [scene.counts for scene in entry.seen] == [(0, 0, 1, 0, 2), (1, 0, 0, 0, 2)]
    assert [scene.alone for scene in entry.seen] == [False, True]
    assert (entry.suite, entry.candidate, entry.run, entry.bar) == ("hurdles", "p", "r1", 0.5)
    assert entry.baseline is None, "the verdict rests on no comparison"
    assert entry.tiers == {"a": "supporting", "b": "critical"}
    assert entry.trajectories == {}, "these rows have no digests of states"
