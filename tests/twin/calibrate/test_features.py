"""COLMAP is asked as meant: masks hide, EXIF's focal length begins, each size has its camera."""

import shutil
import sqlite3
import sys
from contextlib import closing

import numpy as np
import pycolmap
import pytest
import synthetic_room
from PIL import Image

from nw_base.errors import PrerequisiteError, StoreError
from nw_twin.calibrate import mapping
from nw_twin.calibrate.calibrate import find_source
from nw_twin.calibrate.features import Features, match, nearest
from nw_twin.calibrate.kept import Kept
from nw_twin.calibrate.photographs import take_in
from nw_twin.lens import Lens
from nw_twin.options import CalibrateOptions
from nw_twin.packages import package

QUICK = CalibrateOptions(features=400)


def silent(_):
    """Say nothing."""


def matched(folder, working, *, lenses=None, options=QUICK, kept=None, say=silent):
    working.mkdir()
    source = find_source(folder, working, frames=9, say=silent)
    photographs, _ = take_in(source.files, working, silent)
    lenses = lenses or [None] * len(photographs)
    return photographs, match(photographs, lenses, "exhaustive", working, options, say, kept)


def contents(matches):
    """Return all that mapping reads of a database: features, and what was verified of each pair."""
    opened = pycolmap.Database.open(matches.database)
    try:
        features = [opened.read_keypoints(one.image_id) for one in opened.read_all_images()]
        pairs, geometries = opened.read_two_view_geometries()
    finally:
        opened.close()
    models = [(one.config, one.E, one.F, one.H, one.inlier_matches.tolist()) for one in geometries]
    return repr((list(pairs), models)), [one.tobytes() for one in features]


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
    mapped = mapping.map_cameras(matches, names, tmp_path / "w", seed=0, say=lines.append)
    assert (mapped.how, mapped.tries) == ("global", {"incremental": 0, "global": 5})
    assert set(mapped.solution.by_name) == set(names.values())
    assert len(mapped.solution.points) > 100
    assert "incremental mapping failed: no pair to begin with" in lines


def test_matches_are_those_that_colmap_finds():
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu, options.sift.cpu_brute_force_matcher = False, True
    colmap = pycolmap.FeatureMatcher.create(options, pycolmap.Device.cpu)
    extractor = pycolmap.FeatureExtractor.create(device=pycolmap.Device.cpu)
    wall = synthetic_room.noise(np.random.default_rng(1), 150, 260).astype(np.uint8)
    found = [
        extractor.extract_from_uint8_array(wall[:, a:b].mean(axis=2).astype(np.uint8))
        for a, b in ((0, 200), (30, 260))
    ]
    theirs = colmap.match(*found[0], *found[1])
    ours = nearest(*(each[1].data.astype(np.float32) for each in found))
    assert len(ours) > 50
    assert ours.tolist() == sorted(theirs.tolist())


def test_the_best_two_are_found_in_whatever_block_they_lie():
    rng = np.random.default_rng(0)
    one, other = rng.exponential(size=(331, 128)), rng.exponential(size=(197, 128))
    other[:90] = one[rng.permutation(331)[:90]] + rng.exponential(0.3, (90, 128))
    one, other = (
        np.round(512 * each / np.linalg.norm(each, axis=1, keepdims=True)).astype(np.float32)
        for each in (one, other)
    )
    angles = np.arccos(np.clip((one.astype(int) @ other.T.astype(int)) / 512**2, 0, 1))
    expected = []
    for i, row in enumerate(angles):
        j = int(row.argmin())
        column = angles[:, j]
        clear = [
            line.min() <= 0.7 and line.min() < 0.8 * np.sort(line)[1] for line in (row, column)
        ]
        expected += [[i, j]] if all(clear) and column.argmin() == i else []
    assert len(expected) > 40
    assert nearest(one, other).tolist() == expected


def test_of_two_alike_neither_is_a_match():
    far, near = np.zeros((2, 128), np.float32)
    far[0], near[1] = 512, 512
    assert nearest(np.array([near]), np.array([far, near])).tolist() == [[0, 1]]
    assert nearest(np.array([near]), np.array([near, near])).tolist() == []
    assert nearest(np.array([near, near]), np.array([near])).tolist() == []
    assert nearest(np.zeros((0, 128), np.float32), np.array([near])).shape == (0, 2)


def test_neither_threads_nor_what_was_kept_change_what_is_found(photographed, tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    for name in sorted(photographed.cameras)[:4]:
        shutil.copy(photographed.folder / name, folder)
    found, lines = [], []
    kept = Kept(tmp_path / "kept")
    for place, (threads, keeps) in enumerate(((1, None), (2, kept), (3, kept))):
        options = CalibrateOptions(features=400, threads=threads)
        out, say = tmp_path / str(place), lines.append if place == 2 else silent
        _, matches = matched(folder, out, options=options, kept=keeps, say=say)
        found.append((contents(matches), matches.inliers, matches.features))
    kept.close()
    assert len(found[0][1]) >= 3
    assert found[0] == found[1] == found[2]
    assert lines == [
        "features found: 4 of 4 before, by the calibration that was cut off",
        "pairs compared: 6 of 6 before, by the calibration that was cut off",
    ]


def test_what_was_kept_of_other_options_or_is_damaged_is_found_again(folder, tmp_path):
    kept = Kept(tmp_path / "kept")
    _, whole = matched(folder, tmp_path / "w", kept=kept)
    lines = []
    other = CalibrateOptions(features=300)
    _, fewer = matched(folder, tmp_path / "f", options=other, kept=kept, say=lines.append)
    assert not [line for line in lines if "before" in line]
    assert max(fewer.features.values()) < max(whole.features.values())
    kept.close()
    with closing(sqlite3.connect(tmp_path / "kept")) as opened:
        opened.execute("UPDATE kept SET content = substr(content, 1, length(content) - 3)")
        opened.commit()
    kept = Kept(tmp_path / "kept")
    _, again = matched(folder, tmp_path / "a", kept=kept)
    kept.close()
    assert contents(again) == contents(whole)
    (tmp_path / "kept").write_bytes(b"no database at all" * 99)
    Kept(tmp_path / "kept").close()


def test_larger_features_are_those_that_likeness_goes_by():
    points = np.zeros((900, 4), np.float32)
    points[:, 2] = np.arange(900)
    descriptors = np.repeat(np.arange(900, dtype=np.uint16)[:, None] // 4, 128, axis=1)
    largest = Features(points, descriptors.astype(np.uint8)).largest()
    assert largest[:, 0].tolist() == [n // 4 for n in range(899, 499, -1)]


@pytest.mark.parametrize("name", ["pycolmap", "cv2", "av"])
def test_a_package_that_is_missing_is_named_with_the_remedy(monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(PrerequisiteError, match=rf"needs the package {name}.*nw-eval\[twin\]"):
        package(name)


def test_a_file_whose_table_is_a_view_or_has_other_columns_is_replaced(tmp_path):
    endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i FROM n) SELECT i, i FROM n"
    for number, made in enumerate(
        (f"CREATE VIEW kept(key, content) AS {endless}", "CREATE TABLE kept (key BLOB)")
    ):
        path = tmp_path / f"kept{number}"
        with closing(sqlite3.connect(path)) as forged:
            forged.execute(made)
        kept = Kept(path)
        assert kept.get(b"key") is None
        kept.put(b"key", b"content")
        kept.close()
        assert Kept(path).get(b"key") == b"content"
    (tmp_path / "folder").mkdir()
    with pytest.raises(StoreError, match="folder is a folder; remove it"):
        Kept(tmp_path / "folder")
