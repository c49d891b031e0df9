"""Captures as people bring them: each gets a sentence that says what to do, and nothing is lost."""

from __future__ import annotations

import shutil
from dataclasses import replace

import av
import cv2
import numpy as np
import pytest
import synthetic_room
from PIL import Image

from nw_eval import cli
from nw_splat.camera import Camera, look_at
from nw_twin.align.align import align
from nw_twin.align.alignment import AlignOptions
from nw_twin.calibrate.calibrate import calibrate
from nw_twin.capture import read_capture
from nw_twin.options import CalibrateOptions


@pytest.fixture(scope="module")
def pictures(photographed):
    """Twelve pictures of the room."""
    found = []
    for name in sorted(photographed.cameras):
        with Image.open(photographed.folder / name) as picture:
            found.append(np.asarray(picture))
    return found


def save(folder, pictures, suffix="jpg", **options):
    folder.mkdir()
    for number, picture in enumerate(pictures):
        Image.fromarray(picture).save(folder / f"IMG_{number:04d}.{suffix}", quality=92, **options)


def two_photographs(path, pictures):
    save(path, pictures[:2])


def all_blurred(path, pictures):
    save(path, [cv2.GaussianBlur(picture, (0, 0), 6) for picture in pictures])


def all_from_one_spot(path, _):
    spot, patches = np.array([0.0, -1.2, 1.2]), synthetic_room.room()
    path.mkdir()
    for number, turn in enumerate(np.linspace(-0.9, 0.9, 9)):
        T = look_at(spot, spot + np.array([np.sin(turn), np.cos(turn), -0.5]))
        camera = Camera.from_fovy(width=320, height=180, fovy=0.85, T_world_camera=T)
        Image.fromarray(synthetic_room.render(patches, camera)).save(path / f"{number}.png")


def raw(path, _):
    path.mkdir()
    for number in range(12):
        (path / f"IMG_{number:04d}.DNG").write_bytes(b"II*\0" + bytes(2000))


def more_than_100_megapixels(path, _):
    save(path, [np.zeros((9000, 12000), bool)], suffix="png")
    for number in (1, 2, 3):
        shutil.copy(path / "IMG_0000.png", path / f"IMG_{number:04d}.png")


def a_video_without_motion(path, pictures):
    noise = np.random.default_rng(0)
    with av.open(str(path), "w") as film:
        stream = film.add_stream("mpeg4", rate=15)
        stream.width, stream.height, stream.pix_fmt = 320, 180, "yuv420p"
        for _ in range(40):
            shaken = pictures[0] + noise.normal(0, 2, pictures[0].shape)
            frame = av.VideoFrame.from_ndarray(
                np.clip(shaken, 0, 255).astype(np.uint8), format="rgb24"
            )
            film.mux(stream.encode(frame))
        film.mux(stream.encode())


def a_folder_of_something_else(path, _):
    path.mkdir()
    for name in ("report.pdf", "notes.txt", "data.csv"):
        (path / name).write_text("no picture")


@pytest.mark.parametrize(
    ("bring", "words"),
    [
        (two_photographs, "2 photographs can be read, of 3 needed; give twenty or more"),
        pytest.param(
            all_from_one_spot,
            "suggest that the camera turned on one spot",
            marks=pytest.mark.nightly,
        ),
        (raw, "DNG is not read here: export as JPEG"),
        (more_than_100_megapixels, "108 million pixels, of 100 million at most: make it smaller"),
        (a_video_without_motion, "walk while you photograph, half a metre from one"),
        (a_folder_of_something_else, "is a photograph; give a folder of photographs, a video, or"),
        pytest.param(all_blurred, "none of its edges is sharp", marks=pytest.mark.nightly),
    ],
)
def test_what_cannot_become_a_place_is_answered_with_what_to_do(
    bring, words, pictures, tmp_path, capfd
):
    brought = tmp_path / ("film.mp4" if bring is a_video_without_motion else "folder")
    bring(brought, pictures)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SystemExit) as left:
        cli.main(["twin", "calibrate", str(brought), "--out", str(tmp_path / "scene")])
    errors = capfd.readouterr().err
    assert left.value.code == 2
    assert words in errors
    assert errors.startswith("error: ")  # Nothing of COLMAP's own comes before it.
    assert "Traceback" not in errors
    assert len(errors) < 1500
    assert set(before) <= set(tmp_path.rglob("*"))


def test_some_that_cannot_be_read_are_named_and_the_rest_become_a_capture(pictures, tmp_path):
    save(tmp_path / "in", pictures[2:10])
    whole = (tmp_path / "in" / "IMG_0000.jpg").read_bytes()
    for number in (20, 21, 22):
        (tmp_path / "in" / f"IMG_{number:04d}.jpg").write_bytes(whole[:3000])
    lines = []
    options = CalibrateOptions(features=500)
    report = calibrate(tmp_path / "in", tmp_path / "out", options, lines.append)
    assert (report.placed, report.photographs) == (8, 11)
    assert "left out, cannot be read: IMG_0020.jpg, IMG_0021.jpg, IMG_0022.jpg (" in lines[-1]


@pytest.mark.nightly
def test_a_wrong_focal_length_in_exif_changes_nothing(pictures, tmp_path):
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "Odd", "Phone"
    exif.get_ifd(0x8769).update({0x920A: 400.0, 0xA405: 400})  # A telescope's, of a phone.
    save(tmp_path / "wrong", pictures, exif=exif.tobytes())
    save(tmp_path / "none", pictures)
    lines, captures = [], []
    for name in ("wrong", "none"):
        calibrate(tmp_path / name, tmp_path / f"{name}-out", CalibrateOptions(), lines.append)
        captures.append(read_capture(tmp_path / f"{name}-out"))
    assert sum("once more without them" in line for line in lines) == 1
    np.testing.assert_array_equal(captures[0].centres, captures[1].centres)


@pytest.mark.nightly
def test_over_a_floor_that_mirrors_the_cameras_height_gives_no_scale(tmp_path):
    without_floor = synthetic_room.room()[1:]
    flip = np.array([1.0, 1.0, -1.0])
    below = [
        replace(one, corner=one.corner * flip, along=one.along * flip, down=one.down * flip)
        for one in without_floor
    ]
    shown = [synthetic_room.render(without_floor + below, one) for one in synthetic_room.cameras()]
    save(tmp_path / "in", shown)
    calibrate(tmp_path / "in", tmp_path / "out", CalibrateOptions())
    alignment = align(
        read_capture(tmp_path / "out"), tmp_path / "out", options=AlignOptions(camera_height=1.2)
    )
    assert not alignment.is_to_scale
    assert any("no level floor was found" in line for line in alignment.warnings)
