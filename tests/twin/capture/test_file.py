"""Captures on disk come back as they went, and what is no capture is named."""

import json
import pickle  # noqa: TID251 - to see it refused.
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from nw_base.errors import NwEvalError, SceneError
from nw_splat.camera import Camera, look_at
from nw_twin.capture import Capture, PlacedShot, read_capture, read_picture, write_capture


def capture_of(shots=2, points=5, seed=0, names=None):
    rng = np.random.default_rng(seed)
    names = names or [f"IMG_{i}.jpg" for i in range(shots)]
    return Capture(
        shots=tuple(
            PlacedShot(
                name=name,
                file=f"pictures/{i:06d}.png",
                mask=f"masks/{i:06d}.png" if i % 2 else None,
                camera=Camera(
                    width=int(rng.integers(8, 300)),
                    height=int(rng.integers(8, 300)),
                    fx=float(rng.uniform(1, 5000)),
                    fy=float(rng.uniform(1, 5000)),
                    cx=float(rng.uniform(-10, 4000)),
                    cy=float(rng.uniform(-10, 4000)),
                    T_world_camera=look_at(rng.normal(size=3) * 9, rng.normal(size=3)),
                ),
                seen=np.flatnonzero(rng.random(points) < 0.5).astype(np.int32),
            )
            for i, name in enumerate(names)
        ),
        points=rng.normal(size=(points, 3)) * 1e3,
        colours=rng.integers(0, 256, (points, 3), dtype=np.uint8),
        errors=rng.random(points, dtype=np.float32),
    )


NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=40)


@settings(max_examples=12, deadline=None)
@given(st.lists(NAMES, max_size=5, unique=True), st.integers(0, 30), st.integers(0, 2**32))
def test_a_capture_comes_back_bit_for_bit(names, points, seed):
    before = capture_of(points=points, seed=seed, names=names or ["one"])
    with tempfile.TemporaryDirectory() as folder:
        write_capture(before, Path(folder))
        after = read_capture(Path(folder))
    for key in ("points", "colours", "errors"):
        assert np.array_equal(getattr(after, key), getattr(before, key))
        assert getattr(after, key).dtype == getattr(before, key).dtype
    for one, other in zip(before.shots, after.shots, strict=True):
        assert (one.name, one.file, one.mask) == (other.name, other.file, other.mask)
        assert np.array_equal(one.seen, other.seen)
        for key in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(one.camera, key) == getattr(other.camera, key)
        assert np.array_equal(one.camera.T_world_camera, other.camera.T_world_camera)


@pytest.fixture
def folder(tmp_path):
    write_capture(capture_of(), tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["capture.json", "points.npz"])
def test_what_is_missing_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(SceneError, match=f"no capture in .*{name} is not there"):
        read_capture(folder)


@pytest.mark.parametrize("name", ["capture.json", "points.npz"])
def test_damage_anywhere_is_an_error_of_ours_or_changes_nothing_that_is_checked(folder, name):
    rng = np.random.default_rng(3)
    whole = (folder / name).read_bytes()
    refused = 0
    for trial in range(60):
        data = bytearray(whole[: rng.integers(0, len(whole))] if trial % 2 else whole)
        for place in rng.integers(0, max(1, len(data)), 4):
            data[place : place + 1] = bytes([rng.integers(0, 256)])
        (folder / name).write_bytes(data)
        try:
            read_capture(folder)
        except NwEvalError:
            refused += 1
    assert refused >= 30  # All that were cut short.


@pytest.mark.parametrize("key", ["file", "mask"])
@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd", "a\\b.png", "", "out/x.png"])
def test_pictures_outside_the_folder_are_refused(folder, key, name, tmp_path_factory):
    (folder / "out").symlink_to(tmp_path_factory.mktemp("elsewhere"))
    value = json.loads((folder / "capture.json").read_text(encoding="utf-8"))
    value["shots"][0][key] = name
    (folder / "capture.json").write_text(json.dumps(value), encoding="utf-8")
    with pytest.raises(SceneError, match="is not a capture"):
        read_capture(folder)


def pose_of(*entries):
    """Rows of a pose that is the identity but for some entries: (row, column, value)."""
    rows = np.eye(4).tolist()
    for row, column, value in entries:
        rows[row][column] = value
    return rows


