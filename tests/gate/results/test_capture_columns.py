"""The columns of the captured volume: absent, nothing of an older row changes; there, they last."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_gate.results.evidence import row_leaf
from nw_gate.results.journal import Journal, JournalHeader, read_journal
from nw_gate.results.parquet import read_rows, write_rows
from nw_gate.results.row import Row, from_dict, rows_digest, to_dict

SEEN: dict[str, Any] = {
    "capture_distance": (0.1, 0.25, 2.0),
    "capture_angle": (0.0, 0.5, 1.5),
    "capture_alpha": (1.0, 0.9, 0.1),
}


def test_a_row_without_them_has_the_digests_that_it_had_before_there_were_any():
    row = Row(
        trial_id="a-000", suite="s", scene="a", task="gaps", robot="go1", seed_index=0, seed=7,
        policy="p", status="ok", outcome="completed", end_reason="all waypoints", completed=True,
        success=1.0, waypoints_reached=2, waypoints_total=2, waypoint_times=(0.5, 1.25), steps=100,
        sim_s=2.0, physics_s=0.1, render_s=0.2, policy_s=0.3, log_s=0.4, wall_s=1.5,
        coverage_min=0.75, coverage_mean=0.875, state_digest="aa" * 32, action_digest="bb" * 32,
        checkpoint_digest="cc" * 32, scene_digest="dd" * 32,
    )  # fmt: skip
    # Printed by the last commit that had no such columns.
    assert row.digest == "badbaf9ba4d480ddf52dae79198dc83cb608205c5525ef7167cf8f4341dfd421"
    assert row_leaf(row) == "62b32a24596ec9099a78a4be239096d287d69eb4e5b42aa77c56830b4575ae08"


def test_a_row_of_an_older_file_is_read_as_one_without_them(make_row):
    values = to_dict(make_row())
    for name in SEEN:
        del values[name]
    assert from_dict(values) == make_row()


def test_a_row_with_them_is_another_result(make_row):
    rows = [make_row(), *(make_row(**{name: value}) for name, value in SEEN.items())]
    assert len({row.digest for row in rows}) == len({row_leaf(row) for row in rows}) == 4


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(numbers=st.lists(st.floats(0.0, 100.0), max_size=30))
def test_journal_and_parquet_keep_them(tmp_path_factory, make_row, numbers):
    folder = tmp_path_factory.mktemp("rows")
    row = make_row(**{name: tuple(numbers) for name in SEEN})
    assert row.capture_angle == tuple(np.float32(numbers).tolist())
    header = JournalHeader(suite_digest="a", policy_digest="b", scene_digests={}, engine={})
    with Journal.create(folder / "journal.jsonl", header) as journal:
        journal.append(row)
    write_rows(folder / "trials.parquet", [row], {"rows_digest": rows_digest([row])})
    assert list(read_journal(folder / "journal.jsonl").rows) == [row]
    assert read_rows(folder / "trials.parquet")[0] == [row]
    assert from_dict(json.loads(json.dumps(to_dict(row)))) == row
