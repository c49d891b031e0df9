"""Scene folders whose collision file is a mesh."""

import numpy as np
import pytest
import trimesh

from nw_base.errors import SceneError
from nw_scenes.folder import load_folder
from nw_scenes.scene import HeightField, Triangles
from nw_sim.catalogue import get_scene, open_scene, references

TEXT = """\
nw-scene: 1
name: scanned
task: hurdles
licence: MIT
trail: [[1.7, 0.0, 0.15], [3.0, 0.0, 0.0]]
collision: {file}
"""


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))


def folder_with(tmp_path, file):
    floor = trimesh.creation.box((12, 8, 1))
    floor.apply_translation((3, 0, -0.5))
    bar = trimesh.creation.box((0.2, 1.6, 0.15))
    bar.apply_translation((1.7, 0, 0.075))
    trimesh.util.concatenate([floor, bar]).export(tmp_path / file)
    (tmp_path / "scene.yaml").write_text(TEXT.format(file=file))
    return tmp_path


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_a_mesh_becomes_terrain_that_one_can_walk_on(tmp_path, suffix):
    scene = get_scene(folder_with(tmp_path, f"collision.{suffix}"))
    field = scene.solids[0]
    assert isinstance(field, HeightField)
    heights = field.height(np.array([[0.0, 0.0], [1.7, 0.3], [3.0, -0.2]]))
    assert heights == pytest.approx([0.0, 0.15, 0.0], abs=1e-4)
    assert scene.ground.z < -0.4


def test_triangles_are_taken_from_the_mesh(tmp_path):
    folder = folder_with(tmp_path, "collision.obj")
    (solid,) = load_folder(folder, collision="triangles").solids
    assert isinstance(solid, Triangles)


def test_a_missing_mesh_is_named(tmp_path):
    folder = folder_with(tmp_path, "collision.obj")
    (folder / "collision.obj").unlink()
    with pytest.raises(SceneError, match=r"collision\.obj"):
        load_folder(folder)


def test_a_reference_and_an_option_choose_the_triangles_and_the_digest_tells(tmp_path):
    folder = folder_with(tmp_path, "collision.obj")
    terrain = get_scene(folder)
    assert isinstance(get_scene(f"triangles:{folder}").solids[0], Triangles)
    (reference,) = references([str(folder)], collision="triangles")
    assert reference == (str(folder.resolve()), "triangles")
    exact = open_scene(*reference)
    assert isinstance(exact.solids[0], Triangles)
    assert exact.digest != terrain.digest
    # What is asked for wins over what the suite says of a place.
    assert references([f"triangles:{folder}"]) == (reference,)
    assert references([f"triangles:{folder}"], collision="terrain") != (reference,)


def test_boxes_of_built_in_scenes_are_exact_already():
    (reference,) = references(["hurdles/three_low"], collision="triangles")
    assert open_scene(*reference) is get_scene("hurdles/three_low")
    assert get_scene("triangles:hurdles/three_low") is get_scene("hurdles/three_low")
