"""Captures as apps of phones write them: cameras in the right place, in metres, damage named."""

import json
import re
import zipfile

import cv2
import numpy as np
import pycolmap
import pytest
import synthetic_room
from PIL import Image

from nw_base.errors import SceneError
from nw_twin.calibrate import exports
from nw_twin.calibrate.calibrate import calibrate, find_source
from nw_twin.capture import read_capture
from nw_twin.options import CalibrateOptions
from nw_twin.place import moved_capture

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From the room, whose z is up, to ARKit's world, whose y is."""


def put(path, value, size=(320, 180)):
    """Write a picture, JSON or text."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if value is None:
        Image.new("RGB", size, (90, 80, 70)).save(path)
    else:
        text = value if isinstance(value, str) else json.dumps(value)
        path.write_text(text, encoding="utf-8")


def lens_matrix(camera):
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


def scanner_app(folder, cameras):
    """3D Scanner App has a JSON for each frame, and a picture for some."""
    for number, camera in enumerate(cameras):
        pose = Y_UP @ camera.T_world_camera @ OPENGL
        values = {"intrinsics": lens_matrix(camera).ravel().tolist(), "motionQuality": 0.9}
        values |= {"cameraPoseARFrame": pose.ravel().tolist(), "frame_index": number}
        put(folder / f"frame_{number:05d}.json", values)
        if number != 1:
            put(folder / f"frame_{number:05d}.jpg", None)
    for name in ("thumb_00000.jpg", "depth_00000.png", "conf_00000.png", "textured_output.jpg"):
        put(folder / name, None, (64, 48))
    put(folder / "._frame_00000.jpg", "what macOS packs beside")
    put(folder / "info.json", {"numImages": len(cameras)})


def record3d(folder, cameras, *, K=None, **more):
    """Record3D gives poses relative to the first camera; a lens for each frame, or one."""
    first = np.linalg.inv(cameras[0].T_world_camera @ OPENGL)
    poses = []
    for number, camera in enumerate(cameras):
        T = first @ camera.T_world_camera @ OPENGL
        xyzw = pycolmap.Rotation3d(T[:3, :3]).quat
        poses.append([*xyzw.tolist(), *T[:3, 3].tolist()])
        put(folder / "rgbd" / f"{number}.jpg", None)
        put(folder / "rgbd" / f"{number}.depth", "lzfse")
    one = cameras[0]
    K = lens_matrix(one).T.ravel().tolist() if K is None else K
    put(folder / "metadata", {"w": one.width, "h": one.height, "K": K, "poses": poses, **more})
    return first


def arkit_scenes(folder, cameras):
    """ARKitScenes names pictures by their time; poses are of the world in the camera."""
    lines = []
    for number, camera in enumerate(cameras):
        T = np.linalg.inv(camera.T_world_camera)
        turn = cv2.Rodrigues(T[:3, :3])[0].ravel()
        time = 1234.5 + 0.1 * number
        lines.append(" ".join(f"{v:.9f}" for v in (time, *turn, *T[:3, 3])))
        # Pictures come six times as often as poses.
        for late in (0.002, 0.05):
            name = f"41069021_{time + late:.3f}"
            put(folder / "vga_wide" / f"{name}.png", None)
            lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
            put(folder / "vga_wide_intrinsics" / f"{name}.pincam", " ".join(map(str, lens)))
    put(folder / "lowres_wide.traj", "\n".join(lines) + "\n")


def polycam(folder, cameras, kinds=("corrected_", ""), size=(320, 180)):
    for kind in kinds:
        for number, camera in enumerate(cameras):
            T = Y_UP @ camera.T_world_camera @ OPENGL
            values = {f"t_{r}{c}": T[r, c] for r in range(3) for c in range(4)}
            values |= {key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy")}
            # Poses that are not corrected are some way off.
            values |= {"width": 320, "height": 180, "t_03": T[0, 3] + (0.2 if not kind else 0)}
            put(folder / "keyframes" / f"{kind}cameras" / f"10{number}.json", values)
            put(folder / "keyframes" / f"{kind}images" / f"10{number}.jpg", None, size)
            put(folder / "keyframes" / "depth" / f"10{number}.png", None, (64, 48))
    put(folder / "mesh_info.json", {"alignmentTransform": np.eye(4).ravel().tolist()})
    put(folder / "thumbnail.jpg", None, (64, 48))


def found(folder, tmp_path, frames=50):
    said = []
    return find_source(folder, tmp_path / "work", frames=frames, say=said.append), said


def check(source, cameras, T):
    """Compare with the truth in the export's world, which T maps the room to."""
    assert [one.name for one in source.files if one.path is None] == []
    assert len(source.cameras.placed) == len(cameras)
    for one, camera in zip(source.cameras.placed, cameras, strict=True):
        assert one.T_world_camera == pytest.approx(T @ camera.T_world_camera, abs=1e-6)
        assert one.lens.params == pytest.approx((camera.fx, camera.fy, camera.cx, camera.cy))
        assert (one.lens.model, one.lens.width, one.lens.height) == ("PINHOLE", 320, 180)


