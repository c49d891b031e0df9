"""Robots of folders are compiled once: the cache has what follows from their files' bytes."""

import shutil
from dataclasses import replace

import pytest
import trimesh

from nw_eval import api
from nw_scenes import robots
from nw_scenes.robots import compiled, find_robot, kept
from nw_scenes.robots.derived import spec_of
from nw_scenes.robots.folder import read_folder

LEG = (
    "<body name='{0}' pos='{1} {2} 0'><joint name='{0}' axis='0 1 0' range='-1 1'/>"
    "<geom type='mesh' mesh='foot' pos='0 0 -.2' mass='.5'/></body>"
)
LEGS = "".join(
    LEG.format(f"leg_{n}", x, y)
    for n, (x, y) in enumerate([(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1)])
)
MODEL = (
    "<mujoco><asset><mesh name='foot' file='foot.stl'/></asset><worldbody>"
    "<body name='trunk'><freejoint/><geom type='box' size='.2 .1 .04' mass='5'/>"
    f"{LEGS}</body></worldbody></mujoco>"
)
YAML = "nw-robot: 1\nname: table\nmodel: {file: robot.xml}\nmotors: [{joints: '*', kp: 30, kd: 1}]"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A robot's folder, and a cache of its own."""
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    place = tmp_path / "table"
    place.mkdir()
    trimesh.creation.box((0.04, 0.04, 0.04)).export(place / "foot.stl")
    (place / "robot.xml").write_text(MODEL)
    (place / "robot.yaml").write_text(YAML.replace("kd: 1}", "kd: 1, torque: 20}"))
    return place


def anew(folder):
    """Find a robot as another process does, which has read nothing yet."""
    robots._read.clear()
    return find_robot(f"{folder}/")


def test_a_robot_is_compiled_once_and_then_taken_from_the_cache_to_the_bit(folder, monkeypatch):
    first = anew(folder)
    monkeypatch.setattr(kept, "spec_of", None)  # To compile again would fail.
    assert anew(folder) == first
    assert spec_of(read_folder(folder)) == first.spec


@pytest.mark.parametrize("of", ["robot.yaml", "foot.stl", "the cache"])
def test_what_is_kept_serves_no_other_files_and_not_when_it_is_damaged(folder, of):
    first = anew(folder)
    (path,) = folder.parent.glob("cache/robots/*.json.z")
    if of == "robot.yaml":
        (folder / of).write_text((folder / of).read_text().replace("kp: 30", "kp: 31"))
    elif of == "foot.stl":
        trimesh.creation.box((0.06, 0.04, 0.04)).export(folder / of)
    else:
        path.write_bytes(path.read_bytes()[:-90])
    assert (anew(folder) == first) is (of == "the cache")


def test_what_is_packed_of_a_folder_serves_no_other_one_with_the_same_files(folder):
    first = anew(folder)
    stranger = folder.parent / "stranger"
    shutil.copytree(folder, stranger)
    files = read_folder(stranger).files
    forged = replace(first.spec, kp=tuple(2.0 * each for each in first.spec.kp))
    kept.keep(stranger, files, kept.packed(forged, ()))
    assert anew(stranger).spec.kp == forged.kp, "its own folder has what was packed of it"
    assert anew(folder) == first


def test_a_draft_compiles_its_model_once_and_leaves_it_in_the_cache(folder, monkeypatch):
    (folder / "robot.yaml").unlink()
    api.init_robot(folder / "robot.xml")
    monkeypatch.setattr(kept, "spec_of", None)
    drafted = anew(folder)
    monkeypatch.undo()
    assert drafted.spec == spec_of(read_folder(folder))


def test_robots_of_one_model_share_what_their_settings_do_not_change(folder):
    texts = [YAML.replace("kd: 1", f"kd: {kd}, torque: 20") for kd in (1, 2)]
    shared, calls = compiled.Shared(), []
    make = shared.get
    shared.get = lambda key, what: make(key, lambda: calls.append(key) or what())
    both = [spec_of(read_folder(folder, text), shared) for text in texts]
    assert both == [spec_of(read_folder(folder, text)) for text in texts]
    assert len(calls) == len(set(calls)) == 4  # Compiled, drawn, written out, and a ground.
