from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_base.errors import StoreError
from nw_base.words import FAULTS, OUTCOMES
from nw_gate.results import parquet
from nw_gate.results.parquet import SCHEMA, read_rows, write_rows
from nw_gate.results.row import Row, rows_digest
from nw_gate.results.sealed import sealed


def write_as_another_version(path: Path, table: pa.Table) -> None:
    """Write a table with other columns, with the sum that its own writer would have given it."""
    pq.write_table(table, path)
    path.write_bytes(sealed(path.read_bytes()))


def test_rows_come_back_equal_sorted_and_with_their_metadata(tmp_path, make_row):
    error = make_row(
        trial_id="c", status="error", outcome="crashed", success=None, error_text="signal 11"
    )
    rows = [
        make_row(trial_id="b", perturbation=(("friction", 0.6),), coverage_min=0.25),
        error,
        make_row(trial_id="a", waypoint_times=()),
    ]
    path = tmp_path / "trials.parquet"
    write_rows(path, rows, {"suite_digest": "ab", "engine": "mujoco 4.0.0"})
    back, metadata = read_rows(path)
    assert back == sorted(rows, key=lambda row: row.trial_id)
    assert metadata == {"schema_version": "2", "suite_digest": "ab", "engine": "mujoco 4.0.0"}


def test_equal_rows_give_equal_bytes(tmp_path, make_row):
    rows = [make_row(trial_id=f"t{k}") for k in range(5)]
    write_rows(tmp_path / "one.parquet", rows, {"b": "2", "a": "1"})
    write_rows(tmp_path / "two.parquet", rows[::-1], {"a": "1", "b": "2"})
    assert (tmp_path / "one.parquet").read_bytes() == (tmp_path / "two.parquet").read_bytes()


def test_metadata_that_readers_look_for_carry_the_prefix(tmp_path, make_row):
    write_rows(tmp_path / "t.parquet", [make_row()], {"run_id": "r1"})
    raw = pq.read_schema(tmp_path / "t.parquet").metadata
    assert raw[b"nw.run_id"] == b"r1"
    assert raw[b"nw.schema_version"] == b"2"


def test_the_file_itself_says_what_each_column_holds(tmp_path, make_row):
    write_rows(tmp_path / "t.parquet", [make_row()], {})
    schema = pq.read_schema(tmp_path / "t.parquet")
    told = {field.name: field.metadata[b"about"].decode() for field in schema}
    assert set(told) == set(Row.__dataclass_fields__)
    assert "share of the course's waypoints reached" in told["success"]
    assert all(len(words) > 5 for words in told.values())


def test_rows_in_several_groups_of_a_file_are_read_in_order(make_row, tmp_path, monkeypatch):
    rows = [make_row(trial_id=f"t{k:04d}") for k in range(70)]
    monkeypatch.setattr(parquet, "_GROUP", 30)
    monkeypatch.setattr(parquet, "_MANY_GROUP", 25)
    path = tmp_path / "trials.parquet"
    write_rows(path, reversed(rows), {"rows_digest": rows_digest(rows)})
    assert pq.read_metadata(path).num_row_groups == 3
    assert read_rows(path)[0] == rows


def test_a_file_whose_columns_had_other_names_is_refused(tmp_path, make_row, monkeypatch):
    monkeypatch.setattr(parquet, "SCHEMA_VERSION", "1")
    write_rows(tmp_path / "t.parquet", [make_row()], {})
    monkeypatch.undo()
    with pytest.raises(StoreError, match="row schema 1, this nw-eval reads 2; use the version"):
        read_rows(tmp_path / "t.parquet")


def test_a_run_without_rows_is_still_a_readable_file(tmp_path):
    write_rows(tmp_path / "t.parquet", [], {})
    assert read_rows(tmp_path / "t.parquet")[0] == []


def test_files_from_before_a_column_was_added_have_what_it_is_by_default(tmp_path, make_row):
    path = tmp_path / "t.parquet"
    write_rows(path, [make_row(contact_s=0.5)], {})
    write_as_another_version(path, pq.read_table(path).drop_columns(["contact_s"]))
    (row,) = read_rows(path)[0]
    assert row == make_row(contact_s=0.0)


def test_columns_of_later_versions_do_not_disturb(tmp_path, make_row):
    path = tmp_path / "t.parquet"
    write_rows(path, [make_row()], {})
    table = pq.read_table(path)
    write_as_another_version(path, table.append_column("mood", pa.array(["calm"])))
    assert read_rows(path)[0] == [make_row()]


def test_a_missing_damaged_or_foreign_file_is_told_apart(tmp_path, make_row):
    with pytest.raises(StoreError, match="no rows at"):
        read_rows(tmp_path / "none.parquet")
    good = tmp_path / "good.parquet"
    write_rows(good, [make_row()], {})
    torn = tmp_path / "torn.parquet"
    torn.write_bytes(good.read_bytes()[:-20])
    with pytest.raises(StoreError, match="is damaged"):
        read_rows(torn)
    foreign = tmp_path / "foreign.parquet"
    pq.write_table(pa.table({"x": [1]}), foreign)
    with pytest.raises(StoreError, match="row schema None, this nw-eval reads 2"):
        read_rows(foreign)
    write_as_another_version(foreign, pq.read_table(good).drop_columns(["outcome"]))
    with pytest.raises(StoreError, match="lacks the columns outcome"):
        read_rows(foreign)


