"""Photographs of a known room give back its cameras, to a millimetre or so."""

import json
import shutil

import cv2
import numpy as np
import pytest
import synthetic_room
from PIL import Image

from nw_base.errors import SceneError, UsageError
from nw_splat.camera import Camera
from nw_twin.calibrate.calibrate import calibrate
from nw_twin.capture import read_capture, read_picture
from nw_twin.options import CalibrateOptions
from nw_twin.verbs.twin import CalibrateFlags, settings_of

QUICK = CalibrateOptions(features=1200)


def aligned(points, to):
    """Return points moved, turned and scaled (Umeyama) to lie as near as can be to others."""
    a, b = points - points.mean(axis=0), to - to.mean(axis=0)
    u, s, v = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    R, scale = u @ sign @ v, (s * np.diag(sign)).sum() / (a**2).sum()
    return scale, R, scale * a @ R.T + to.mean(axis=0)


@pytest.fixture(scope="module")
def calibrated(photographed, tmp_path_factory):
    out = tmp_path_factory.mktemp("capture")
    lines = []
    report = calibrate(photographed.folder, out, QUICK, lines.append)
    return out, report, lines


def test_cameras_lie_where_they_were_to_a_thousandth_of_their_extent(photographed, calibrated):
    out, report, _ = calibrated
    capture = read_capture(out)
    assert [shot.name for shot in capture.shots] == sorted(photographed.cameras)
    true = [photographed.cameras[shot.name].T_world_camera for shot in capture.shots]
    centres = np.array([T[:3, 3] for T in true])
    scale, R, found = aligned(capture.centres, centres)
    assert np.linalg.norm(found - centres, axis=1).max() < 0.003 * np.ptp(centres, axis=0).max()
    for shot, T in zip(capture.shots, true, strict=True):
        turn = R @ shot.camera.T_world_camera[:3, :3] @ T[:3, :3].T
        assert np.arccos(min(1, (np.trace(turn) - 1) / 2)) < np.radians(0.3)
    focal = next(iter(photographed.cameras.values())).fx
    assert capture.shots[0].camera.fx == pytest.approx(focal, rel=0.005)
    assert report.reprojection_error < 0.3
    assert scale > 0


def test_each_shot_sees_its_points_inside_its_picture(calibrated):
    capture = read_capture(calibrated[0])
    for shot in capture.shots:
        assert len(shot.seen) > 50
        at = capture.points[shot.seen] @ shot.camera.T_camera_world[:3, :3].T
        at = at + shot.camera.T_camera_world[:3, 3]
        assert (at[:, 2] > 0).all()
        u = at[:, 0] / at[:, 2] * shot.camera.fx + shot.camera.cx
        v = at[:, 1] / at[:, 2] * shot.camera.fy + shot.camera.cy
        assert ((u >= 0) & (u <= shot.camera.width)).all()
        assert ((v >= 0) & (v <= shot.camera.height)).all()


def test_pictures_show_what_a_pinhole_in_the_true_place_would(photographed, calibrated):
    capture = read_capture(calibrated[0])
    shot = capture.shots[3]
    c = shot.camera
    true = Camera(
        width=c.width,
        height=c.height,
        fx=c.fx,
        fy=c.fy,
        cx=c.cx,
        cy=c.cy,
        T_world_camera=photographed.cameras[shot.name].T_world_camera,
    )
    wanted = synthetic_room.render(photographed.patches, true).mean(axis=2)
    found = read_picture(shot, calibrated[0]).mean(axis=2)
    shift, _ = cv2.phaseCorrelate(wanted, found, cv2.createHanningWindow(wanted.shape[::-1], 6))
    assert np.abs(shift).max() < 0.25
    assert np.abs(wanted - found)[8:-8, 8:-8].mean() < 6


def test_the_report_says_what_was_done(calibrated):
    out, report, lines = calibrated
    written = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert written["nw-calibration"] == 1
    assert written["placed"] == written["photographs"] == 12
    assert (report.source, report.matching, report.mapping) == (
        "photographs",
        "sequential",
        "incremental",
    )
    assert report.pairs == 66
    assert report.written
    assert report.lenses[0].startswith("SIMPLE_RADIAL 320 x 180: ")
    assert "incremental mapping placed 12 of 12 photographs" in lines
    assert not list(out.glob(".calibrate*"))


