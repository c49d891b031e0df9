"""What the hash of a row and of a run covers: all that a verdict or a report goes by."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter

import pytest

from nw_gate.results import evidence
from nw_gate.results.evidence import row_leaf, run_leaf
from nw_gate.results.provenance import BaselineInfo, PolicyInfo, SceneInfo, StopInfo
from nw_gate.results.row import COLUMNS, Row, from_dict, to_dict


@pytest.fixture
def row(make_row):
    return make_row()


@pytest.fixture
def info(run_json):
    return run_json


def another(name: str, value: object) -> object:
    """Some other value that the column takes."""
    column = COLUMNS[name]
    if column.words:
        return next(word for word in column.words if word != value)
    if isinstance(value, bool):
        return not value
    if column.is_list:
        return (*value, (("friction", 0.5) if name == "perturbation" else 9.0))  # type: ignore[misc]
    return f"{value}x" if isinstance(value, str) else (value or 0) + 1  # type: ignore[operator]


@pytest.mark.parametrize("name", list(COLUMNS))
def test_no_column_is_changed_without_another_hash(name, row):
    changed = object.__new__(Row)  # Also into what contradicts other columns.
    changed.__dict__.update({**vars(row), name: another(name, getattr(row, name))})
    assert row_leaf(changed) != row_leaf(row)


def test_a_row_keeps_its_hash_through_files_and_under_versions_with_more_columns(row, monkeypatch):
    assert row_leaf(from_dict(to_dict(replace(row, sim_s=4)))) == row_leaf(row)
    # As a version wrote it that knew fewer columns: those that it lacked have their defaults.
    before = row_leaf(row)
    monkeypatch.setattr(evidence, "_VALUES", attrgetter(*list(COLUMNS)[:-1]))
    assert row_leaf(row) == before


def baseline(**changes: object) -> BaselineInfo:
    return BaselineInfo.model_validate({"name": "b", "path": "", "sha256": "ee", **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"suite": {"name": "hurdles", "gate": {"success_rate": 0.5}}},
        {"suite_digest": "ab" * 32},
        {"policy": PolicyInfo(name="p", checkpoint_digest="bc" * 32)},
        {"scenes": {"hurdles/one": SceneInfo(digest="cd" * 32, task="hurdles", trials=10)}},
        {"panel": "fresh"},
        {"drawn_from": 60},
        {"drawn_for": "ab/cd"},
        {"stop": StopInfo(first=3)},
        {"baseline": baseline()},
        {"engine": {"mujoco": "4.0.1"}},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_what_the_rows_are_of_is_not_changed_without_another_hash(changes, info):
    assert run_leaf(info.model_copy(update=changes)) != run_leaf(info)


def test_that_a_baseline_moved_on_this_machine_is_not_taken_back_without_another_hash(info):
    moved = info.model_copy(update={"baseline": baseline(moved=("hurdles/one fell",))})
    assert run_leaf(moved) != run_leaf(info.model_copy(update={"baseline": baseline()}))


def test_what_a_report_writes_again_is_no_part_of_it(info):
    later = {"finished": "later", "trials_sha256": "ff", "journal_sum": "0", "wall_s": 3.0}
    assert run_leaf(info.model_copy(update=later)) == run_leaf(info)
