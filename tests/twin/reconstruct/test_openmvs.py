"""OpenMVS's programs are run with the right words; stand-ins of ours check them."""

import os
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_room import SHEETS, SMALL, depth_of_room
from twin_parts import grid, joined

from nw_base.errors import PrerequisiteError, SceneError
from nw_twin.capture import read_capture
from nw_twin.reconstruct.depth import array_file
from nw_twin.reconstruct.reconstruct import reconstruct, write_colmap_model
from nw_twin.reconstruct.surface import ColourMesh, read_colour_mesh, write_mesh

OPENMVS = replace(SMALL, engine="openmvs", voxel=None)

FAKE = """#!{python}
import os, shutil, sys
from pathlib import Path

name, words = Path(sys.argv[0]).name, sys.argv[1:]
options = dict(zip(words[::2], words[1::2], strict=True))
work = Path(options.pop("-w"))
assert work == Path.cwd(), work
print(name, "at work")
if name == os.environ.get("FAILS"):
    print("error: not enough memory\\n")
    sys.exit(3)
if name == "InterfaceCOLMAP":
    model, images = Path(options.pop("-i")), Path(options.pop("--image-folder"))
    assert sorted(p.name for p in (model / "sparse").iterdir()) == [
        "cameras.txt", "images.txt", "points3D.txt"]
    lines = (model / "sparse/images.txt").read_text().splitlines()
    names = [line.split()[9] for line in lines[::2]]
    assert len(names) == 10 and all((images / each).is_file() for each in names)
    assert options == {{"-o": "scene.mvs"}}, options
    (work / "scene.mvs").write_text("scene")
elif name == "DensifyPointCloud":
    assert options == {{"-i": "scene.mvs", "-o": "dense.mvs", "--max-threads": "2"}}, options
    assert (work / "scene.mvs").read_text() == "scene"
    (work / "dense.mvs").write_text("dense")
elif name == "ReconstructMesh":
    assert options == {{"-i": "dense.mvs", "-o": "mesh.mvs", "--max-threads": "2"}}, options
    assert (work / "dense.mvs").read_text() == "dense"
    if os.environ.get("FAILS") != "silently":
        shutil.copyfile({mesh!r}, work / "mesh.ply")
"""


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """A PATH with stand-ins, the last of which leaves the room itself."""
    parts = []
    for sheet in SHEETS:  # Each as a grid of 10 cm.
        sides = (sheet.first, sheet.second)
        cells = [max(1, round(float(np.linalg.norm(side)) / 0.1)) for side in sides]
        parts.append(grid(sheet.corner, *sides, cells))
    vertices, faces = joined(*parts)
    room = ColourMesh(vertices=vertices, faces=faces, colours=np.zeros(vertices.shape, np.uint8))
    write_mesh(room, tmp_path / "room.ply")
    binaries = tmp_path / "bin"
    binaries.mkdir()
    for name in ("InterfaceCOLMAP", "DensifyPointCloud", "ReconstructMesh"):
        text = FAKE.format(python=sys.executable, mesh=str(tmp_path / "room.ply"))
        (binaries / name).write_text(text)
        (binaries / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{binaries}{os.pathsep}{os.environ['PATH']}")
    return binaries


@pytest.mark.usefixtures("programs")
def test_a_mesh_of_openmvs_gets_depth_maps_and_colours(room, tmp_path):
    words = []
    report = reconstruct(room, tmp_path / "mesh", replace(OPENMVS, least_part=0.0), words.append)
    assert words[:3] == [
        f"runs {n}" for n in ("InterfaceCOLMAP", "DensifyPointCloud", "ReconstructMesh")
    ]
    assert report.engine == "openmvs"
    shot = read_capture(room).shots[2]
    with np.load(array_file(tmp_path / "mesh" / "depth", shot.name)) as arrays:
        depth, confidence = arrays["depth"], arrays["confidence"]
    true = depth_of_room(shot.camera)
    both = np.isfinite(true) & (depth > 0)
    assert both.sum() > 0.99 * np.isfinite(true).sum()
    assert np.median(np.abs(depth - true)[both]) < 1e-5
    assert set(np.unique(confidence)) == {0.0, 1.0}
    colours = read_colour_mesh(tmp_path / "mesh" / "mesh.ply").colours
    assert 60 < colours.mean() < 190
    assert colours.std() > 15


def test_poses_and_points_are_written_as_colmap_reads_them(room, tmp_path):
    capture, model = read_capture(room), tmp_path / "sparse"
    write_colmap_model(capture, room, tmp_path)
    lines = (model / "images.txt").read_text().splitlines()
    _, *quat, x, y, z, camera, name = lines[2 * 3].split()
    # COLMAP's documentation: world to camera, Hamilton's quaternion.
    rotation = Rotation.from_quat(np.array(quat, float), scalar_first=True).as_matrix()
    shift = np.array([x, y, z], float)
    shot = capture.shots[3]
    assert rotation == pytest.approx(shot.camera.T_camera_world[:3, :3], abs=1e-9)
    assert shift == pytest.approx(shot.camera.T_camera_world[:3, 3])
    assert (camera, name) == ("4", "000004.png")
    u, v, point = lines[2 * 3 + 1].split()[:3]
    local = rotation @ capture.points[int(point) - 1] + shift
    assert float(u) == pytest.approx(
        shot.camera.fx * local[0] / local[2] + shot.camera.cx, abs=1e-5
    )
    assert float(v) == pytest.approx(
        shot.camera.fy * local[1] / local[2] + shot.camera.cy, abs=1e-5
    )


@pytest.mark.usefixtures("programs")
def test_a_program_that_fails_is_named_with_its_last_words(room, tmp_path, monkeypatch):
    monkeypatch.setenv("FAILS", "DensifyPointCloud")
    words = r"DensifyPointCloud failed with 3; it said last: error: not enough memory; read .*\.log"
    with pytest.raises(SceneError, match=words):
        reconstruct(room, tmp_path, OPENMVS, lambda _: None)
    monkeypatch.setenv("FAILS", "silently")
    with pytest.raises(SceneError, match=r"ReconstructMesh ended well and wrote no mesh\.ply"):
        reconstruct(room, tmp_path, OPENMVS, lambda _: None)


def test_programs_that_are_missing_are_named(room, programs, tmp_path, monkeypatch):
    (programs / "DensifyPointCloud").unlink()
    monkeypatch.setenv("PATH", str(programs))
    with pytest.raises(PrerequisiteError, match="not on PATH: DensifyPointCloud; install OpenMVS"):
        reconstruct(room, tmp_path, OPENMVS, lambda _: None)
