"""Two hundred kinds of damage to each file of a run: none is read as other results."""

from __future__ import annotations

import random
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest

from nw_base.errors import StoreError
from nw_gate.results.journal import Journal, JournalHeader, read_journal
from nw_gate.results.parquet import read_rows, write_rows
from nw_gate.results.provenance import (
    read_run_info,
    write_run_info,
)
from nw_gate.results.row import rows_digest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


TRIES = 200


@pytest.fixture
def tally(mutated):
    """Return what reads a file that was damaged in many ways, and counts what became of it."""

    def count(path: Path, read: Callable[[Path], Any], is_honest: Callable[[Any], bool]) -> Counter:
        whole, rng, counts = path.read_bytes(), random.Random(9), Counter()
        said: list[str] = []
        for _ in range(TRIES):
            path.write_bytes(mutated(whole, rng))
            try:
                found = read(path)
            except StoreError as error:
                counts["refused"] += 1
                said.append(str(error))
                continue
            assert is_honest(found), path.read_bytes()[:2000]
            counts["read as it was"] += 1
        assert all(str(path) in text and "\n" not in text and len(text) < 1000 for text in said)
        return counts

    return count


@pytest.fixture
def rows(make_row):
    return [make_row(trial_id=f"t{k}", seed=k, wall_s=k / 7, host="a") for k in range(6)]


def test_a_damaged_journal_is_refused_or_cut_off_but_never_read_as_other_rows(
    tmp_path, rows, tally
):
    path = tmp_path / "journal.jsonl"
    header = JournalHeader(suite_digest="aa", policy_digest="bb", scene_digests={})
    with Journal.create(path, header) as journal:
        for row in rows:
            journal.append(row)

    def is_a_beginning(found: Any) -> bool:
        return found.rows == tuple(rows[: len(found.rows)]) and found.header == header

    counts = tally(path, read_journal, is_a_beginning)
    # What is left to read is a journal that was cut off: at a line's end, or in its last line.
    assert counts["refused"] > 0.8 * TRIES


def test_a_damaged_parquet_file_is_refused(tmp_path, rows, tally):
    path = tmp_path / "trials.parquet"
    write_rows(path, rows, {"rows_digest": rows_digest(rows)})
    assert tally(path, read_rows, lambda _: False) == {"refused": TRIES}


def test_a_damaged_run_json_is_refused(tmp_path, tally, run_json):
    path = tmp_path / "run.json"
    write_run_info(path, run_json)
    counts = tally(path, read_run_info, lambda found: found == run_json)
    assert counts["refused"] > 0.98 * TRIES, "only blanks around the sum may change"


@pytest.mark.parametrize(
    "text",
    [
        '{"wall_s": NaN}',
        '{"suite": ' + "[" * 5000 + "]" * 5000 + "}",
        '{"scenes": {"a": {"digest": "d", "task": "t", "trials": -1}}}',
        '{"id": 7}',
        "[]",
        '{"id": "' + "\x1b[2J" + '"}',
        "",
    ],
)
def test_a_nonsensical_run_json_is_one_line(tmp_path, text):
    path = tmp_path / "run.json"
    path.write_text(text)
    with pytest.raises(StoreError, match=r"run\.json is damaged") as caught:
        read_run_info(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 600


def test_a_file_without_an_end_is_not_read(tmp_path):
    for name, read in {"j": read_journal, "p": read_rows, "r": read_run_info}.items():
        path = tmp_path / name
        path.symlink_to("/dev/zero")
        with pytest.raises(StoreError):
            read(path)


def test_a_file_that_says_it_is_huge_is_not_read(tmp_path):
    for name, read in {"j": read_journal, "p": read_rows, "r": read_run_info}.items():
        path = tmp_path / name
        with path.open("wb") as stream:
            stream.truncate(2**40)  # A sparse file: it takes no room.
        with pytest.raises(StoreError, match="MiB"):
            read(path)
