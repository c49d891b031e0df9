"""Other programs' folders are read as they mean them, and damaged ones are named."""

import json
import shutil
import struct

import numpy as np
import pycolmap
import pytest
from PIL import Image

from nw_base.errors import NwEvalError, SceneError
from nw_twin.calibrate.calibrate import calibrate, find_source
from nw_twin.calibrate.colmap import read_model
from nw_twin.capture import read_capture
from nw_twin.options import CalibrateOptions

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def found(path, tmp_path, frames=50):
    return find_source(path, tmp_path, frames=frames, say=lambda _: None)


@pytest.fixture(scope="module")
def model():
    """A model that COLMAP itself made up."""
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=5, num_points3D=40
    )
    pycolmap.set_random_seed(0)
    return pycolmap.synthesize_dataset(options)


def written(model, folder, kind):
    folder.mkdir(parents=True)
    (model.write_binary if kind == "bin" else model.write_text)(folder)
    return folder


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_a_colmap_model_is_read_as_colmap_reads_it(model, tmp_path, kind):
    solution = read_model(written(model, tmp_path / "sparse" / "0", kind))
    ids = sorted(model.points3D)
    assert solution.points == pytest.approx(np.array([model.points3D[i].xyz for i in ids]))
    assert np.array_equal(solution.colours, [model.points3D[i].color for i in ids])
    assert len(solution.placed) == 5
    for image in model.images.values():
        one = solution.by_name[image.name]
        assert one.T_world_camera[:3, 3] == pytest.approx(image.projection_center())
        pose = image.cam_from_world().rotation.matrix()
        assert np.allclose(one.T_world_camera[:3, :3].T, pose)
        seen = {ids.index(p.point3D_id) for p in image.points2D if p.has_point3D()}
        assert set(one.seen.tolist()) == seen
        camera = model.cameras[image.camera_id]
        assert one.lens.params == pytest.approx(tuple(camera.params))
        assert one.lens.model == camera.model_name


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_a_damaged_colmap_model_is_an_error_of_ours_and_soon(model, tmp_path, kind):
    folder = written(model, tmp_path / "model", kind)
    rng = np.random.default_rng(0)
    refused = 0
    for name in ("cameras", "images", "points3D"):
        path = folder / f"{name}.{kind}"
        whole = path.read_bytes()
        for trial in range(40):
            data = bytearray(whole[: rng.integers(0, len(whole))] if trial % 2 else whole)
            for place in rng.integers(0, max(1, min(len(data), 200)), 3):
                data[place : place + 1] = bytes([rng.integers(0, 256)])
            path.write_bytes(data)
            try:
                read_model(folder)
            except NwEvalError:
                refused += 1
        path.write_bytes(whole)
    assert refused > 40


def test_counts_that_no_file_can_hold_are_refused_at_once(model, tmp_path):
    folder = written(model, tmp_path / "model", "bin")
    for name in ("cameras", "images", "points3D"):
        path = folder / f"{name}.bin"
        whole = path.read_bytes()
        path.write_bytes(struct.pack("<Q", 2**63) + whole[8:])
        with pytest.raises(SceneError, match="damaged"):
            read_model(folder)
        path.write_bytes(whole)


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("images", " 1 0 0 0 ", " 0 0 0 0 ", r"a\.jpg of .*quaternion \[0.0.* has the length 0"),
        ("images", " 1 0 0 0 ", " 1e308 1e308 0 0 ", r"a\.jpg of .* has the length inf"),
        ("images", " 0.1 ", " 1e308 ", r"a\.jpg of .* is at \[1e\+308, "),
        ("cameras", " 300 301 ", " 1e308 301 ", "camera 1 of .*cameras.txt: .*focal length"),
        ("cameras", " 300 301 ", " 300 -301 ", "camera 1 of .*cameras.txt: .*focal length"),
        ("cameras", " -0.1 ", " 1e9 ", "camera 1 of .*cameras.txt: .*distortion is over 50"),
        ("points3D", "1 1 2 3 ", "1 1e308 2 3 ", "is damaged: points are not finite, or beyond"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_number_that_no_camera_has_is_named_with_its_camera(tmp_path, file, old, new, words):
    texts = {
        "cameras": "1 OPENCV 320 180 300 301 160 90 -0.1 0 0 0\n",
        "images": "1 1 0 0 0 0.1 0.2 0.3 1 a.jpg\n1 1 1\n",
        "points3D": "1 1 2 3 9 9 9 0.5 1 0 2 0\n",
    }
    assert old in texts[file]
    for name, text in {**texts, file: texts[file].replace(old, new)}.items():
        (tmp_path / f"{name}.txt").write_text(text)
    with pytest.raises(SceneError, match=words):
        read_model(tmp_path)


def test_a_colmap_folder_becomes_a_capture_as_it_is(model, tmp_path):
    written(model, tmp_path / "in" / "sparse" / "0", "bin")
    (tmp_path / "in" / "images").mkdir()
    camera = next(iter(model.cameras.values()))
    for image in model.images.values():
        path = tmp_path / "in" / "images" / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (camera.width, camera.height), (90, 80, 70)).save(path)
    report = calibrate(tmp_path / "in", tmp_path / "out")
    capture = read_capture(tmp_path / "out")
    assert (report.source, report.mapping, report.matching) == ("colmap", "known", "none")
    assert report.placed == 5
    centres = {image.name: image.projection_center() for image in model.images.values()}
    for shot, centre in zip(capture.shots, capture.centres, strict=True):
        assert centre == pytest.approx(centres[shot.name])
    for name in sorted(centres)[:2]:
        (tmp_path / "in" / "images" / name).unlink()
    with pytest.raises(SceneError, match="3 of 5 placed, fewer than 70%"):
        calibrate(tmp_path / "in", tmp_path / "out")


