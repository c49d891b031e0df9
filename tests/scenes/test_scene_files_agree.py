"""Meshes of another unit or origin, and splats that say what they were trained for, in folders."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nw_base.errors import SceneError
from nw_scenes.folder import folder_files, inspect_folder
from nw_sim.catalogue import get_scene
from nw_splat.files import write_splat
from nw_splat.gaussians import Gaussians
from nw_splat.store import open_store

SCENE = """\
nw-scene: 1
name: my/place
task: stairs
licence: MIT
trail: [[2.5, 0, 0.1], [4.5, 0, 0]]
"""


def place(folder, *, scale=1.0, shift=(0, 0, 0), file="collision.ply", extra=""):
    """A floor of 9 x 5 m with a step of 0.1 m, in another unit or elsewhere."""
    translation = trimesh.transformations.translation_matrix
    floor = trimesh.creation.box((9, 5, 0.2), translation((2.5, 0, -0.1)))
    step = trimesh.creation.box((1, 3, 0.1), translation((2.5, 0, 0.05)))
    mesh = trimesh.util.concatenate([floor, step])
    mesh.apply_scale(scale)
    mesh.apply_translation(shift)
    folder.mkdir(exist_ok=True)
    mesh.export(folder / file)
    (folder / "scene.yaml").write_text(SCENE + f"collision: {file}\n{extra}")
    return folder


def splat(mode=None, count=6):
    return Gaussians(
        means=np.random.default_rng(0).normal(size=(count, 3)),
        log_scales=np.full((count, 3), -3.0),
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        opacity_logits=np.full(count, 2.0),
        sh=np.zeros((count, 1, 3)),
        rasterize_mode=mode,
    )


def test_a_place_in_metres_is_as_it_is(tmp_path):
    scene, findings = inspect_folder(place(tmp_path))
    assert np.ptp(scene.static_mesh.vertices[:, 0]) == pytest.approx(9)
    assert [one.code for one in findings if one.code.startswith("mesh_")] == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"scale": 1000}, "9000 m wide: its unit is not the metre; multiply it by 0.001"),
        ({"scale": 0.001}, "0.009 m wide, less than a robot is long"),
        (
            {"shift": (448262, 912, 312)},
            r"448\.3 km from.*subtract \(448264, 912, 312\)",
        ),
        ({"shift": (448262, 5411932, 312)}, r"a coordinate is 5\.4.*subtract its middle \(44826"),
        ({"shift": (0, 0, 5000)}, r"5\.0 km from the origin"),
    ],
)
def test_a_unit_or_an_origin_that_cannot_be_right_is_refused_with_what_to_do(
    tmp_path, changes, words
):
    with pytest.raises(SceneError, match=words) as caught:
        inspect_folder(place(tmp_path, **changes))
    assert "collision.ply" in str(caught.value)


def test_a_place_in_centimetres_is_a_warning(tmp_path):
    _, findings = inspect_folder(place(tmp_path, scale=100))
    (wide,) = [one for one in findings if one.code == "mesh_wide"]
    assert wide.severity == "warning"
    assert wide.value == pytest.approx(900)
    assert "multiply the mesh by 0.01" in wide.fix


def test_stray_points_far_behind_a_scan_are_no_fault(tmp_path):
    folder = place(tmp_path)
    mesh = trimesh.load_mesh(folder / "collision.ply")
    mesh = mesh.subdivide().subdivide()
    stray = trimesh.Trimesh([[8000, 0, 0], [8001, 0, 0], [8000, 1, 0]], [[0, 1, 2]])
    trimesh.util.concatenate([mesh, stray]).export(folder / "collision.ply")
    _, findings = inspect_folder(folder)
    assert "mesh_wide" not in [one.code for one in findings]


def test_what_of_a_mesh_is_not_read_is_a_finding_of_its_scene(tmp_path):
    folder = place(tmp_path, file="collision.obj")
    with (folder / "collision.obj").open("a") as file:
        file.write("l 1 2\n")
    _, findings = inspect_folder(folder)
    assert "mesh_partly_read" in [one.code for one in findings]


@pytest.mark.parametrize("file", ["a.fbx", "a.gltf", "a.usdz"])
def test_a_mesh_of_another_format_is_refused_by_its_name(tmp_path, file):
    folder = place(tmp_path)
    (folder / "scene.yaml").write_text(SCENE + f"collision: {file}\n")
    (folder / file).write_bytes(b"\0\1")
    with pytest.raises(SceneError, match=rf"{file}' is a mesh of a format that is not read"):
        get_scene(folder)


@pytest.mark.parametrize("mode", ["classic", "antialiased", None])
def test_scene_yaml_says_how_a_splat_is_drawn_where_its_file_does_not_or_is_wrong(
    tmp_path, mode, monkeypatch
):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "cache"))
    folder = place(tmp_path / "place", extra="splat: a.ply\n")
    write_splat(folder / "a.ply", splat(mode))
    scene = get_scene(folder)
    assert open_store(scene.splat_store()).rasterize_mode == mode
    for wanted in ("classic", "antialiased"):
        place(folder, extra=f"splat: a.ply\nrasterize_mode: {wanted}\n")
        told = get_scene(folder)
        assert open_store(told.splat_store()).rasterize_mode == wanted
        assert told.digest != scene.digest
    place(folder, extra="splat: a.ply\nrasterize_mode: soft\n")
    with pytest.raises(SceneError, match="rasterize_mode"):
        get_scene(folder)


def test_all_ranks_of_a_checkpoint_are_files_of_the_scene(tmp_path):
    folder = place(tmp_path, extra="splat: ckpt_6999_rank0.pt\n")
    write_splat(folder / "ckpt_6999_rank0.pt", splat())
    alone = get_scene(folder).digest
    write_splat(folder / "ckpt_6999_rank1.pt", replace(splat(), means=splat().means + 1))
    assert {"ckpt_6999_rank0.pt", "ckpt_6999_rank1.pt"} <= set(folder_files(folder))
    assert get_scene(folder).digest != alone
