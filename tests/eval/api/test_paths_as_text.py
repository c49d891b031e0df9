"""A path may be given as text in every function of the Python API."""

import inspect
from pathlib import Path

import pytest

from nw_eval import api

FUNCTIONS = {name: each for name in api.__all__ if inspect.isfunction(each := getattr(api, name))}
PATH_ALONE = {"Path", "Path | None"}
SUITE = """\
nw-eval: 1
name: tiny
robot: go1
policy: stand
trials: 1
seed: 7
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: all
"""


@pytest.mark.parametrize("name", FUNCTIONS)
def test_no_parameter_is_a_path_and_no_text(name):
    function = inspect.unwrap(FUNCTIONS[name])
    parameters = inspect.signature(function).parameters.values()
    assert not [each.name for each in parameters if str(each.annotation) in PATH_ALONE]


def test_a_run_is_made_shown_and_replayed_with_text_for_every_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tiny.yaml").write_text(SUITE)
    ran = api.run("tiny.yaml", out="run", workers=1)
    assert ran.folder == tmp_path / "run"
    assert api.run(resume="run", workers=1).folder == tmp_path / "run"
    log = next(Path("run").rglob("*.mcap"))
    api.replay(str(log), picture="trial.png")
    api.report("run", out="report.md")
    api.judge("run", out="judged.md")
    api.index_runs(["run"], out="index.html")
    api.log_scores(str(log))
    api.foxglove_layout(str(log), "layout.json")
    api.schema("suite", out="suite.json")
    api.show_scene("flat/carpet_room", out="scene.png")
    api.render_scenes(["flat/carpet_room"], out="scenes.png", width=64)
    written = (
        *("trial.png", "report.md", "judged.md", "index.html"),
        *("layout.json", "suite.json", "scene.png", "scenes.png"),
    )
    assert all(Path(name).is_file() for name in written)


def test_a_checkpoint_and_a_surface_may_be_text(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    checkpoint = str(api.show_policy("go1-parkour").path.parent / "policy.onnx")
    assert api.show_policy("go1-parkour", checkpoint=checkpoint) is not None
    Path("tiny.yaml").write_text(SUITE)
    ran = api.run("tiny.yaml", out="run", workers=1)
    where = api.Surfaces(junit="junit.xml", comment="comment.md")
    assert not api.publish(ran, where).warnings
    assert Path("junit.xml").is_file()
    assert Path("comment.md").is_file()
