from __future__ import annotations

import json

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_scenes.rays import RayScene
from nw_sim.catalogue import get_scene
from nw_splat.files import write_splat
from nw_splat.gaussians import Gaussians
from nw_splat.store import open_store

_SCENE = """\
nw-scene: 1
name: mine/kerb
task: hurdles
licence: CC-BY-4.0
trail: [[1.5, 0, 0.2], [3, 0, 0]]
spawn: {position: [0, 0, 0], yaw: 0.1}
collision: boxes.json
T_world_splat: {scale: 2.0, translation: [1, 2, 3]}
"""
_BOXES = {"boxes": [{"center": [1.5, 0, 0.1], "half_size": [0.2, 1.0, 0.1]}]}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.yaml").write_text(_SCENE)
    (tmp_path / "boxes.json").write_text(json.dumps(_BOXES))
    return tmp_path


def test_a_folder_with_boxes_becomes_a_scene(folder):
    scene = get_scene(folder)
    assert scene.name == "mine/kerb"
    assert scene.licence == "CC-BY-4.0"
    assert scene.spawn.yaw == 0.1
    assert scene.solids[0].half_size == (0.2, 1.0, 0.1)
    assert scene.T_world_splat.tolist() == [
        [2, 0, 0, 1], [0, 2, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1],
    ]  # fmt: skip
    assert np.allclose(RayScene(scene.mesh()).height(scene.trail[:, :2]), scene.trail[:, 2])


def test_the_path_of_the_file_names_the_folder_too(folder):
    assert get_scene(folder / "scene.yaml").digest == get_scene(str(folder)).digest


def test_a_folder_without_a_splat_says_so_when_asked_for_it(folder):
    with pytest.raises(SceneError, match="'mine/kerb' has no splat"):
        get_scene(folder).splat_store()


def test_a_splat_that_is_not_there_is_named(folder):
    (folder / "scene.yaml").write_text(_SCENE + "splat: splat.ply\n")
    with pytest.raises(SceneError, match=r"no splat 'splat\.ply'"):
        get_scene(folder)


def test_a_splat_file_is_compiled_into_the_cache(folder, tmp_path_factory, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path_factory.mktemp("cache")))
    points = np.random.default_rng(3).normal(size=(50, 3))
    gaussians = Gaussians(
        means=points, log_scales=np.full((50, 3), -3.0), quats=np.tile([1.0, 0, 0, 0], (50, 1)),
        opacity_logits=np.full(50, 2.0), sh=np.zeros((50, 1, 3)),
    )  # fmt: skip
    write_splat(folder / "splat.ply", gaussians)
    (folder / "scene.yaml").write_text(_SCENE + "splat: splat.ply\n")
    assert open_store(get_scene(folder).splat_store()).count == 50


def test_the_digest_covers_the_splat_file(folder):
    (folder / "scene.yaml").write_text(_SCENE + "splat: splat.ply\n")
    (folder / "splat.ply").write_bytes(b"one")
    first = get_scene(folder).digest
    (folder / "splat.ply").write_bytes(b"two")
    assert get_scene(folder).digest != first


def test_all_problems_of_a_scene_file_come_with_their_lines(folder):
    text = _SCENE.replace("task: hurdles", "task: hurdle").replace("yaw: 0.1", "yaw: up")
    (folder / "scene.yaml").write_text(text + "licens: MIT\n")
    with pytest.raises(SceneError) as caught:
        get_scene(folder)
    message = str(caught.value)
    assert "scene.yaml:3:" in message
    assert "scene.yaml:6:" in message
    assert "did you mean 'licence'?" in message


def test_a_box_without_a_size_is_refused(folder):
    (folder / "boxes.json").write_text(
        json.dumps({"boxes": [{"center": [0, 0, 0], "half_size": [1, 0, 1]}]})
    )
    with pytest.raises(SceneError, match="half_size must be positive"):
        get_scene(folder)


def test_a_missing_collision_file_is_named(folder):
    (folder / "boxes.json").unlink()
    with pytest.raises(SceneError, match=r"boxes\.json.*cannot be read"):
        get_scene(folder)


def test_a_folder_that_is_no_scene_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"scene\.yaml.*cannot be read"):
        get_scene(tmp_path)
