"""`--seed` draws another seed set, and a run keeps to its own."""

import json

import pytest

from nw_base.errors import IncomparableError, UsageError
from nw_eval import api
from nw_eval.cli.verbs.check import forecast_page

SUITE = """\
nw-eval: 1
name: quick
robot: go1
policy: stand
trials: 2
seed: 5
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
"""


@pytest.fixture
def suite(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "quick.yaml"
    path.write_text(SUITE)
    return path


def panel(suite, **changes):
    """The line of `check` that names the seed set."""
    lines = forecast_page(api.check(suite, **changes)).splitlines()
    (line,) = [one for one in lines if one.startswith("seed set ")]
    return line


def test_another_seed_is_another_panel_and_a_bad_one_is_refused(suite):
    assert panel(suite) == panel(suite, seed=5)
    assert panel(suite, seed=6) != panel(suite)
    assert "seed 6" in panel(suite, seed=6)
    with pytest.raises(UsageError, match="--seed -1"):
        api.check(suite, seed=-1)


def test_a_run_on_another_panel_says_so_and_is_resumed_on_it(suite, tmp_path):
    own = api.run(suite, out=tmp_path / "own")
    other = api.run(suite, seed=6, out=tmp_path / "other")
    assert {row.seed for row in own.rows}.isdisjoint(row.seed for row in other.rows)
    info = json.loads((tmp_path / "other" / "run.json").read_text())
    assert info["suite"]["seed"] == 6
    assert "On this seed set (seed 6)" in (tmp_path / "other" / "report.md").read_text()
    (tmp_path / "other" / "trials.parquet").unlink()
    journal = tmp_path / "other" / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-1]))
    again = api.run(None, resume=tmp_path / "other")
    assert {row.digest for row in again.rows} == {row.digest for row in other.rows}
    with pytest.raises(IncomparableError, match="suite"):
        api.run(None, resume=tmp_path / "other", seed=5)