def test_rows_that_are_not_those_of_the_digest_beside_them_are_refused(tmp_path, make_row):
    path = tmp_path / "t.parquet"
    write_rows(path, [make_row()], {"rows_digest": rows_digest([make_row(seed=1)])})
    with pytest.raises(StoreError, match="not those of its rows_digest; `nw-eval report`"):
        read_rows(path)


def test_measured_columns_are_covered_too(tmp_path, make_row):
    path = tmp_path / "t.parquet"
    write_rows(path, [make_row(wall_s=2.0)], {})
    table = pq.read_table(path)
    wall = table.schema.get_field_index("wall_s")
    pq.write_table(table.set_column(wall, SCHEMA.field("wall_s"), pa.array([1.0])), path)
    with pytest.raises(StoreError, match="its checksum is that of other bytes"):
        read_rows(path)


def test_a_file_of_more_rows_than_any_run_has_is_not_unpacked(tmp_path, make_row, monkeypatch):
    path = tmp_path / "t.parquet"
    write_rows(path, [make_row(trial_id=f"t{k}") for k in range(5)], {})
    monkeypatch.setattr("nw_gate.results.parquet._MOST_ROWS", 4)
    monkeypatch.setattr(pq.ParquetFile, "read", None)
    with pytest.raises(StoreError, match="is damaged: 5 rows of"):
        read_rows(path)


def test_a_failed_write_leaves_the_older_file_whole(tmp_path, make_row, monkeypatch):
    path = tmp_path / "t.parquet"
    write_rows(path, [make_row()], {})

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "ParquetWriter", full)
    with pytest.raises(StoreError, match=r"cannot write .*t\.parquet: No space left.*--out"):
        write_rows(path, [make_row(trial_id="other")], {})
    assert read_rows(path)[0] == [make_row()]
    assert list(tmp_path.iterdir()) == [path]


@st.composite
def outcomes(draw: st.DrawFn) -> dict[str, object]:
    total = draw(st.integers(0, 9))
    reached = draw(st.integers(0, total))
    if draw(st.booleans()):
        success = draw(st.floats(0.0, 1.0))
        return {
            "status": "ok",
            "outcome": draw(st.sampled_from(OUTCOMES)),
            "success": success,
            "completed": success == 1.0,
            "waypoints_reached": reached,
            "waypoints_total": total,
        }
    return {
        "status": "error",
        "outcome": draw(st.sampled_from(FAULTS)),
        "success": None,
        "waypoints_reached": reached,
        "waypoints_total": total,
    }


@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    outcomes(),
    st.integers(0, 2**64 - 1),
    st.lists(st.floats(0.0, 1e4), max_size=6),
    st.text(st.characters(exclude_categories=("Cs",)), max_size=40),
    st.lists(st.tuples(st.sampled_from(["friction", "payload"]), st.floats(0, 9)), max_size=2),
)
def test_any_row_comes_back_equal(tmp_path, make_row, outcome, seed, times, text, cell):
    row = make_row(
        **outcome,
        seed=seed,
        waypoint_times=tuple(times),
        error_text=text,
        end_reason=text,
        perturbation=tuple(cell),
    )
    write_rows(tmp_path / "t.parquet", [row], {})
    (back,) = read_rows(tmp_path / "t.parquet")[0]
    assert back == row
    assert back.digest == row.digest


def test_a_seed_of_64_bits_comes_whole_through_sqlite(make_row, tmp_path):
    row = make_row(seed=2**64 - 1)
    write_rows(tmp_path / "rows.parquet", [row], {})
    table = pq.read_table(tmp_path / "rows.parquet", columns=["trial_id", "seed"])
    with closing(sqlite3.connect(":memory:")) as database:
        table.to_pandas().to_sql("rows", database)
        assert database.execute("select seed from rows").fetchall() == [(str(2**64 - 1),)]
    assert table.column("seed").to_pylist() == [str(row.seed)]
    assert read_rows(tmp_path / "rows.parquet")[0] == [row]


def test_a_file_of_before_that_has_the_seed_as_a_number_is_read(make_row, tmp_path):
    path, row = tmp_path / "rows.parquet", make_row(seed=2**64 - 1)
    write_rows(path, [row], {"rows_digest": rows_digest([row])})
    table = pq.read_table(path)
    place = table.schema.get_field_index("seed")
    older = table.set_column(place, "seed", table.column("seed").cast(pa.uint64()))
    write_as_another_version(path, older)
    assert read_rows(path)[0] == [row]
    # And an older reader, which casts to its own schema, reads ours.
    assert table.column("seed").cast(pa.uint64()).to_pylist() == [row.seed]
