"""Runs and baselines of one suite are compared, by function and by verb, without a simulator."""

import subprocess
import sys

import pytest
from command_line import ends
from saved_runs import info_of, row_of, save

import nw_eval
from nw_base.errors import IncomparableError, UsageError
from nw_eval.api.saved_run import saved_trials
from nw_eval.suite import new_suite
from nw_gate.results.baseline import (
    BaselinePolicy,
    BaselineResults,
    Manifest,
    Panel,
    PanelInfo,
    Start,
    key_of,
    machine_of,
)
from nw_gate.results.baseline_file import write_baseline
from nw_gate.results.provenance import (
    SceneInfo,
)

SCENE, DIGEST, STARTS = "flat/room", "dd" * 32, 3


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """A folder: two runs on the same initial states, one on others, a better policy's baseline."""
    folder = tmp_path_factory.mktemp("reports")
    info = save_run(folder / "a", seed=7)
    save_run(folder / "b", seed=7)
    save_run(folder / "other", seed=8)
    write_baseline(folder / "first.parquet", better_baseline(info))
    return folder


def save_run(path, *, seed):
    """Save a run whose trials reached no waypoint."""
    settings = {"name": "tiny", "robot": "go1", "policy": "stand", "scenes": [SCENE]}
    suite = new_suite({"nw-eval": 1, "trials": STARTS, "seed": seed, **settings})
    info = info_of(
        suite,
        {SCENE: SceneInfo(digest=DIGEST, task="flat", trials=STARTS)},
        id=path.name,
        engine={"mujoco": "4.0.0", "renderer": "cpu gsplat-1.5", "cpu": "znver4 1f0c77a2"},
    )
    save(path, info, [row_of(trial, 0) for trial in saved_trials(info, suite)], ended=False)
    return info


def better_baseline(info):
    """A baseline on the starts of a run, of a policy that reached everything."""
    starts = tuple(
        Start(
            scene=SCENE,
            task="flat",
            seed_index=index,
            success=1.0,
            completed=True,
            waypoints_reached=4,
            waypoints_total=4,
            outcome="completed",
            end_reason="",
            trajectory="0" * 16,
        )
        for index in range(STARTS)
    )
    machine = machine_of(info)
    panel = PanelInfo(machine=machine, saved="2026-11-22T10:00:00Z", by="anna", rows_digest="dd")
    manifest = Manifest(
        name="first",
        suite="tiny",
        starts=STARTS,
        key=key_of(info),
        policy=BaselinePolicy(name="shipped", card_digest="bb", checkpoint_digest="cc"),
        panels=(panel,),
    )
    return BaselineResults(manifest=manifest, panels=(Panel(machine=machine, starts=starts),))


def test_two_runs_and_a_baseline_stand_side_by_side(reports):
    found = nw_eval.compare([reports / "a", reports / "b", reports / "first.parquet"])
    assert [each.label for each in found.policies] == ["stand (a)", "stand (b)", "shipped"]
    assert [each.mean for each in found.policies] == [0.0, 0.0, 1.0]
    assert found.starts == 3
    # Three starts decide nothing, however far apart.
    assert {(each.ranks.best, each.ranks.worst) for each in found.policies} == {(1, 3)}


def test_a_page_and_a_picture_are_written_where_they_are_wanted(reports, tmp_path):
    page, picture = tmp_path / "side.md", tmp_path / "side.png"
    nw_eval.compare([reports / "a", reports / "b"], out=page, picture=picture)
    assert "stand (b)" in page.read_text("utf-8")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_runs_on_other_starts_are_invalid_and_the_field_is_named(reports):
    with pytest.raises(IncomparableError, match="its seed is 8, there 7"):
        nw_eval.compare([reports / "a", reports / "other"])


def test_what_is_neither_a_run_nor_a_baseline_is_named(reports):
    with pytest.raises(UsageError, match=r"nowhere is not a run folder, and suite 'tiny' has no"):
        nw_eval.compare([reports / "a", "nowhere"])
    with pytest.raises(UsageError, match="name the baseline's file"):
        nw_eval.compare(["nowhere", "elsewhere"])
    with pytest.raises(UsageError, match="not the folder of a run"):
        nw_eval.compare([reports, reports / "a"])
    with pytest.raises(UsageError, match=r"confidence 95 .*0\.95 is 95 %"):
        nw_eval.compare([reports / "a", reports / "b"], confidence=95)


@pytest.mark.parametrize(
    ("names", "code"), [(("a", "first.parquet"), 0), (("a", "other"), 5), (("a",), 2)]
)
def test_the_verb_prints_tables_and_ends_with_the_errors_code(reports, names, code, capsys):
    assert ends("compare", *(str(reports / name) for name in names)) == code
    printed = capsys.readouterr()
    assert ("Policies on tiny" in printed.out) == (code == 0)
    assert printed.err.count("\n") == (code != 0)


def test_comparing_imports_no_simulation_and_draws_only_when_asked(reports):
    code = (
        "import sys, nw_eval; nw_eval.compare(sys.argv[1:]); "
        "print({'mujoco', 'torch', 'numba', 'onnxruntime', 'matplotlib'} & {*sys.modules})"
    )
    runs = [str(reports / name) for name in ("a", "b", "first.parquet")]
    done = subprocess.run(
        [sys.executable, "-c", code, *runs], capture_output=True, text=True, check=True
    )
    assert done.stdout == "set()\n"
