"""Captures as people bring them: each gets a sentence that says what to do, and nothing is lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic_room
from films import film
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


def a_video_without_motion(path, pictures):
    noise = np.random.default_rng(0)
    shaken = [pictures[0] + noise.normal(0, 2, pictures[0].shape) for _ in range(40)]
    film(path, [np.clip(each, 0, 255).astype(np.uint8) for each in shaken])


@pytest.mark.parametrize(
    ("bring", "words"),
    [
        pytest.param(
            all_from_one_spot,
            "suggest that the camera turned on one spot",
            marks=pytest.mark.nightly,
        ),
        (raw, "DNG is not read here: export as JPEG"),
        (a_video_without_motion, "walk while you photograph, half a metre from one"),
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
