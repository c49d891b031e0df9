"""Captures as the tools write them: every camera model of pycolmap 4.2.1, several models, names."""

import json
import struct

import numpy as np
import pycolmap
import pytest
from PIL import Image

from nw_base.errors import SceneError
from nw_twin.calibrate.calibrate import find_source
from nw_twin.calibrate.colmap import read_model
from nw_twin.calibrate.develop import Flattening

MODELS = [pycolmap.CameraModelId(number).name for number in range(18)]
# Parameters behind focal lengths and centre that bend a little.
BENT = {
    "SIMPLE_RADIAL": [0.02], "RADIAL": [0.02, -0.01], "OPENCV": [0.02, -0.01, 1e-3, -1e-3],
    "OPENCV_FISHEYE": [0.01, 0.002, 0, 0], "FULL_OPENCV": [0.02, -0.01, 1e-3, 1e-3, 0.01, 0, 0, 0],
    "FOV": [0.3], "SIMPLE_RADIAL_FISHEYE": [0.01], "RADIAL_FISHEYE": [0.01, 0.002],
    "THIN_PRISM_FISHEYE": [0.01, 0.002, 1e-3, 1e-3, 0, 0, 1e-3, 1e-3], "SIMPLE_DIVISION": [-0.02],
    "RAD_TAN_THIN_PRISM_FISHEYE": [0.01, 0, 0, 0, 0, 0, 1e-3, 1e-3, 1e-3, 0, 0, 0],
    "DIVISION": [-0.02], "EUCM": [0.5, 1.0],
}  # fmt: skip


def camera_of(model):
    camera = pycolmap.Camera.create_from_model_name(1, model, 500.0, 640, 480)
    bent = BENT.get(model, [])
    if bent:
        camera.params = [*list(camera.params)[: len(camera.params) - len(bent)], *bent]
    return camera


def write_model(folder, camera, names, kind="bin"):
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for number, name in enumerate(names):
        turn = pycolmap.Rotation3d(np.array([0, 0, np.sin(0.1 * number), np.cos(0.1 * number)]))
        pose = pycolmap.Rigid3d(turn, np.array([0.1 * number, 0, 1.0]))
        image = pycolmap.Image(name=name, camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pose)
    folder.mkdir(parents=True)
    (model.write_binary if kind == "bin" else model.write_text)(str(folder))
    return model


def pictures(folder, names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (64, 48)).save(path)


def found(folder, tmp_path):
    said = []
    footage = find_source(
        folder, tmp_path / "work", frames=3, say=lambda *a: said.append(str(a[0]))
    )
    return footage, said


@pytest.mark.parametrize("kind", ["bin", "txt"])
@pytest.mark.parametrize("model", MODELS[:-1])
def test_every_camera_model_is_read_as_colmap_wrote_it_and_flattened(tmp_path, model, kind):
    camera = camera_of(model)
    written = write_model(tmp_path / "sparse", camera, ["a.jpg", "b.jpg"], kind)
    read = read_model(tmp_path / "sparse")
    lens = read.placed[1].lens
    assert lens.model == model
    assert list(lens.params) == pytest.approx(list(camera.params))
    T = np.vstack([written.images[2].cam_from_world().matrix(), [0, 0, 0, 1]])
    assert np.abs(np.linalg.inv(read.placed[1].T_world_camera) - T).max() < 1e-9
    # A pixel of the flat picture shows what COLMAP sees along its ray.
    flat = Flattening.of(lens)
    row, column = flat.size[1] // 3, flat.size[0] // 3
    ray = [(column + 0.5 - flat.cx) / flat.fx, (row + 0.5 - flat.cy) / flat.fy, 1.0]
    seen = np.asarray(camera.img_from_cam(np.array([ray])))[0]
    place = np.array([column, row]) if flat.maps is None else [m[row, column] for m in flat.maps]
    assert np.asarray(place) + 0.5 == pytest.approx(seen, abs=0.01)