def transforms(photographed, folder, names, **more):
    """Write the room as nerfstudio would, its world turned by applied_transform."""
    applied = np.array([[1.0, 0, 0, 0.3], [0, 0, 1, 0], [0, -1, 0, -2]])
    whole = np.vstack([applied, [0, 0, 0, 1]])
    camera = photographed.cameras[names[0]]
    frames = []
    (folder / "images").mkdir(parents=True)
    for name in names:
        shutil.copy(photographed.folder / name, folder / "images")
        T = whole @ photographed.cameras[name].T_world_camera @ OPENGL
        frames.append({"file_path": f"./images/{name}", "transform_matrix": T.tolist()})
    value = {
        "camera_model": "OPENCV",
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "w": camera.width,
        "h": camera.height,
        "k1": -0.08,
        "k2": 0.0,
        "applied_transform": applied.tolist(),
        "frames": frames,
        **more,
    }
    (folder / "transforms.json").write_text(json.dumps(value), encoding="utf-8")
    return folder


def distance_to_room(points):
    """Return metres to the nearest plane that a patch of the room lies in."""
    planes = [(2, 0), (1, 1.5), (1, -1.5), (0, -2), (0, 2), (2, 0.35), (2, 0.6)]
    planes += [(0, -0.9), (0, -0.4), (1, -0.2), (1, 0.4), (0, 0.5), (0, 0.9), (1, -0.6)]
    return np.min([np.abs(points[:, axis] - at) for axis, at in planes], axis=0)


def test_nerfstudios_cameras_stay_and_points_are_found_on_the_rooms_walls(photographed, tmp_path):
    names = sorted(photographed.cameras)[4:8]
    folder = transforms(photographed, tmp_path / "in", names)
    options = CalibrateOptions(features=800)
    report = calibrate(folder / "transforms.json", tmp_path / "out", options)
    capture = read_capture(tmp_path / "out")
    assert (report.source, report.mapping, report.placed) == ("nerfstudio", "known", 4)
    for shot in capture.shots:
        true = photographed.cameras[shot.name.removeprefix("images/")].T_world_camera
        assert shot.camera.T_world_camera == pytest.approx(true, abs=1e-6)
    assert len(capture.points) > 100
    assert np.median(distance_to_room(capture.points)) < 0.005


def framed(pose):
    return {"frames": [{"file_path": "a.png", "transform_matrix": pose}]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frames": []}, "names no frames"),
        ({"frames": [{"file_path": 3}]}, "no file_path"),
        ({"fl_x": "wide"}, "fl_x of .* no number"),
        ({"fl_x": float("inf")}, "fl_x of .* no number"),
        ({"fl_x": -300.0}, "cannot be used"),
        ({"applied_transform": [[1, 0], [0, 1]]}, "applied_transform of .* is not a finite matrix"),
        ({"applied_transform": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]}, "not a rotation"),
        ({"camera_model": "EQUIRECTANGULAR"}, "camera_model"),
        ({"camera_model": {"a": 1}}, "camera_model"),
        ({"fl_x": None, "camera_angle_x": 0}, "camera_angle_x of .* is 0, no angle of view"),
        ({"w": 1000}, "its camera 1000 x 180"),
        (framed([[1.0]]), "transform_matrix of a.png"),
        (framed(np.diag([9e14, 1, 1, 1]).tolist()), "pose of a.png in .* not a rotation"),
        (framed([*np.eye(4)[:3].tolist(), [0, 9e14, 0, 1]]), "pose of a.png in .* last row"),
    ],
)
def test_what_is_wrong_with_transforms_json_is_named(photographed, tmp_path, change, words):
    names = sorted(photographed.cameras)[:3]
    folder = transforms(photographed, tmp_path / "in", names, **change)
    with pytest.raises(SceneError, match=words):
        calibrate(folder, tmp_path / "out")


def test_photographs_outside_the_folder_are_never_read(photographed, tmp_path):
    folder = transforms(photographed, tmp_path / "in", sorted(photographed.cameras)[:3])
    path = folder / "transforms.json"
    value = json.loads(path.read_text(encoding="utf-8"))
    for frame, name in zip(value["frames"], ("../a.png", "/etc/passwd", "link.png"), strict=True):
        frame["file_path"] = name
    Image.new("RGB", (320, 180)).save(tmp_path / "a.png")
    (folder / "link.png").symlink_to(tmp_path / "a.png")
    path.write_text(json.dumps(value), encoding="utf-8")
    with pytest.raises(SceneError, match="0 photographs can be read") as error:
        calibrate(folder, tmp_path / "out")
    assert str(error.value).count("it is not in") == 3