@pytest.fixture
def cameras():
    return synthetic_room.cameras(4)


def test_3d_scanner_apps_frames_are_read_and_its_other_pictures_are_not(tmp_path, cameras):
    scanner_app(tmp_path / "in", cameras)
    source, _ = found(tmp_path / "in", tmp_path)
    check(source, [cameras[i] for i in (0, 2, 3)], Y_UP)
    assert (source.kind, source.metric, source.up) == ("arkit", True, (0.0, 1.0, 0.0))


def row_major(cameras):
    return lens_matrix(cameras[0]).ravel().tolist()


@pytest.mark.parametrize("variant", ["one lens", "rows", "a lens each", "EXR + JPG"])
def test_record3ds_frames_are_in_metres_and_relative_to_the_first(tmp_path, cameras, variant):
    lenses = [[c.fx, c.fy, c.cx, c.cy] for c in cameras]
    more = {"rows": {"K": row_major(cameras)}}.get(variant, {})
    if variant == "a lens each":
        more = {"K": [9.0, 0, 0, 0, 9, 0, 5, 5, 1], "perFrameIntrinsicCoeffs": lenses}
    first = record3d(tmp_path / "in", cameras, **more)
    if variant == "EXR + JPG":
        (tmp_path / "in" / "rgbd").rename(tmp_path / "in" / "rgb")
        (tmp_path / "in" / "metadata").rename(tmp_path / "in" / "metadata.json")
    source, _ = found(tmp_path / "in", tmp_path)
    check(source, cameras, first)
    # Which way is up went with the first pose.
    assert (source.kind, source.metric, source.up) == ("record3d", True, None)
    assert source.is_film


def test_of_a_film_with_cameras_frames_are_taken_some_way_apart(tmp_path):
    walk = synthetic_room.cameras(40)
    record3d(tmp_path / "in", [*[walk[0]] * 30, *walk])
    source, said = found(tmp_path / "in", tmp_path, frames=12)
    numbers = [int(one.name.partition(".")[0]) for one in source.files]
    assert len(numbers) == len(source.cameras.placed) == 12
    assert len([n for n in numbers if n < 30]) <= 2
    assert np.diff(numbers[1:]).max() <= 8
    assert any("12 of 70 frames are taken" in line for line in said)


def test_arkit_scenes_pictures_have_the_pose_of_their_time(tmp_path, cameras):
    arkit_scenes(tmp_path / "in", cameras)
    source, said = found(tmp_path / "in", tmp_path)
    check(source, cameras, np.eye(4))
    assert (source.kind, source.metric, source.up) == ("arkit", True, (0.0, 0.0, 1.0))
    assert any("4 of 8 pictures have no pose of their time" in line for line in said)


@pytest.mark.parametrize("kinds", [("corrected_", ""), ("",)])
def test_polycams_corrected_cameras_come_first(tmp_path, cameras, kinds):
    polycam(tmp_path / "in", cameras, kinds)
    (tmp_path / "in" / "keyframes" / "corrected_images").mkdir(exist_ok=True)  # Empty, or not.
    source, _ = found(tmp_path / "in", tmp_path)
    T = Y_UP.copy()
    T[0, 3] = 0 if "corrected_" in kinds else 0.2
    check(source, cameras, T)
    assert (source.kind, source.metric, source.up) == ("polycam", True, (0.0, 1.0, 0.0))
    masks = {one.mask for one in source.files}
    if kinds == ("",):
        assert masks == {None}
        return
    with Image.open(masks.pop()) as image:  # What undistorting left black is masked.
        mask = np.asarray(image)
    assert mask.shape == (180, 320)
    assert (mask[4:-4, 4:-4] == 255).all()
    assert not mask[:4].any()
    assert not mask[:, -4:].any()