def test_a_panorama_is_refused_by_its_name(tmp_path):
    for kind in ("bin", "txt"):
        write_model(tmp_path / kind, camera_of("EQUIRECTANGULAR"), ["a.jpg"], kind)
        with pytest.raises(SceneError, match="EQUIRECTANGULAR: a panorama is not supported"):
            read_model(tmp_path / kind)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda raw: raw[:12] + struct.pack("<i", 18) + raw[16:], "number 18; undistort it with"),
        (lambda raw: raw[:32] + struct.pack("<d", np.nan) + raw[40:], r"\[nan, 500"),
        (lambda raw: raw[:32] + struct.pack("<d", np.inf) + raw[40:], r"\[inf, 500"),
    ],
)
def test_a_lens_that_is_none_is_refused(tmp_path, change, words):
    write_model(tmp_path / "m", camera_of("OPENCV"), ["a.jpg"])
    path = tmp_path / "m" / "cameras.bin"
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(SceneError, match=words):
        read_model(tmp_path / "m")


def test_a_lens_in_words_with_too_few_numbers_is_refused(tmp_path):
    write_model(tmp_path / "m", camera_of("OPENCV"), ["a.jpg"], "txt")
    path = tmp_path / "m" / "cameras.txt"
    text = path.read_text().rstrip().rpartition(" ")[0]
    path.write_text(text + "\n")
    with pytest.raises(SceneError, match="OPENCV, which has 8 parameters, with 7"):
        read_model(tmp_path / "m")


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_of_several_models_the_one_of_the_most_photographs_is_taken_and_said(tmp_path, kind):
    place, names = tmp_path / "place", [f"{i:02}.jpg" for i in range(12)]
    camera = camera_of("OPENCV")
    for number, some in ((0, names[:3]), (1, names), (10, names[:5])):
        write_model(place / "sparse" / str(number), camera, some, kind)
    pictures(place / "images", names)
    footage, said = found(place, tmp_path)
    assert len(footage.cameras.placed) == 12
    assert any("1 is taken" in line and "0 has 3, 1 has 12, 10 has 5" in line for line in said)
    footage, said = found(place / "sparse", tmp_path)
    assert all(one.path.is_file() for one in footage.files)
    footage, said = found(place / "sparse" / "0", tmp_path)
    assert len(footage.cameras.placed) == 3
    assert said == []


@pytest.mark.parametrize("name", ["{}.jpg", "images/{}.jpg", "images/cam1/{}.jpg", "cam1\\{}.jpg"])
def test_photographs_are_found_whatever_their_names_begin_with(tmp_path, name):
    place, names = tmp_path / "place", [name.format(i) for i in range(3)]
    write_model(place / "sparse" / "0", camera_of("OPENCV"), names)
    files = [one.replace("\\", "/") for one in names]
    pictures(place if name.startswith("images/") else place / "images", files)
    footage, _ = found(place, tmp_path)
    assert [one.name for one in footage.files] == names
    assert all(one.path.is_file() for one in footage.files)


def transforms(folder, *, meta, names=("images/0.jpg", "images/1.jpg"), rows=4, more=()):
    pictures(folder, ["images/0.jpg", "images/1.jpg"])
    frames = []
    for number, name in enumerate((*names, *more)):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * (number % 2)
        frames.append({"file_path": name, "transform_matrix": pose[:rows].tolist()})
    whole = {"fl_x": 50, "fl_y": 50, "cx": 32, "cy": 24, "w": 64, "h": 48, **meta}
    (folder / "transforms.json").write_text(json.dumps({**whole, "frames": frames}))


@pytest.mark.parametrize(
    "variant",
    [
        {},
        {"rows": 3},
        {"names": ("images/0", "images/1")},
        {"names": ("images\\0.jpg", "images\\1.jpg")},
        {"more": ("images/0.jpg", "images/1.jpg")},
        {"meta": {"applied_transform": np.eye(4).tolist()}},
        {"meta": {"k1": None, "camera_model": None}},
    ],
)
def test_variants_of_transforms_json_are_the_same_cameras(tmp_path, variant):
    transforms(tmp_path / "place", **{"meta": {}} | variant)
    footage, _ = found(tmp_path / "place", tmp_path)
    assert all(one.path.is_file() for one in footage.files)
    assert len(footage.files) == 2
    lens = footage.cameras.placed[1].lens
    assert (lens.model, lens.params) == ("PINHOLE", (50, 50, 32, 24))
    assert footage.cameras.placed[1].T_world_camera[:3, 3] == pytest.approx([0.1, 0, 0])


