"""COLMAP is asked as meant: masks hide, EXIF's focal length begins, each size has its camera."""

import shutil
import sys

import numpy as np
import pycolmap
import pytest
import synthetic_room
from PIL import Image

from nw_eval.errors import PrerequisiteError
from nw_eval.twin.calibrate import mapping
from nw_eval.twin.calibrate.calibrate import pairs_of
from nw_eval.twin.calibrate.features import match
from nw_eval.twin.calibrate.options import CalibrateOptions
from nw_eval.twin.calibrate.packages import package
from nw_eval.twin.calibrate.photographs import take_in
from nw_eval.twin.calibrate.solution import Lens
from nw_eval.twin.calibrate.sources import find_source

QUICK = CalibrateOptions(features=400)


def silent(_):
    """Say nothing."""


def matched(folder, working, *, lenses=None, options=QUICK):
    working.mkdir()
    source = find_source(folder, working, frames=9, say=silent)
    photographs, _ = take_in(source.files, working, silent)
    lenses = lenses or [None] * len(photographs)
    pairs = pairs_of(len(photographs), in_sequence=False)
    return photographs, match(photographs, lenses, pairs, working, options, silent)


@pytest.fixture
def folder(tmp_path):
    """Two pictures of a wall, one with EXIF and a mask, and a smaller one."""
    folder = tmp_path / "in"
    (folder / "masks").mkdir(parents=True)
    wall = synthetic_room.noise(np.random.default_rng(0), 150, 220).astype(np.uint8)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 50
    Image.fromarray(wall[:, :200]).save(folder / "a.jpg", exif=exif, quality=95)
    Image.fromarray(wall[:, 20:]).save(folder / "b.jpg", quality=95)
    Image.fromarray(wall[:120, :160]).save(folder / "c.png")
    mask = np.full((150, 200), 255, np.uint8)
    mask[:, :100] = 0
    Image.fromarray(mask).save(folder / "masks" / "a.png")
    return folder


def test_features_keep_out_of_masks_and_cameras_are_one_for_each_size(folder, tmp_path):
    photographs, matches = matched(folder, tmp_path / "w")
    opened = pycolmap.Database.open(matches.database)
    try:
        images = {image.name: image for image in opened.read_all_images()}
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        at = opened.read_keypoints(images[photographs[0].file].image_id)
    finally:
        opened.close()
    assert len(at) > 20
    assert at[:, 0].min() > 99
    assert len(cameras) == 3
    begun = [cameras[images[one.file].camera_id] for one in photographs]
    assert [(c.width, c.height) for c in begun] == [(200, 150), (200, 150), (160, 120)]
    assert begun[0].has_prior_focal_length
    assert begun[0].params[0] == pytest.approx(photographs[0].focal)
    assert not begun[1].has_prior_focal_length
    assert matches.pairs == 3
    assert matches.features[photographs[0].file] == len(at)
    pair = (photographs[0].file, photographs[1].file)
    assert max(matches.inliers.get(pair, 0), matches.inliers.get(pair[::-1], 0)) > 15


def test_a_lens_that_is_known_is_entered_as_it_is(folder, tmp_path):
    params = (150.0, 151.0, 100.0, 75.0, 0.01, 0.0, 0.0, 0.0)
    lens = Lens(model="OPENCV", width=200, height=150, params=params)
    small = Lens(model="PINHOLE", width=160, height=120, params=(150.0, 150.0, 80.0, 60.0))
    _, matches = matched(folder, tmp_path / "w", lenses=[lens, lens, small])
    opened = pycolmap.Database.open(matches.database)
    try:
        cameras = opened.read_all_cameras()
    finally:
        opened.close()
    assert [c.model_name for c in cameras] == ["OPENCV", "PINHOLE"]
    assert tuple(cameras[0].params) == params


def test_where_one_by_one_fails_all_at_once_is_tried(photographed, tmp_path, monkeypatch):
    def fail(*_):
        raise RuntimeError("no pair to begin with")

    monkeypatch.setattr(mapping, "_incremental", fail)
    folder = tmp_path / "in"
    folder.mkdir()
    for name in sorted(photographed.cameras)[3:8]:
        shutil.copy(photographed.folder / name, folder)
    photographs, matches = matched(folder, tmp_path / "w", options=CalibrateOptions(features=1000))
    lines = []
    names = {one.file: one.name for one in photographs}
    solution, how, tries = mapping.map_cameras(
        matches, names, tmp_path / "w", seed=0, say=lines.append
    )
    assert (how, tries) == ("global", {"incremental": 0, "global": 5})
    assert set(solution.by_name) == set(names.values())
    assert len(solution.points) > 100
    assert "incremental mapping failed: no pair to begin with" in lines


@pytest.mark.parametrize("name", ["pycolmap", "cv2", "av"])
def test_a_package_that_is_missing_is_named_with_the_remedy(monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(PrerequisiteError, match=rf"needs the package {name}.*nw-eval\[twin\]"):
        package(name)