def test_a_capture_of_an_app_says_that_it_is_in_metres_and_which_way_is_up(photographed, tmp_path):
    names = sorted(photographed.cameras)[4:8]
    cameras = [photographed.cameras[name] for name in names]
    scanner_app(tmp_path / "in", [*cameras[:1], cameras[0], *cameras[1:]])
    for place, name in zip((0, 2, 3, 4), names, strict=True):
        with Image.open(photographed.folder / name) as picture:
            picture.save(tmp_path / "in" / f"frame_{place:05d}.jpg", quality=95)
    report = calibrate(tmp_path / "in", tmp_path / "out", CalibrateOptions(features=600))
    capture = read_capture(tmp_path / "out")
    assert (report.source, report.placed, report.mapping) == ("arkit", 4, "known")
    assert (capture.metric, capture.up) == (True, (0.0, 1.0, 0.0))
    centres = [(Y_UP @ camera.T_world_camera)[:3, 3] for camera in cameras]
    assert capture.centres == pytest.approx(np.array(centres), abs=1e-6)
    assert np.quantile(np.abs(capture.points[:, 1]), 0.5) < 2.0  # Heights of the room.
    moved = moved_capture(np.linalg.inv(Y_UP), capture)
    assert (moved.metric, moved.up) == (True, (0.0, 0.0, 1.0))


def change(path, **values):
    put(path, json.loads(path.read_text(encoding="utf-8")) | values)


def turned(T):
    return np.array(T, dtype=float).ravel().tolist()


