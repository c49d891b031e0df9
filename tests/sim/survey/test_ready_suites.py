"""A suite that a check writes runs as it is."""

from __future__ import annotations

import pytest
from sample_corridor import corridor

from nw_base.errors import UsageError
from nw_eval import api, cli
from nw_eval.suite import load_suite
from nw_sim.catalogue import from_folder

SCENE = """\
nw-scene: 1
name: my/corridor
task: stairs
licence: MIT
collision: collision.ply
trail: [[2.0, 0, 0.1], [4.0, 0, 0]]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "corridor").mkdir()
    corridor().export(tmp_path / "corridor" / "collision.ply")
    (tmp_path / "corridor" / "scene.yaml").write_text(SCENE)
    return tmp_path / "corridor"


def left_with(*arguments):
    with pytest.raises(SystemExit) as left:
        cli.main([*map(str, arguments)])
    return int(left.value.code or 0)


def test_a_suite_of_a_checked_folder_runs_as_it_is(folder, tmp_path, capsys):
    suite = tmp_path / "suites" / "mine of May.yaml"
    assert left_with("scenes", "check", folder, "--suite", suite) == 0
    assert f"nw-eval run '{suite}'" in capsys.readouterr().out
    loaded = load_suite(suite)
    assert (loaded.name, loaded.scenes) == ("mine-of-May", ("../corridor",))
    options = ["--trials", "1", "--record", "none", "--in-process", "--out", tmp_path / "run"]
    assert left_with("run", suite, *options) in {0, 1, 3}  # A verdict, whichever.


@pytest.mark.usefixtures("folder")
def test_paths_start_at_the_suite_and_names_stay(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    there = tmp_path / "suites"
    assert from_folder("corridor", there) == "../corridor"
    assert from_folder("triangles:corridor/scene.yaml", there) == "triangles:../corridor"
    assert from_folder("neverwhere:corridor", there) == "neverwhere:../corridor"
    for name in ("hurdles/three_low", "hub:lab/corridor@v2", "neverwhere:hurdle_stata_v1"):
        assert from_folder(name, there) == name


def test_no_suite_is_written_where_something_is_wrong(folder, tmp_path):
    (folder / "scene.yaml").write_text(SCENE.replace("4.0", "40.0"))
    assert left_with("scenes", "check", folder, "--suite", tmp_path / "mine.yaml") == 2
    assert not (tmp_path / "mine.yaml").exists()


def test_a_suite_that_is_there_stays_as_it_is(folder, tmp_path):
    (tmp_path / "mine.yaml").write_text("mine")
    with pytest.raises(UsageError, match=r"mine\.yaml is there already"):
        api.check_scenes([str(folder)], out=tmp_path / "mine.yaml")
    assert (tmp_path / "mine.yaml").read_text() == "mine"
