from __future__ import annotations

import json
import os
import random
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_base.errors import IncomparableError, StoreError, UsageError
from nw_base.words import OUTCOMES
from nw_gate.results.baseline_file import baseline_of, baseline_table, read_baseline, write_baseline
from nw_gate.results.parquet import write_rows
from nw_gate.results.sealed import metadata_of
from nw_gate.results.tables import small_table, write_small_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from nw_gate.results.baseline import BaselineResults

MACHINES = ({"cpu": "znver4"}, {"cpu": "haswell", "torch": "2.6"})


def reread(path: Path) -> BaselineResults:
    """As `read_baseline`, in this process: it takes no second."""
    return baseline_of(small_table(path), path)


def rewritten(path: Path, change: Callable[[list[dict[str, Any]], dict[str, Any]], object]) -> Path:
    """Change the lines or the manifest of a baseline's file, and seal it as its writer would."""
    table = pq.read_table(path)
    lines, manifest = table.to_pylist(), json.loads(metadata_of(table.schema)["bank"])
    change(lines, manifest)
    schema = pa.schema([field.with_nullable(True) for field in table.schema])
    table = pa.Table.from_pylist(lines, schema=schema)
    write_small_table(path, table, {"bank": json.dumps(manifest)})
    return path


@pytest.fixture
def saved(tmp_path, make_baseline):
    path = tmp_path / "shipped.parquet"
    write_baseline(path, make_baseline())
    return path


def test_a_baseline_comes_back_equal_with_panels_perturbations_and_note(tmp_path, make_baseline):
    cells = ((("friction", 0.5),), (("friction", 1.0), ("payload", 2.0)))
    baseline = make_baseline(machines=MACHINES, cells=cells, note="before the new gait")
    write_baseline(tmp_path / "shipped.parquet", baseline)
    assert read_baseline(tmp_path / "shipped.parquet") == baseline


def test_a_baseline_is_read_while_another_thread_changes_the_environment(saved):
    """A library that is imported meanwhile does: a child that shared it failed with EFAULT."""
    done = threading.Event()

    def change() -> None:
        count = 0
        while not done.is_set():
            os.putenv(f"NW_EVAL_TEST_{count % 500}", "y" * (count % 300))
            count += 1
            if count % 500 == 0:
                for number in range(500):
                    os.unsetenv(f"NW_EVAL_TEST_{number}")

    threads = [threading.Thread(target=change) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        baselines = [read_baseline(saved) for _ in range(3)]
    finally:
        done.set()
        for thread in threads:
            thread.join()
        for number in range(500):
            os.unsetenv(f"NW_EVAL_TEST_{number}")
    assert all(baseline == reread(saved) for baseline in baselines)


def test_equal_baselines_give_equal_bytes_whatever_order_their_manifest_was_made_in(
    tmp_path, make_baseline
):
    baseline = make_baseline(machines=MACHINES)
    key = baseline.manifest.key
    scenes = dict(reversed(key.scenes.items()))
    key = key.model_copy(update={"scenes": scenes})
    other = replace(baseline, manifest=baseline.manifest.model_copy(update={"key": key}))
    for folder, each in (("one", baseline), ("two", other)):
        (tmp_path / folder).mkdir()
        write_baseline(tmp_path / folder / "shipped.parquet", each)
    one, two = ((tmp_path / name / "shipped.parquet").read_bytes() for name in ("one", "two"))
    assert one == two


def test_a_baseline_of_sixteen_scenes_and_sixty_starts_is_small_enough_for_git(
    tmp_path, make_baseline
):
    write_baseline(tmp_path / "shipped.parquet", make_baseline(scenes=16, starts=60))
    trajectories = 16 * 60 * 8
    assert (tmp_path / "shipped.parquet").stat().st_size < trajectories + 8_000


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda lines, _: lines[1].update(success=float("nan")), "start 1 .* success nan is not"),
        (lambda lines, _: lines[1].update(success=1.5), "success 1.5 is not between 0 and 1"),
        (lambda lines, _: lines[1].update(success=None), "start 1 of .*: success is None"),
        (lambda lines, _: lines[1].update(completed=False), "completed is False at success 1.0"),
        (lambda lines, _: lines[1].update(outcome="crashed"), "outcome 'crashed' is none of"),
        (lambda lines, _: lines[1].update(waypoints_reached=5), "5 of 4 waypoints reached"),
        (
            lambda lines, _: lines[1].update(end_reason="a\x1b[2Jb"),
            "end_reason .* not a plain line",
        ),
        (lambda lines, _: lines[1].update(perturbation=[("friction", float("inf"))]), "friction"),
        (lambda lines, _: lines.append(lines[0]), "place_00: start 0 is there 2 times"),
        (lambda lines, _: lines.pop(0), "place_00: 3 initial states, its manifest says 4"),
        (lambda lines, _: lines[3].update(seed_index=7), "start 7 is not between 0 and 3"),
        (lambda lines, _: lines.reverse(), "not in the order of scene, perturbation and index"),
        (lambda lines, _: lines[0].update(panel=1), "results of machine 1, of 1 listed"),
        (lambda lines, _: lines.clear(), "no start in scene hurdles/place_00"),
        (lambda _, manifest: manifest["key"]["scenes"].pop("hurdles/place_01"), "not in its mani"),
        (lambda _, manifest: manifest["key"]["scenes"].update(x="y"), "no start in scene x of its"),
        (lambda _, manifest: manifest.update(starts=5), "4 initial states, its manifest says 5"),
        (lambda _, manifest: manifest.update(starts="many"), "manifest.starts: "),
        (lambda _, manifest: manifest.update(name="other"), "calls it other, its file is shipped"),
        (lambda _, manifest: manifest.update(name="../a"), "'../a' is not a name"),
        (lambda _, manifest: manifest.update(note="\x1b[2J"), "is not a plain line"),
        (lambda _, manifest: manifest["panels"].append(manifest["panels"][0]), "one machine type"),
        (
            lambda _, manifest: manifest.update(bank=2),
            "baseline of version 2, this nw-eval reads 1",
        ),
        (lambda _, manifest: manifest.pop("key"), "manifest.key: field required"),
    ],
)
def test_a_baseline_that_contradicts_itself_is_not_compared_with(saved, change, sentence):
    rewritten(saved, change)
    with pytest.raises(IncomparableError, match=sentence) as caught:
        reread(saved)
    assert str(caught.value).startswith(str(saved))
    assert str(caught.value).isprintable()


