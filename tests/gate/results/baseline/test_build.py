"""From a run's rows to a baseline: only of a run that is whole."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nw_base.errors import IncomparableError, TrialError
from nw_gate.results.baseline import trajectory
from nw_gate.results.baseline_file import baseline_of_run, read_baseline, with_panel, write_baseline
from nw_gate.results.provenance import PolicyInfo, RunInfo, SceneInfo, code_info, machine_info

ENGINE = {
    "mujoco": "4.0.0",
    "rays": "nw-eval rays 1",
    "renderer": "cpu",
    "cpu": "znver4",
    "torch": "2.6",
}
CELLS = ((("friction", 0.5),), (("friction", 1.0),))
SCENES = ("hurdles/one", "hurdles/two")


@pytest.fixture
def run():
    return RunInfo(
        id="r1",
        started="2026-11-22T09:00:00+00:00",
        finished="2026-11-22T10:00:00+00:00",
        suite_file="suites/hurdles.yaml",
        suite={"name": "hurdles", "seed": 5, "protocol": "strict", "trials": 3},
        suite_digest="aa" * 32,
        policy=PolicyInfo(name="p", card_digest="bb" * 32, checkpoint_digest="cc" * 32),
        scenes={name: SceneInfo(digest="dd" * 32, task="hurdles", trials=6) for name in SCENES},
        code=code_info(),
        machine=machine_info(),
        engine=ENGINE,
    )


@pytest.fixture
def rows(make_row):
    return [
        make_row(
            trial_id=f"{scene}-{index}-{cell}",
            scene=scene,
            seed_index=index,
            perturbation=cell,
            state_digest=f"{index}",
        )
        for index in range(3)
        for cell in CELLS
        for scene in SCENES
    ]


def test_a_whole_run_is_a_baseline_that_a_file_can_keep(tmp_path, run, rows):
    baseline = baseline_of_run(rows[::-1], run, name="p", card="p", by="anna", note="  why\nit is ")
    (panel,) = baseline.panels
    assert [(s.scene, s.perturbation, s.seed_index) for s in panel.starts] == sorted(
        (row.scene, row.perturbation, row.seed_index) for row in rows
    )
    assert {start.trajectory for start in panel.starts} == {trajectory(row) for row in rows}
    assert len(panel.starts[0].trajectory) == 16
    assert baseline.manifest.starts == 3
    assert baseline.manifest.note == "why it is"
    assert baseline.manifest.key.simulator == {
        "mujoco": "4.0.0",
        "rays": "nw-eval rays 1",
        "renderer": "cpu",
    }
    assert panel.machine == {"cpu": "znver4", "torch": "2.6"}
    assert baseline.manifest.panels[0].saved == run.finished
    write_baseline(tmp_path / "p.parquet", baseline)
    assert read_baseline(tmp_path / "p.parquet") == baseline


def test_a_run_with_an_error_or_a_hole_is_no_baseline(run, rows, make_row):
    with pytest.raises(TrialError, match="run r1 has 11 of its 12 trials; finish it"):
        baseline_of_run(rows[1:], run, name="p")
    error = {"status": "error", "outcome": "hung", "success": None}
    broken = make_row(trial_id="t", error_text="no answer", **error)
    with pytest.raises(TrialError, match="1 of 12 trials of run r1 have no result, first t: no"):
        baseline_of_run([broken, *rows[1:]], run, name="p")


def test_a_run_whose_starts_were_drawn_is_no_baseline(run, rows):
    drawn = [replace(row, seed_index=2 * row.seed_index) for row in rows]
    with pytest.raises(
        IncomparableError, match=r"run r1 makes no baseline: .*start 4 is not between"
    ):
        baseline_of_run(drawn, run, name="p")


def test_a_run_on_fresh_starts_is_no_baseline(run, rows):
    fresh = run.model_copy(update={"panel": "fresh"})
    with pytest.raises(
        IncomparableError, match="r1 makes no baseline: it met fresh initial states of its own"
    ):
        baseline_of_run(rows, fresh, name="p")


def test_a_panel_of_another_class_of_machine_comes_beside_the_first(run, rows):
    baseline = baseline_of_run(rows, run, name="p", note="first")
    elsewhere = run.model_copy(update={"engine": {**ENGINE, "cpu": "haswell"}})
    both = with_panel(baseline, baseline_of_run(rows, elsewhere, name="p", note="second"))
    assert [panel.machine["cpu"] for panel in both.panels] == ["znver4", "haswell"]
    assert [info.machine["cpu"] for info in both.manifest.panels] == ["znver4", "haswell"]
    assert both.manifest.note == "first"