@pytest.mark.nightly
def test_of_two_rooms_the_larger_is_taken_and_the_other_is_named(photographed, tmp_path):
    source, other = tmp_path / "in", synthetic_room.room(seed=5)
    source.mkdir()
    for name in sorted(photographed.cameras)[2:10]:
        shutil.copy(photographed.folder / name, source)
    for number, camera in enumerate(synthetic_room.cameras()[4:9], 50):
        picture = synthetic_room.render(other, camera, radial=-0.08)
        Image.fromarray(picture).save(source / f"IMG_{number:04d}.png")
    lines = []
    options = CalibrateOptions(features=1200, share=0.5)
    report = calibrate(source, tmp_path / "out", options, lines.append)
    assert (report.placed, report.groups) == (8, (5,))
    assert {one.name for one in report.left_out} == {
        f"IMG_00{number}.png" for number in range(50, 55)
    }
    assert {one.reason for one in report.left_out} == {"in a group apart from the largest"}
    assert "a group of 5, at most " in report.left_out[0].detail
    assert any(line.startswith("1 other group with 5 of the photographs") for line in lines)
    with pytest.raises(SceneError, match=r"8 of 13 placed, fewer than 70%(.|\n)*--share"):
        calibrate(source, tmp_path / "out", CalibrateOptions(features=1200))


def test_photographs_that_share_nothing_are_named_with_the_reason(photographed, tmp_path):
    source = tmp_path / "in"
    source.mkdir()
    rng = np.random.default_rng(0)
    with Image.open(photographed.folder / "IMG_0000.png") as image:
        first = np.asarray(image)
    Image.fromarray(first).save(source / "a room.png")
    other = synthetic_room.noise(rng, *first.shape[:2]).astype(np.uint8)
    Image.fromarray(cv2.GaussianBlur(other, (0, 0), 5)).save(source / "blurred.png")
    Image.fromarray(np.full_like(first, 200)).save(source / "wall\n.png")
    noise = synthetic_room.noise(rng, 180, 320).astype(np.uint8)
    Image.fromarray(noise).save(source / "elsewhere é.png")
    (source / "cut.png").write_bytes((photographed.folder / "IMG_0001.png").read_bytes()[:2000])
    out = tmp_path / "out"
    with pytest.raises(SceneError, match=r"0 of 5 placed, fewer than 70%") as error:
        calibrate(source, out, CalibrateOptions(features=300))
    text = str(error.value)
    assert "blurred: blurred.png (" in text
    assert "no texture: wall\\n.png (" in text or "no texture: wall .png (" in text
    assert "cannot be read: cut.png (" in text
    assert "too far from the others: a room.png, elsewhere é.png (" in text
    assert "photograph again" in text
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert len(report["left_out"]) == 5
    assert not report["written"]
    assert not (out / "capture.json").exists()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_photographs_are_refused(photographed, tmp_path, count):
    (tmp_path / "in").mkdir()
    for name in sorted(photographed.cameras)[:count]:
        shutil.copy(photographed.folder / name, tmp_path / "in")
    with pytest.raises(SceneError, match=r"nothing in|can be read, of 3 needed"):
        calibrate(tmp_path / "in", tmp_path / "out")


@pytest.mark.parametrize("name", ["nowhere", "words.txt"])
def test_what_is_no_source_is_refused(tmp_path, name):
    (tmp_path / "words.txt").write_text("no pictures", encoding="utf-8")
    with pytest.raises(SceneError, match=f"{name} is"):
        calibrate(tmp_path / name, tmp_path / "out")


@pytest.mark.parametrize(("count", "stays"), [(0, True), (2, False)])
def test_an_earlier_capture_outlives_what_is_refused_and_no_calibration_that_fails(
    photographed, tmp_path, count, stays
):
    out = tmp_path / "out"
    out.mkdir()
    (out / "capture.json").write_text("{}", encoding="utf-8")
    (tmp_path / "in").mkdir()
    for name in sorted(photographed.cameras)[:count]:
        shutil.copy(photographed.folder / name, tmp_path / "in")
    with pytest.raises(SceneError):
        calibrate(tmp_path / "in", out)
    assert (out / "capture.json").exists() is stays


@pytest.mark.parametrize(
    "options",
    [
        *({"frames": 2}, {"side": 0}, {"share": 0}, {"lens": "FISH"}, {"threads": 0}),
        *({"megapixels": 0}, {"megapixels": 999}, {"side": 10_001}),
    ],
)
def test_options_that_make_no_sense_are_refused(options):
    with pytest.raises(UsageError, match=next(iter(options))):
        CalibrateOptions(**options)


def test_each_option_of_calibration_that_a_verb_has_is_asked_for():
    given = {"matching": "retrieval", "frames": 9, "lens": "OPENCV", "share": 0.4}
    given |= {"features": 700, "side": 640, "megapixels": 150}
    given |= {"per_second": 2.0}
    flags = CalibrateFlags(**given)
    assert set(vars(flags)) == set(given)
    assert settings_of(flags, 1).calibrate == CalibrateOptions(**given, threads=1)
