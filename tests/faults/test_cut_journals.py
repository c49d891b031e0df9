"""A journal that is cut at any byte of its last three lines is resumed to the very same bytes."""

import random

import pytest

from nw_gate.results.journal import Journal, read_journal
from nw_gate.results.row import rows_digest


def cuts(data, *, lines=3):
    """Return every length that leaves something of the last lines away."""
    kept = sum(map(len, data.splitlines(keepends=True)[:-lines]))
    return range(kept, len(data))


def resumed(path, header, rows):
    """Go on with a journal that was cut, as a run does that runs what is missing again."""
    with Journal.resume(path, header) as journal:
        known = {row.trial_id for row in journal.rows}
        for row in rows:
            if row.trial_id not in known:
                journal.append(row)
        return journal.rows


@pytest.fixture
def ended(tiny_run):
    """Return a run that has ended undisturbed, its rows, and its journal."""
    run = tiny_run("fine", trials=4)
    return run, run.go(workers=1).rows, run.folder.journal.read_bytes()


def test_a_journal_cut_at_any_byte_keeps_its_whole_lines(ended):
    run, rows, whole = ended
    ends = {at + 1 for at, byte in enumerate(whole) if byte == ord("\n")}
    path = run.folder.path / "cut.jsonl"
    for length in cuts(whole):
        path.write_bytes(whole[:length])
        kept = read_journal(path)
        assert kept.rows == rows[: sum(end <= length for end in ends) - 1], length
        assert (kept.dropped is None) == (length in ends), length


@pytest.mark.parametrize("share", [0.03, pytest.param(1.0, marks=pytest.mark.nightly)])
def test_a_journal_cut_at_any_byte_is_resumed_to_the_same_bytes(ended, share):
    run, rows, whole = ended
    path = run.folder.path / "cut.jsonl"
    lengths = cuts(whole)
    for length in sorted(random.Random(14).sample(lengths, int(share * len(lengths)))):
        path.write_bytes(whole[:length])
        assert rows_digest(resumed(path, run.header, rows)) == rows_digest(rows), length
        assert path.read_bytes() == whole, length