LENS = {"model": "OPENCV", "width": 100, "height": 80}


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("fx", 1e308, r"shots\.0\.fx: .* \(it is 1e\+308\)"),
        ("fy", 0.0, r"shots\.0\.fy: "),
        ("fx", float("nan"), r"shots\.0\.fx: "),
        ("cx", -1e308, r"shots\.0\.cx: "),
        ("width", 0, "camera width is 0"),
        ("T_world_camera", pose_of((0, 3, 1e308)), r"\(it is 1e\+308\)"),
        ("T_world_camera", pose_of((0, 0, 9e14)), r"\(it is 90*\.0\)"),
        ("T_world_camera", pose_of((0, 0, 3)), "IMG_0.jpg has no rotation"),
        ("T_world_camera", pose_of((0, 0, 9e8), (1, 1, 9e8), (2, 2, 9e8)), "no rotation"),
        ("T_world_camera", pose_of((3, 1, 5)), "the last row of a pose is 0 0 0 1"),
        ("lens", {**LENS, "params": [100, 100, 50, 40, 1e9, 0, 0, 0]}, "a distortion is over 50"),
        ("lens", {**LENS, "params": [-100, 100, 50, 40, 0, 0, 0, 0]}, "its focal length"),
        ("lens", {**LENS, "params": [100, 100, 500, 40, 0, 0, 0, 0]}, "its centre"),
        ("lens", {**LENS, "params": []}, "its numbers make no lens"),
        ("lens", {**LENS, "width": 0, "params": [9, 9, 0, 0, 0, 0, 0, 0]}, "no such pictures"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_camera_that_cannot_be_is_refused_by_file_key_and_value(folder, key, value, words):
    content = json.loads((folder / "capture.json").read_text(encoding="utf-8"))
    content["shots"][0][key] = value
    (folder / "capture.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(SceneError, match=f"capture.json.*{words}") as error:
        read_capture(folder)
    assert "pydantic" not in str(error.value)


class _Bomb:
    def __reduce__(self):
        return Path.touch, (Path(self.path),)


def test_arrays_that_are_pickles_are_refused_and_not_run(folder):
    bomb = _Bomb()
    bomb.path = str(folder / "ran")
    with np.load(folder / "points.npz") as arrays:
        values = dict(arrays)
    values["points"] = np.array([bomb], dtype=object)
    np.savez(folder / "points.npz", **values)
    with pytest.raises(SceneError, match="is not a capture"):
        read_capture(folder)
    (folder / "points.npz").write_bytes(pickle.dumps(bomb))
    with pytest.raises(SceneError, match="is not a capture"):
        read_capture(folder)
    assert not (folder / "ran").exists()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("points", np.zeros((5, 2))),
        ("points", np.full((5, 3), "x")),
        ("points", np.full((5, 3), 1e308)),
        ("colours", np.zeros((4, 3), np.uint8)),
        ("seen", np.array([0, 99], np.int32)),
        ("seen", np.array([0.5, np.nan])),
        ("firsts", np.array([0, 1])),
    ],
)
def test_arrays_that_do_not_fit_are_refused(folder, key, value):
    with np.load(folder / "points.npz") as arrays:
        values = {**arrays, key: value}
    if key == "seen":
        values["firsts"] = np.array([0, len(value), len(value)])
    np.savez(folder / "points.npz", **values)
    with pytest.raises(SceneError):
        read_capture(folder)


def test_a_picture_comes_back_and_one_that_does_not_fit_its_camera_is_refused(folder):
    shot = read_capture(folder).shots[0]
    path = folder / shot.file
    with pytest.raises(SceneError, match="cannot be read"):
        read_picture(shot, folder)
    path.parent.mkdir()
    size = (shot.camera.height, shot.camera.width, 3)
    picture = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    Image.fromarray(picture).save(path)
    assert np.array_equal(read_picture(shot, folder), picture)
    Image.fromarray(picture[:-1]).save(path)
    with pytest.raises(SceneError, match="pixels, its camera"):
        read_picture(shot, folder)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(SceneError):
        read_picture(shot, folder)


def test_a_picture_that_claims_to_be_huge_is_refused(folder):
    shot = read_capture(folder).shots[0]
    (folder / "pictures").mkdir()
    header = b"P6 60000 60000 255\n"
    (folder / shot.file).write_bytes(header)
    with pytest.raises(SceneError):
        read_picture(shot, folder)


def test_a_picture_that_became_a_link_out_of_the_folder_is_refused(folder, tmp_path_factory):
    shot = read_capture(folder).shots[0]
    (folder / "pictures").mkdir()
    secret = tmp_path_factory.mktemp("elsewhere") / "secret.png"
    (folder / shot.file).symlink_to(secret)
    with pytest.raises(SceneError, match="link"):
        read_picture(shot, folder)