@pytest.mark.parametrize(
    ("meta", "model", "bent"),
    [
        ({"camera_model": "FULL_OPENCV", "k1": 0.1, "k5": 0.2}, "FULL_OPENCV",
         (0.1, 0, 0, 0, 0, 0, 0.2, 0)),
        ({"camera_model": "SIMPLE_RADIAL_FISHEYE", "k1": 0.1}, "OPENCV_FISHEYE", (0.1, 0, 0, 0)),
        ({"camera_model": "OPENCV_FISHEYE", "k4": 0.1}, "OPENCV_FISHEYE", (0, 0, 0, 0.1)),
    ],
)  # fmt: skip
def test_lenses_of_transforms_json_bend_as_they_say(tmp_path, meta, model, bent):
    transforms(tmp_path / "place", meta=meta)
    lens = found(tmp_path / "place", tmp_path)[0].cameras.placed[0].lens
    assert lens.model == model
    assert lens.params[4:] == pytest.approx(bent)


@pytest.mark.parametrize(
    ("angles", "focal"),
    [
        ({"camera_angle_x": 1.0, "camera_angle_y": 0.5}, (32 / np.tan(0.5), 24 / np.tan(0.25))),
        ({"camera_angle_x": 1.0}, (32 / np.tan(0.5),) * 2),  # As Blender writes it.
    ],
)
def test_angles_are_focal_lengths(tmp_path, angles, focal):
    transforms(tmp_path / "place", meta=angles)
    path = tmp_path / "place" / "transforms.json"
    whole = json.loads(path.read_text())
    del whole["fl_x"], whole["fl_y"]
    path.write_text(json.dumps(whole))
    lens = found(tmp_path / "place", tmp_path)[0].cameras.placed[0].lens
    assert lens.params[:2] == pytest.approx(focal)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"meta": {"camera_model": "EQUIRECTANGULAR"}}, "'EQUIRECTANGULAR'; undistort it with"),
        ({"meta": {}, "more": ("images/1.jpg",)}, "images/1.jpg twice, with two poses"),
    ],
)
def test_cameras_that_cannot_be_used_are_refused_by_name(tmp_path, change, words):
    transforms(tmp_path / "place", **change)
    with pytest.raises(SceneError, match=words):
        found(tmp_path / "place", tmp_path)


@pytest.mark.parametrize(
    "named", ["./data/phone/images/{}.jpg", "/home/somebody/place/images/{}.jpg", "../images/{}"]
)
def test_paths_from_another_folder_or_computer_are_found_by_their_ends(tmp_path, named):
    transforms(tmp_path / "place", meta={}, names=[named.format(i) for i in (0, 1)])
    footage, _ = found(tmp_path / "place", tmp_path)
    assert [one.name for one in footage.files] == ["images/0.jpg", "images/1.jpg"]
    assert all(one.path.is_file() for one in footage.files)


def test_blenders_splits_are_read_together_or_one_alone(tmp_path):
    for name, split in (("images/0", "train"), ("images/1", "test")):
        transforms(tmp_path, meta={}, names=(name,))
        (tmp_path / "transforms.json").rename(tmp_path / f"transforms_{split}.json")
    footage, _ = found(tmp_path, tmp_path / "other")
    assert [one.name for one in footage.files] == ["images/0.jpg", "images/1.jpg"]
    assert len(footage.cameras.placed) == 2
    footage, _ = found(tmp_path / "transforms_test.json", tmp_path / "other")
    assert [one.name for one in footage.files] == ["images/1.jpg"]
