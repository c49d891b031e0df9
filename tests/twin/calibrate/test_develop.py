"""Distortion is removed to a fraction of a pixel, and what a picture lacks is masked."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
import synthetic_room
from films import photograph
from PIL import Image

from nw_base.errors import SceneError
from nw_splat.camera import Camera
from nw_twin.calibrate.develop import Flattening, _developed_mask, develop
from nw_twin.calibrate.solution import Placed, Solution
from nw_twin.capture import read_picture
from nw_twin.lens import Lens


def lens_of(camera, model="SIMPLE_RADIAL", bend=(-0.1,)):
    params = (camera.fx, camera.cx, camera.cy, *bend)
    return Lens(model=model, width=camera.width, height=camera.height, params=params)


def taken(folder, picture, mask=None):
    folder.mkdir(exist_ok=True)
    Image.fromarray(picture).save(folder / "000000.png")
    if mask is not None:
        Image.fromarray(mask).save(folder / "mask.png")
    height, width, _ = picture.shape
    return photograph(
        file="000000.png",
        path=folder / "000000.png",
        mask=None if mask is None else folder / "mask.png",
        width=width,
        height=height,
    )


def developed(tmp_path, picture, camera, lens, *, mask=None, side=1600, points=None, say=None):
    points = np.zeros((0, 3)) if points is None else points
    seen, pose = np.arange(len(points), dtype=np.int32), camera.T_world_camera
    solution = Solution(
        placed=(Placed(name="a.png", lens=lens, T_world_camera=pose, seen=seen),),
        points=points,
        colours=np.zeros(points.shape, np.uint8),
        errors=np.zeros(len(points), np.float32),
    )
    one = taken(tmp_path / "in", picture, mask)
    say = say or (lambda _: None)
    capture = develop([one], solution, tmp_path / "out", side=side, say=say)
    return capture.shots[0], tmp_path / "out"


@pytest.mark.parametrize("side", [1600, 200])
def test_a_bent_picture_becomes_what_a_pinhole_sees(tmp_path, side):
    patches, camera = synthetic_room.room(), synthetic_room.cameras()[2]
    bent = synthetic_room.render(patches, camera, radial=-0.1)
    shot, out = developed(tmp_path, bent, camera, lens_of(camera), side=side)
    wanted = synthetic_room.render(patches, shot.camera, samples=3).mean(axis=2)
    found = read_picture(shot, out).mean(axis=2)
    assert max(shot.camera.width, shot.camera.height) <= side
    for rows in (slice(0, 80), slice(-80, None)):  # Half a pixel off would show at each end.
        for columns in (slice(0, 90), slice(-90, None)):
            a, b = wanted[rows, columns], found[rows, columns]
            window = cv2.createHanningWindow(a.shape[::-1], cv2.CV_64F)
            shift, _ = cv2.phaseCorrelate(a, b, window)
            assert np.abs(shift).max() < 0.08


def test_a_pinholes_picture_stays_as_it_is(tmp_path):
    camera = synthetic_room.cameras()[2]
    picture = np.random.default_rng(0).integers(0, 256, (180, 320, 3), dtype=np.uint8)
    lens = lens_of(camera, "SIMPLE_PINHOLE", ())
    shot, out = developed(tmp_path, picture, camera, lens)
    assert np.array_equal(read_picture(shot, out), picture)
    assert (shot.camera.fx, shot.camera.cx) == (camera.fx, camera.cx)
    assert shot.mask is None


def test_masks_bend_as_their_pictures_do(tmp_path):
    camera = synthetic_room.cameras()[2]
    picture = np.full((180, 320, 3), 255, np.uint8)
    picture[40:90, 60:200] = 0
    mask = picture[..., 0].copy()
    shot, out = developed(tmp_path, picture, camera, lens_of(camera), mask=mask)
    with Image.open(out / shot.mask) as image:
        found = np.asarray(image)
    assert set(np.unique(found)) == {0, 255}
    flat = read_picture(shot, out)[..., 0]
    assert found.shape == flat.shape
    assert ((found == 0) == (flat < 128)).mean() > 0.995


@pytest.mark.parametrize("bend", [-0.15, 0.2])
def test_colmaps_pinhole_shows_nothing_that_the_photograph_does_not(bend):
    lens = Lens(model="SIMPLE_RADIAL", width=100, height=60, params=(90.0, 50.0, 30.0, bend))
    flattening = Flattening.of(lens)
    u, v = flattening.maps
    assert flattening.known is None
    assert -0.5 <= u.min() <= u.max() <= 99.5
    assert -0.5 <= v.min() <= v.max() <= 59.5


def test_what_a_photograph_does_not_show_is_masked(tmp_path):
    lens = Lens(model="SIMPLE_RADIAL", width=100, height=60, params=(90.0, 50.0, 30.0, -0.1))
    known = np.ones(Flattening.of(lens).size[::-1], bool)
    known[:, :7] = False
    flattening = replace(Flattening.of(lens), known=known)
    one = taken(tmp_path / "in", np.zeros((60, 100, 3), np.uint8))
    assert np.array_equal(_developed_mask(one, flattening) == 255, known)


def test_points_outside_the_flat_picture_are_not_seen(tmp_path):
    camera = Camera.from_fovy(width=320, height=180, fovy=0.9, T_world_camera=np.eye(4))
    points = np.array([[0, 0, 2.0], [0, 0, -2.0], [50.0, 0, 2.0], [0, 1.5, 2.0]])
    picture = np.zeros((180, 320, 3), np.uint8)
    shot, _ = developed(tmp_path, picture, camera, lens_of(camera), points=points)
    assert shot.seen.tolist() == [0]


def test_an_earlier_calibrations_pictures_go_and_nothing_else_does(tmp_path):
    pictures = tmp_path / "out" / "pictures"
    pictures.mkdir(parents=True)
    for name in ("000007.png", "holiday.png"):
        Image.new("RGB", (4, 4)).save(pictures / name)
    camera = synthetic_room.cameras()[2]
    picture = np.zeros((180, 320, 3), np.uint8)
    developed(tmp_path, picture, camera, lens_of(camera, "SIMPLE_PINHOLE", ()))
    assert sorted(p.name for p in pictures.iterdir()) == ["000000.png", "holiday.png"]


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("FISH", (1.0,)),
        ("PINHOLE", (1.0, 2.0)),
        ("PINHOLE", (float("nan"), 100.0, 50.0, 30.0)),
        ("PINHOLE", (-100.0, 100.0, 50.0, 30.0)),
        ("SIMPLE_RADIAL", (1e-9, 50.0, 30.0, 0.0)),
    ],
)
def test_numbers_that_make_no_lens_are_refused(model, params):
    with pytest.raises(SceneError, match="cannot be used"):
        Lens(model=model, width=100, height=60, params=params).camera()


def test_a_lens_of_half_the_pictures_sees_the_same():
    lens = Lens(model="OPENCV", width=100, height=60, params=(90, 91, 50, 30, 0.1, 0, 0, 0))
    half = lens.resized(50, 30)
    ray = np.array([0.2, 0.1, 1.0])
    whole = np.asarray(lens.camera().img_from_cam(ray))
    assert np.asarray(half.camera().img_from_cam(ray)) == pytest.approx(whole / 2)


WIDE = {  # What a lens of 640 x 480 shows, and how it bends at 50 degrees to the side.
    "SIMPLE_FISHEYE": (160.0, 320.0, 240.0),
    "OPENCV_FISHEYE": (200.0, 200.0, 320.0, 240.0, 0.02, -0.003, 0.0, 0.0),
    "FOV": (300.0, 300.0, 320.0, 240.0, 0.9),
    "EUCM": (200.0, 200.0, 320.0, 240.0, 0.6, 1.1),
    "THIN_PRISM_FISHEYE": (180.0, 180.0, 320.0, 240.0, *[0.0] * 8),
}


@pytest.mark.parametrize("model", WIDE)
def test_of_a_wide_lens_a_hundred_degrees_are_kept_and_the_share_is_known(model):
    lens = Lens(model=model, width=640, height=480, params=WIDE[model])
    flat = Flattening.of(lens)
    sides = [2 * np.degrees(np.arctan(flat.size[i] / 2 / (flat.fx, flat.fy)[i])) for i in (0, 1)]
    assert 99 < sides[0] <= 100
    assert 70 < sides[1] <= 100
    # Its middle has as many pixels as the photograph's.
    near = np.asarray(lens.camera().img_from_cam(np.array([[0.01, 0, 1], [0, 0, 1.0]])))
    assert flat.fx == pytest.approx((near[0, 0] - near[1, 0]) / 0.01, rel=2e-3)
    row, column = flat.size[1] // 5, flat.size[0] // 6
    ray = np.array([(column + 0.5 - flat.cx) / flat.fx, (row + 0.5 - flat.cy) / flat.fy, 1.0])
    u, v = (m[row, column] + 0.5 for m in flat.maps)
    assert np.asarray(lens.camera().img_from_cam(ray)) == pytest.approx([u, v], abs=0.01)
    # How many of a photograph's pixels are in the flat picture, counted.
    shown = np.zeros((480, 640), np.uint8)
    columns, rows = (np.clip(m, 0, size - 1) for m, size in zip(flat.maps, (640, 480), strict=True))
    shown[np.round(rows).astype(int), np.round(columns).astype(int)] = 1
    shown = cv2.morphologyEx(shown, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    assert flat.used == pytest.approx(shown.mean(), abs=0.02)
    assert flat.used < 0.97


def test_opencvs_fisheye_is_flattened_as_opencv_does(tmp_path):
    camera = synthetic_room.cameras()[2]
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.integers(0, 256, (240, 320, 3), dtype=np.uint8), (0, 0), 3)
    K, bend = np.array([[120.0, 0, 160], [0, 121, 118], [0, 0, 1]]), (0.03, -0.01, 0.002, 0.0)
    lens = Lens(model="OPENCV_FISHEYE", width=320, height=240, params=(120, 121, 160, 118, *bend))
    said = []
    shot, out = developed(tmp_path, picture, camera, lens, side=900, say=said.append)
    flat = shot.camera
    # OpenCV counts the centre of the first pixel as 0.
    K[:2, 2] -= 0.5
    pinhole = np.array([[flat.fx, 0, flat.cx - 0.5], [0, flat.fy, flat.cy - 0.5], [0, 0, 1]])
    maps = cv2.fisheye.initUndistortRectifyMap(
        K, np.array(bend), np.eye(3), pinhole, (flat.width, flat.height), cv2.CV_32FC1
    )
    wanted = cv2.remap(picture, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    found = read_picture(shot, out)
    assert np.abs(found.astype(float) - wanted).mean() < 0.6
    words = (
        "OPENCV_FISHEYE is wide: of its pictures 100 x 100 degrees are kept, 53% of their pixels"
    )
    assert words in said


def test_a_lens_of_a_phone_is_flattened_as_colmap_does():
    lens = Lens(model="SIMPLE_RADIAL", width=640, height=480, params=(400.0, 320.0, 240.0, 0.05))
    flat, camera = Flattening.of(lens), lens.camera()
    theirs = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    assert (flat.size, flat.used) == ((theirs.width, theirs.height), 1.0)
    assert flat.fx == theirs.focal_length_x
