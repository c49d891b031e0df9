"""Ladders of scenes, of folders and packages, of perturbations and commands."""

from __future__ import annotations

import shutil

import pytest
import yaml

from nw_base.errors import PluginError, SceneError
from nw_base.plugins import LADDERS, installed
from nw_scenes.ladder_file import load_ladder
from nw_sim.axes import Perturb
from nw_sim.catalogue import from_folder, get_scene, inspect_scene, references
from nw_sim.ladders import ladder_named, ladders, rungs_of

TEXT = {
    "nw-ladder": 1,
    "name": "lab/steps",
    "parameter": "height of the step",
    "unit": "m",
    "rungs": [{"value": 0.12, "scene": "low"}, {"value": 0.24, "scene": "high"}],
}


@pytest.fixture
def folder(tmp_path):
    """A folder with a ladder of two scenes."""
    mine = tmp_path / "my-steps"
    for name, height in (("low", 0.12), ("high", 0.24)):
        (mine / name).mkdir(parents=True)
        scene = {"nw-scene": 1, "name": name, "task": "hurdles", "licence": "MIT"}
        scene["trail"] = [[2.0, 0.0, height], [4.0, 0.0, 0.0]]
        box = {"center": [2.0, 0.0, height / 2], "half_size": [0.5, 1.0, height / 2]}
        (mine / name / "scene.yaml").write_text(yaml.safe_dump(scene))
        (mine / name / "collision.yaml").write_text(yaml.safe_dump({"boxes": [box]}))
    write(mine)
    return mine


def write(folder, **changes):
    (folder / "ladder.yaml").write_text(yaml.safe_dump({**TEXT, **changes}))


def test_every_ladder_goes_from_easy_to_hard_and_can_be_asked_for_by_its_name():
    found = ladders()
    assert len({ladder.name for ladder in found}) == len(found) == 22
    for ladder in found:
        values = [rung.value for rung in ladder.rungs]
        assert values == sorted(values, reverse=ladder.harder == "down")
        assert (min(values), max(values)) == (ladder.low, ladder.high)
        assert len(values) == 14
        assert rungs_of(ladder.name) == ladder.rungs


def test_rungs_of_scenes_are_scenes_and_change_nothing():
    rungs = rungs_of("ramps/up~2")
    assert references([rung.scene for rung in rungs]) == references(["ramps/up@*~2"])
    assert not any(rung.perturbation for rung in rungs)


def test_values_of_axes_are_such_as_suites_may_have():
    for ladder in ladders():
        for rung in ladder.rungs:
            Perturb.model_validate({axis: (value,) for axis, value in rung.perturbation})
    rungs = rungs_of("gaps/gap@0.5+field_of_view")
    assert {rung.scene for rung in rungs} == {"gaps/gap@0.5"}
    assert [rung.value for rung in rungs][:2] == [1.0, 0.9615]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("hurdles/baar", "did you mean 'hurdles/bar'"),
        ("hurdles/bar~3", "setting 3 of a ladder that has 3"),
        ("hurdles/*+payload", "is on 16 scenes; name one scene"),
        ("nowhere+payload", "no scene matches 'nowhere'"),
        ("hurdles/three_low+payloads", "there is no ladder"),
    ],
)
def test_an_unknown_ladder_is_reported(wrong, message):
    with pytest.raises(SceneError) as raised:
        ladder_named(wrong)
    assert message in str(raised.value)


def test_a_folder_is_a_ladder_whose_rungs_are_its_scenes(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert references(["./my-steps@0.12"]) == ((str(folder / "low"), "terrain"),)
    assert references(["my-steps@0.240"], tmp_path) == ((str(folder / "high"), "terrain"),)
    both = [str(folder / "low"), str(folder / "high")]
    assert [reference for reference, _ in references(["my-steps@*"])] == both
    assert get_scene("my-steps@0.24").digest == get_scene(folder / "high").digest
    assert from_folder("my-steps@0.24", tmp_path / "suites") == "../my-steps/high"
    assert inspect_scene("my-steps@0.12", read_splat=False).survey is not None
    found = ladder_named("my-steps")
    assert (found.unit, found.harder, found.low, found.high) == ("m", "up", 0.12, 0.24)
    assert [(rung.value, rung.scene) for rung in found.rungs] == list(
        zip([0.12, 0.24], both, strict=True)
    )


def test_of_a_ladder_that_grows_harder_downwards_the_greatest_value_comes_first(folder):
    write(folder, harder="down")
    assert [rung.value for rung in rungs_of(str(folder))] == [0.24, 0.12]


def test_a_folder_s_ladder_has_the_listed_values_only_and_is_not_a_scene(folder):
    with pytest.raises(SceneError, match=r"no such rung; its rungs are 0\.12, 0\.24"):
        references([f"{folder}@0.2"])
    with pytest.raises(
        SceneError, match=r"is a ladder and no scene; name a rung, such as .*@0\.12"
    ):
        get_scene(folder)


@pytest.mark.parametrize(
    ("rungs", "message"),
    [
        ([{"value": 0.1, "scene": "low"}], "rungs"),
        ([{"value": 0.2, "scene": "low"}, {"value": 0.1, "scene": "high"}], "ascending order"),
        ([{"value": 0.1, "scene": "low"}, {"value": 0.1, "scene": "high"}], "ascending order"),
        ([{"value": 0.1, "scene": "low"}, {"value": 0.2, "scene": "../x"}], "it has `..`"),
        ([{"value": 0.1, "scene": "low"}, {"value": 0.2, "scene": "gone"}], "is not a folder"),
    ],
)
def test_a_wrong_ladder_file_is_said_with_its_line(folder, rungs, message):
    write(folder, rungs=rungs)
    with pytest.raises(SceneError) as raised:
        load_ladder(folder)
    assert message in str(raised.value)
    assert "ladder.yaml:" in str(raised.value)


def test_a_link_out_of_the_ladder_s_folder_is_refused(folder, tmp_path):
    shutil.move(folder / "high", tmp_path / "elsewhere")
    (folder / "high").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(SceneError, match="a link on its way leads to"):
        load_ladder(folder)


def test_a_package_brings_a_ladder(folder, tmp_path, monkeypatch):
    site = tmp_path / "site"
    (site / "lab_steps-1.0.dist-info").mkdir(parents=True)
    (site / "lab_steps-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: lab-steps\nVersion: 1.0\n"
    )
    (site / "lab_steps-1.0.dist-info" / "entry_points.txt").write_text(
        f"[{LADDERS}]\nlab-steps = lab_steps:FOLDER\nbroken = lab_steps:OTHER\n"
    )
    (site / "lab_steps.py").write_text(f"FOLDER = {str(folder)!r}\nOTHER = 3\n")
    monkeypatch.syspath_prepend(site)
    installed.cache_clear()
    try:
        assert references(["lab-steps@0.12"]) == ((str(folder / "low"), "terrain"),)
        assert [rung.value for rung in rungs_of("lab-steps")] == [0.12, 0.24]
        with pytest.raises(
            PluginError, match=r"of lab-steps .* is not a folder with a ladder\.yaml"
        ):
            rungs_of("broken")
    finally:
        monkeypatch.undo()
        installed.cache_clear()