def test_panels_that_perturb_different_things_are_refused(tmp_path, make_baseline):
    plain = make_baseline(machines=MACHINES)
    other = make_baseline(machines=MACHINES, cells=((("friction", 0.5),),))
    mixed = replace(plain, panels=(plain.panels[0], other.panels[1]))
    with pytest.raises(
        StoreError, match=r"cannot write .*: its machines' results differ in their perturbations"
    ):
        write_baseline(tmp_path / "shipped.parquet", mixed)
    assert not list(tmp_path.iterdir())


def test_a_column_that_is_missing_is_named(saved):
    table = pq.read_table(saved)
    write_small_table(saved, table.drop_columns(["trajectory"]), metadata_of(table.schema))
    with pytest.raises(IncomparableError, match="it lacks the columns trajectory"):
        read_baseline(saved)


def test_a_column_that_no_baseline_has_is_an_error_of_its_reader_alone(saved):
    table = pq.read_table(saved)
    dates = pa.array([0] * table.num_rows, pa.date32())
    changed = table.set_column(0, "panel", dates)
    write_small_table(saved, changed, metadata_of(table.schema))
    with pytest.raises(StoreError, match="holds something that is neither number nor text"):
        read_baseline(saved)


def test_the_rows_of_a_run_are_no_baseline_and_neither_is_anybodys_table(tmp_path, make_row):
    rows, foreign = tmp_path / "rows.parquet", tmp_path / "foreign.parquet"
    write_rows(rows, [make_row()], {})
    pq.write_table(pa.table({"x": [1]}), foreign)
    for path in (rows, foreign):
        with pytest.raises(IncomparableError, match="is not a baseline file; save one from a run"):
            reread(path)


def test_a_baseline_that_is_not_there_or_not_whole_is_named(saved):
    with pytest.raises(UsageError, match=r"no baseline at .*none\.parquet"):
        read_baseline(saved.with_name("none.parquet"))
    saved.write_bytes(saved.read_bytes()[:-20])
    with pytest.raises(StoreError, match=r"shipped\.parquet is damaged: .*; restore it from git"):
        read_baseline(saved)
    saved.unlink()
    saved.symlink_to("/dev/zero")
    with pytest.raises(UsageError, match="no baseline at"):
        read_baseline(saved)


def test_two_hundred_kinds_of_damage_are_each_refused(saved, mutated):
    whole, rng = saved.read_bytes(), random.Random(12)
    for _ in range(200):
        saved.write_bytes(mutated(whole, rng))
        with pytest.raises((StoreError, IncomparableError)) as caught:
            reread(saved)
        assert str(saved) in str(caught.value)


@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.lists(st.tuples(st.integers(0, 9), st.integers(1, 9)), min_size=4, max_size=4),
    st.sampled_from([outcome for outcome in OUTCOMES if outcome != "completed"]),
    st.text(st.characters(categories=("L", "N", "P", "S")), max_size=40),
    st.dictionaries(st.sampled_from(["friction", "payload"]), st.floats(0, 9), max_size=2),
)
def test_any_baseline_comes_back_equal(tmp_path, make_baseline, scores, outcome, text, cell):
    baseline = make_baseline(scenes=1, cells=(tuple(sorted(cell.items())),))
    starts = tuple(
        replace(
            start,
            success=min(reached, total) / total,
            completed=reached >= total,
            waypoints_reached=min(reached, total),
            waypoints_total=total,
            outcome="completed" if reached >= total else outcome,
        )
        for start, (reached, total) in zip(baseline.panels[0].starts, scores, strict=True)
    )
    note = " ".join(text.replace("::", ":").replace("##", "#").replace("@", "").split())
    baseline = replace(
        baseline,
        manifest=baseline.manifest.model_copy(update={"note": note}),
        panels=(replace(baseline.panels[0], starts=starts),),
    )
    assert baseline_table(baseline).num_rows == 4
    write_baseline(tmp_path / "shipped.parquet", baseline)
    assert reread(tmp_path / "shipped.parquet") == baseline