@pytest.mark.parametrize(
    ("write", "file", "values", "words"),
    [
        (scanner_app, "frame_00002.json", {"intrinsics": [1, 2]}, "intrinsics of .*00002.json"),
        (scanner_app, "frame_00002.json", {"intrinsics": turned(np.eye(3))}, "its centre at"),
        (scanner_app, "frame_00002.json", {"cameraPoseARFrame": None}, "cameraPoseARFrame of"),
        (scanner_app, "frame_00002.json", {"cameraPoseARFrame": turned(np.diag([2, 2, 2, 1]))},
         "00002.json is not a rotation"),
        (scanner_app, "frame_00002.json",
         {"cameraPoseARFrame": turned(np.diag([1, 1, -1, 1]))}, "it mirrors"),
        (scanner_app, "frame_00002.json",
         {"cameraPoseARFrame": turned(np.eye(4) * np.nan)}, "not 16 finite numbers"),
        (scanner_app, "frame_00002.json",
         {"cameraPoseARFrame": turned(np.full((4, 4), 9e14))}, "00002.json is not a rotation"),
        (scanner_app, "frame_00002.json",
         {"cameraPoseARFrame": turned(np.diag([1, 1, 1, 9e14]))}, "00002.json has the last row"),
        (polycam, "keyframes/corrected_cameras/101.json", {"t_03": 9e14}, "101.json is at .9"),
        (polycam, "keyframes/corrected_cameras/101.json", {"fx": -9.0}, "101.json: .*focal length"),
        (polycam, "keyframes/corrected_cameras/101.json", {"t_11": float("nan")}, "t_11 of .*101"),
        (polycam, "keyframes/corrected_cameras/101.json", {"fx": "wide"}, "fx of .*101.json"),
        (record3d, "metadata", {"K": [1.0] * 8}, "K of .*metadata is not 9 finite numbers"),
        (record3d, "metadata", {"w": None}, "w of .*metadata"),
        (record3d, "metadata", {"poses": [[0, 0, 0, 0, 1, 2, 3]] * 4}, "pose of 0.jpg .* length 0"),
        (record3d, "metadata", {"poses": [[0, 0, 0, 1, 1, 2, 3]] * 4}, "all poses in .* the same"),
        (record3d, "metadata", {"poses": ["left"] * 4}, "pose of 0.jpg .* 7 finite numbers"),
        (arkit_scenes, "lowres_wide.traj", "1 2 3\n", "lowres_wide.traj is not rows of 7"),
        (arkit_scenes, "lowres_wide.traj", "1 2 3 4 nan 6 7\n", "lowres_wide.traj is not rows"),
        (arkit_scenes, "lowres_wide.traj", "1 1e308 1e308 4 5 6 7\n", "traj is not rows"),
        (arkit_scenes, "lowres_wide.traj", "1234.5 9e14 0 0 0 0 0\n", "is turned by 9e.14 rad"),
        (record3d, "metadata", {"K": [-9e14, 0, 0, 0, 300, 0, 160, 90, 1]}, "metadata: .*focal"),
        (arkit_scenes, "lowres_wide.traj", "1 0 0 0 0 0 0\n", "no picture in .* of its time"),
        (arkit_scenes, "vga_wide_intrinsics/41069021_1234.602.pincam", "1 1 1 1 1 1\n2 2 2 2 2 2",
         "1234.602.pincam has 2 rows, and is of one lens"),
        (arkit_scenes, "vga_wide_intrinsics/41069021_1234.602.pincam", "320 180 wide",
         "1234.602.pincam is not rows of 6"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("error")
def test_what_is_wrong_with_an_export_is_named(tmp_path, cameras, write, file, values, words):
    write(tmp_path / "in", cameras)
    if isinstance(values, str):
        put(tmp_path / "in" / file, values)
    else:
        change(tmp_path / "in" / file, **values)
    with pytest.raises(SceneError, match=words):
        found(tmp_path / "in", tmp_path)


def test_an_export_that_is_still_packed_is_named(tmp_path):
    with zipfile.ZipFile(tmp_path / "walk.r3d", "w") as archive:
        archive.writestr("metadata", "{}")
    with pytest.raises(SceneError, match=r"walk\.r3d is a zip archive.*unpack it"):
        found(tmp_path / "walk.r3d", tmp_path)


def test_other_folders_with_such_names_are_what_they_were(tmp_path):
    put(tmp_path / "in" / "IMG_1.jpg", None)
    put(tmp_path / "in" / "metadata.json", [1, 2])
    put(tmp_path / "in" / "cameras" / "notes.txt", "none")
    put(tmp_path / "in" / "images" / "IMG_2.jpg", None)
    source, _ = found(tmp_path / "in", tmp_path)
    assert (source.kind, source.metric, source.up) == ("photographs", False, None)


def nerfstudio(folder, cameras):
    frames = []
    for number, camera in enumerate(cameras):
        put(folder / "images" / f"{number}.jpg", None)
        pose = (camera.T_world_camera @ OPENGL).tolist()
        frames.append({"file_path": f"images/{number}.jpg", "transform_matrix": pose})
    one = cameras[0]
    lens = {"w": 320, "h": 180, "fl_x": one.fx, "fl_y": one.fy, "cx": one.cx, "cy": one.cy}
    put(folder / "transforms.json", {**lens, "frames": frames})


@pytest.mark.parametrize(
    ("write", "file", "kind"),
    [
        (nerfstudio, "transforms.json", "nerfstudio"),
        (polycam, "keyframes/corrected_cameras/101.json", "polycam"),
        (scanner_app, "frame_00002.json", "scanner"),
        (record3d, "metadata", "record3d"),
    ],
)
def test_each_field_of_an_export_is_used_or_harmless_or_noted_by_name(
    tmp_path, cameras, write, file, kind
):
    write(tmp_path / "in", cameras)
    clear, _ = found(tmp_path / "in", tmp_path)
    assert clear.notes == ()
    used = set(exports._FIELDS[kind].split())
    harmless = {name for names in exports._PASSED.values() for name in names.split()}
    assert not used & harmless
    # What is known to be harmless changes nothing, whatever it says.
    change(tmp_path / "in" / file, **dict.fromkeys(harmless, "mark"))
    same, _ = found(tmp_path / "in", tmp_path / "same")
    assert same.notes == ()
    assert [one.T_world_camera.tolist() for one in same.cameras.placed] == [
        one.T_world_camera.tolist() for one in clear.cameras.placed
    ]
    change(tmp_path / "in" / file, rolling_shutter=0.03, crop=[1, 2])
    (note,) = found(tmp_path / "in", tmp_path / "other")[0].notes
    assert note.startswith("nothing is made of these fields of ")
    assert note.endswith(": crop, rolling_shutter")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            {"camera_angle_x": 0.3},
            "json has fl_x .*, and by camera_angle_x 1058.*fl_x is",
        ),
        (
            {"is_fisheye": True, "p1": 0.1, "k5": 1e-3},
            "nothing is made of k5, p1 of transforms",
        ),
    ],
)
def test_what_transforms_json_says_twice_or_of_another_lens_is_noted(
    tmp_path, cameras, values, words
):
    nerfstudio(tmp_path / "in", cameras)
    change(tmp_path / "in" / "transforms.json", **values)
    (note,) = found(tmp_path / "in", tmp_path)[0].notes
    assert re.search(words, note), note
