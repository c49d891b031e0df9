"""Many rows in little memory are the same rows."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from nw_gate.results import stored
from nw_gate.results.evidence import row_leaf
from nw_gate.results.journal import Journal, JournalHeader, later, read_journal
from nw_gate.results.parquet import read_rows, write_rows
from nw_gate.results.row import Row, rows_digest, texts_of, to_dict
from nw_gate.results.stored import RowStore, StoredRow, StoredRows

HEADER = JournalHeader(suite_digest="5" * 64, policy_digest="9" * 64, scene_digests={})
COUNT = 700


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored, "FEW", 300)


@pytest.fixture
def rows(make_row: Callable[..., Row]) -> list[Row]:
    """Rows whose columns are of every kind that is packed, and of some that are not."""
    return [
        make_row(
            trial_id=f"t{k:04d}",
            seed=2**64 - 1 - k,
            error_text="ü" * (k % 7),
            state_digest=f"{k:064x}",
            action_digest="" if k % 5 else "ab" * 32,
            sim_s=k if k % 3 else float(k),
            log_s=-0.0 if k % 2 else 0.0,
            coverage_min=None if k % 2 else k / COUNT,
            coverage_mean=None if k < COUNT // 2 else 1.0,
            capture_distance=tuple(range(k % 4)),
            perturbation=(("friction", k % 3 + 0.5),),
            scores=(("power", k / 7), ("slip", -0.0)) if k > COUNT // 2 else (("power", k),),
            cached=k % 2 == 0,
        )
        for k in range(COUNT)
    ]


def kept(rows: list[Row], at_once: int) -> RowStore:
    """Return a store that has got rows so many at a time."""
    store = RowStore(lambda earlier, row: later(earlier, row, Path("journal")))
    left = iter(rows)
    while some := list(islice(left, at_once)):
        store.extend(some)
    return store


@pytest.mark.parametrize("at_once", [1, 77, COUNT])
def test_rows_come_back_with_every_type_and_sign(rows: list[Row], at_once: int) -> None:
    found = kept(rows, at_once).rows()
    assert isinstance(found, StoredRows)
    assert isinstance(found[0], StoredRow)
    assert list(map(repr, map(to_dict, found))) == list(map(repr, map(to_dict, rows)))
    assert found == rows
    assert [hash(row) for row in found] == [hash(row) for row in rows]
    assert found[-1] == rows[-1]
    assert found[10:20] == rows[10:20]


def test_what_is_written_and_hashed_of_them_is_the_same(rows: list[Row], tmp_path: Path) -> None:
    found = kept(rows, 100).rows()
    assert rows_digest(found) == rows_digest(rows)
    assert [row.digest for row in found] == [row.digest for row in rows]
    assert list(map(row_leaf, found)) == list(map(row_leaf, rows))
    records = [[*texts.records()] for texts in texts_of(found)]
    assert records == [[*texts.records()] for texts in texts_of(rows)]
    write_rows(tmp_path / "one", found, {})
    write_rows(tmp_path / "two", rows, {})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_a_row_can_be_changed_compared_and_sent_like_any_other(rows: list[Row]) -> None:
    row: Any = kept(rows, 100).rows()[5]
    assert replace(row, attempt=3) == replace(rows[5], attempt=3) != row
    assert type(replace(row, attempt=3)) is Row
    assert copy(row) == row == rows[5]
    assert repr(row) == repr(rows[5])
    assert (row.standing, row.lost_its_log) == (rows[5].standing, rows[5].lost_its_log)


def test_the_latest_row_of_a_trial_stands_where_its_first_stood(
    make_row: Callable[..., Row],
) -> None:
    error = {"status": "error", "outcome": "crashed", "success": None, "completed": False}
    first = [make_row(trial_id=f"t{k}", **(error if k == 3 else {})) for k in range(400)]
    again = make_row(trial_id="t3", attempt=2)
    store = kept([*first, again], 50)
    expected = [*first[:3], again, *first[4:]]
    assert store.get("t3") == again
    assert list(store.rows()) == expected


def test_a_journal_of_many_rows_is_resumed_with_all_of_them(
    rows: list[Row], tmp_path: Path
) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal.create(path, HEADER) as journal:
        for row in rows[:350]:
            journal.extend([row])
    with Journal.resume(path, HEADER) as journal:
        assert journal.rows == rows[:350]
        journal.extend(rows[350:])
        assert journal.rows == rows
    assert read_journal(path).rows == rows
    lines = path.read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["row"]["trial_id"] for line in lines[1:]] == [
        row.trial_id for row in rows
    ]


def test_rows_in_several_groups_of_a_file_are_read_in_order(
    make_row: Callable[..., Row], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [make_row(trial_id=f"t{k:04d}") for k in range(COUNT)]
    monkeypatch.setattr("nw_gate.results.parquet._GROUP", 300)
    monkeypatch.setattr("nw_gate.results.parquet._MANY_GROUP", 256)
    path = tmp_path / "trials.parquet"
    write_rows(path, reversed(rows), {"rows_digest": rows_digest(rows)})
    assert rows_digest(read_rows(path)[0]) == rows_digest(rows)
    assert [row.trial_id for row in read_rows(path)[0]] == [row.trial_id for row in rows]
