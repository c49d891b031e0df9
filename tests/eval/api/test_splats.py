"""Splats of files and of built-in scenes: looked into, exported, drawn."""

import numpy as np
import pytest
import trimesh
from command_line import ends
from PIL import Image as Picture

from nw_base.errors import SceneError
from nw_base.files.cache import cache_dir
from nw_eval import api
from nw_places.splits import EVALUATION
from nw_scenes.overview import circuit
from nw_scenes.rays import RayScene
from nw_sim.catalogue import get_scene
from nw_splat.camera import Camera, look_at
from nw_splat.files import read_splat
from nw_splat.render import CpuRenderer
from nw_splat.store import memory_store, open_store

GAPS = "gaps/two_12in_carpet"  # Its floor is lower than z = 0, where the robot starts.


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "gaps.ply"
    api.splat_convert(GAPS, path)
    return path


def test_a_built_in_splat_is_a_ply_that_others_read_in_world_metres(exported):
    vertices = trimesh.load(exported).metadata["_ply_raw"]["vertex"]["data"]
    columns = {name: vertices[name].astype(np.float64).ravel() for name in vertices.dtype.names}
    assert {"x", "f_dc_2", "opacity", "scale_2", "rot_3"} <= set(columns)
    assert all(np.isfinite(column).all() for column in columns.values())
    lengths = sum(columns[f"rot_{k}"] ** 2 for k in range(4))
    assert lengths == pytest.approx(np.ones(len(lengths)), abs=1e-5)
    # Most of it are the tops of the platforms and the floor round them, where the world has them.
    near = (np.abs(columns["x"] - 2) < 4) & (np.abs(columns["y"]) < 2)
    heights, counts = np.unique(np.round(columns["z"][near], 2), return_counts=True)
    assert sorted(heights[np.argsort(counts)[-2:]]) == [-0.41, 0.0]
    assert get_scene(GAPS).ground.z == -0.4064


def test_an_exported_splat_looks_as_the_scene_does(exported):
    scene = get_scene(GAPS)
    down = scene.T_world_splat[2, 3]
    images = [
        renderer.render(
            Camera.from_fovy(
                width=80,
                height=45,
                fovy=1.2,
                T_world_camera=look_at((-0.3, 0.2, 0.4 - z), (2, 0, 0.2 - z), (0, 0, 1)),
            )
        ).rgb
        for renderer, z in (
            (CpuRenderer(open_store(scene.splat_store())), down),
            (CpuRenderer(memory_store(read_splat(exported))), 0.0),
        )
    ]
    assert np.abs(images[0] - images[1]).max() < 2 / 255
    assert images[0].std() > 0.05


def test_info_takes_a_scene_a_file_and_what_lies_in_the_cache(exported):
    told = api.splat_info(GAPS)
    assert told == api.splat_info(exported)
    cached = get_scene(GAPS).splat_store()
    assert (cached.parent, cached.suffix) == (cache_dir("scenes"), ".nwsplat")
    assert api.splat_info(cached).count == told.count


def test_a_misspelt_scene_is_answered_with_the_nearest(tmp_path, capsys):
    assert ends("splat", "info", "hurdles/three_lo") == 2
    assert "no built-in scene is called 'hurdles/three_lo'; did you mean 'hurdles/three_low'?" in (
        capsys.readouterr().err
    )
    with pytest.raises(SceneError, match=r"none\.ply: No such file"):
        api.splat_convert("none.ply", tmp_path / "out.ply")


def test_a_turn_of_a_scene_goes_round_its_trail(tmp_path):
    api.splat_render(GAPS, tmp_path / "a.gif", size=(64, 48), frames=4)
    with Picture.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 4
    eyes, target = circuit(get_scene(GAPS), 4)
    behind, left, ahead, right = eyes - target
    assert behind[0] < -1 < 1 < ahead[0]
    assert {left[1] > 0.9, right[1] > 0.9} == {True, False}
    assert (eyes[:, 2] > target[2]).all()


@pytest.mark.parametrize("name", EVALUATION)
def test_on_its_way_round_a_camera_stays_within_the_walls(name):
    scene = get_scene(name)
    eyes, target = circuit(scene, 24)
    rays = eyes - target
    length = np.linalg.norm(rays, axis=1)
    free = RayScene(scene.mesh()).distance(
        np.broadcast_to(target, rays.shape), rays / length[:, None]
    )
    assert (free > length).all()
    turns = np.diff(np.append(length, length[0]))
    assert np.abs(turns).max() < 1.5


def test_a_turn_from_a_given_eye_looks_round_from_there(tmp_path, exported):
    size, eye = (64, 48), (0.0, 0.3, 0.4)
    still, turn = tmp_path / "a.png", tmp_path / "a.gif"
    api.splat_render(str(exported), turn, size=size, up="+z", eye=eye, frames=2)
    with Picture.open(turn) as gif:
        frames = []
        for index in range(gif.n_frames):
            gif.seek(index)
            frames.append(np.asarray(gif.convert("RGB"), dtype=float))
    for x, frame in zip((1.0, -1.0), frames, strict=True):
        api.splat_render(str(exported), still, size=size, up="+z", eye=eye, target=(x, 0.3, 0.4))
        shown = np.asarray(Picture.open(still), dtype=float)
        # A GIF has 256 colours.
        assert np.abs(frame - shown).mean() < 6 < shown.std()
