"""Depth and normals of a street whose every distance is known."""

import os
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from street import GROUND, PLAIN, RIM, SKY, seen, walker_seen, write_street

from nw_twin.calibrate.calibrate import calibrate
from nw_twin.capture import read_capture
from nw_twin.options import CalibrateOptions, DepthOptions
from nw_twin.reconstruct.depth import array_file, depth_maps, read_depth, write_map

ROOT = Path(__file__).resolve().parents[3]
ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", ROOT.parent / "shared" / "assets"))
STREET = ASSETS / "photographs" / "street"

OPTIONS = DepthOptions(side=144)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A capture's folder, the capture, the folder of what was matched, and its maps."""
    folder = tmp_path_factory.mktemp("street")
    capture = write_street(folder / "capture")
    maps = depth_maps(capture, folder / "capture", folder, OPTIONS, lambda _: None, threads=2)
    return folder, capture, maps


def known(street, what):
    """Return the share of such pixels whose depth is known, and of those within 2 percent."""
    _, capture, maps = street
    share, right = [], []
    for shot, found in zip(capture.shots, maps, strict=True):
        depth, kind, _, _ = seen(shot.camera)
        asked = kind == what
        some = asked & (found.depth.ravel() > 0)
        share.append(some.sum() / max(asked.sum(), 1))
        right.append(np.abs(found.depth.ravel() / depth - 1.0)[some] < 0.02)
    return float(np.mean(share)), float(np.concatenate(right).mean())


def test_ground_at_a_grazing_angle_has_its_depth_and_its_normal(street):
    share, right = known(street, GROUND)
    assert share > 0.6
    assert right > 0.9
    _, capture, maps = street
    shot, found = capture.shots[2], maps[2]
    depth, kind, normal, _ = seen(shot.camera)
    local = (normal @ shot.camera.T_world_camera[:3, :3]).reshape(found.normal.shape)
    some = (kind == GROUND).reshape(found.depth.shape) & (found.depth > 0)
    some &= depth.reshape(some.shape) > 3.5  # Seen at less than 25 degrees.
    assert some.sum() > 1000
    turn = np.degrees(np.arccos(np.clip((local * found.normal).sum(axis=-1)[some], -1.0, 1.0)))
    assert np.median(turn) < 4.0


def test_some_of_a_plain_wall_lies_between_its_textured_rims(street):
    share, right = known(street, RIM)
    assert share > 0.6
    assert right > 0.9
    share, right = known(street, PLAIN)
    assert share > 0.15
    assert right > 0.75


def test_a_sky_on_which_no_two_pictures_agree_has_no_depth(street):
    _, capture, maps = street
    for shot, found in zip(capture.shots, maps, strict=True):
        sky = (seen(shot.camera)[1] == SKY).reshape(found.depth.shape)
        assert sky.sum() > 1000
        assert (found.depth[sky] > 0).mean() < 0.04  # Along edges of the wall and of the ground.


@pytest.mark.nightly
def test_who_walks_across_leaves_no_depth_behind(tmp_path):
    capture = write_street(tmp_path / "capture", walks=True)
    maps = depth_maps(capture, tmp_path / "capture", tmp_path, OPTIONS, lambda _: None, threads=2)
    shares, ground = [], []
    for number, (shot, found) in enumerate(zip(capture.shots, maps, strict=True)):
        walker = walker_seen(shot.camera, number)[0].reshape(found.depth.shape)
        behind = seen(shot.camera)[0].reshape(found.depth.shape)
        if walker.sum() > 300:
            shares.append((found.depth[walker] > 0) & (found.depth[walker] < 0.9 * behind[walker]))
        others = (seen(shot.camera)[1] == GROUND) & ~walker.ravel()
        ground.append((found.depth.ravel() > 0)[others])
    assert len(shares) >= 3
    assert np.concatenate(shares).mean() < 0.03
    assert np.concatenate(ground).mean() > 0.5


BYTES = """
import sys
from hashlib import sha256
from pathlib import Path
from nw_twin.capture import read_capture
from nw_twin.reconstruct.depth import depth_maps
from nw_twin.options import DepthOptions

folder, out = map(Path, sys.argv[1:3])
options = DepthOptions(side=144, rounds=1)
maps = depth_maps(read_capture(folder), folder, out, options, print, threads=int(sys.argv[3]))
arrays = [a for m in maps for a in (m.depth, m.confidence, m.normal)]
print(sha256(b"".join(a.tobytes() for a in arrays)).hexdigest())
"""


def digest(maps):
    arrays = [array for each in maps for array in (each.depth, each.confidence, each.normal)]
    return sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


@pytest.mark.nightly
def test_threads_and_code_from_the_cache_change_no_bit(tmp_path):
    write_street(tmp_path / "capture", count=3)
    said = []
    for turn, threads in enumerate(("1", "2")):  # The first compiles, the second has it compiled.
        words = [sys.executable, "-c", BYTES, tmp_path / "capture", tmp_path / str(turn), threads]
        environment = os.environ | {"NW_EVAL_CACHE": str(tmp_path / "cache")}
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
        said.append(done.stdout.splitlines()[-1])
        kept = {path.name for path in (tmp_path / "cache").rglob("*spread*.nbc")}
        assert len(kept) == 1
    assert said[0] == said[1]


def test_a_run_that_was_cut_short_goes_on_to_the_same_maps(street, tmp_path):
    folder, capture, _ = street
    options, said = DepthOptions(side=72, rounds=1), []
    maps = depth_maps(capture, folder / "capture", tmp_path / "whole", options, lambda _: None)

    def cut(line):
        said.append(line)
        if len(said) == 7:  # In the second round.
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        depth_maps(capture, folder / "capture", tmp_path / "cut", options, cut, threads=1)
    assert said[4] == "depth of 4.jpg is matched: 5 of 5"
    assert said[6] == "depth of 1.jpg is compared with its neighbours: 2 of 5"
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "cut").rglob("*.npz")}
    assert 7 <= len(before) < 10  # No more was begun.
    again = depth_maps(capture, folder / "capture", tmp_path / "cut", options, lambda _: None)
    assert digest(again) == digest(maps)
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_a_damaged_file_is_computed_again_and_no_other(street):
    folder, capture, maps = street
    files = sorted((folder / "matched").rglob("*.npz"))
    assert len(files) == 3 * 5
    times = {path: path.stat().st_mtime_ns for path in files}
    broken = files[7]
    broken.write_bytes(broken.read_bytes()[:200])  # As when a disk was full.
    again = depth_maps(capture, folder / "capture", folder, OPTIONS, lambda _: None)
    assert digest(again) == digest(maps)
    changed = [path for path in files if path.stat().st_mtime_ns != times[path]]
    assert changed == [broken]


def test_a_map_is_kept_at_the_size_of_its_picture(street, tmp_path):
    folder, capture, _ = street
    (found, *_) = depth_maps(
        capture, folder / "capture", tmp_path, DepthOptions(side=72, rounds=1), lambda _: None
    )
    assert found.depth.shape == (56, 72)
    write_map(capture, found, tmp_path)
    depth, confidence = read_depth(tmp_path / "depth", found.view.name)
    with np.load(array_file(tmp_path / "depth", found.view.name)) as arrays:
        normal = arrays["normal"].astype(np.float64)
    assert normal.shape == (112, 144, 3)
    assert ((depth > 0) == (confidence > 0)).all()
    assert ((depth > 0) == (np.linalg.norm(normal, axis=-1) > 0.5)).all()
    true, kind, _, _ = seen(capture.shots[0].camera)
    some = (kind == GROUND) & (depth.ravel() > 0)
    assert np.median(np.abs(depth.ravel()[some] / true[some] - 1.0)) < 0.01


EYE, ROAD, FAR = 1.5, 2.0, 12.0
"""Of the real street: the camera's height, what is road beside its way, how far; metres."""


def floor_of(capture):
    """Return the plane n . x = offset of the points below the cameras, and units of a metre."""
    up = -np.mean([shot.camera.T_world_camera[:3, 1] for shot in capture.shots], axis=0)
    up /= np.linalg.norm(up)
    away, nearest = cKDTree(capture.centres).query(capture.points)
    below = (capture.points - capture.centres[nearest]) @ up
    low = capture.points[(below < 0) & (away < np.percentile(away, 50))]
    rng, best, most = np.random.default_rng(0), None, 0
    for _ in range(3000):
        a, b, c = low[rng.choice(len(low), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        if normal @ up == 0.0:  # Three points on one line.
            continue
        normal /= np.linalg.norm(normal) * np.sign(normal @ up)
        heights = (capture.centres - a) @ normal
        near = np.abs((low - a) @ normal) < 0.02 * np.median(heights)
        if normal @ up > 0.9 and near.sum() > most:
            best, most = (normal, float(a @ normal)), int(near.sum())
    normal, offset = best
    return normal, offset, float(np.median(capture.centres @ normal - offset)) / EYE


def road_and_sky(capture, maps):
    """Return pixels of the road, of these right ones, of the sky, and of these with a depth."""
    normal, offset, metre = floor_of(capture)
    ahead = capture.centres[-1] - capture.centres[0]
    ahead -= normal * (ahead @ normal)
    ahead /= np.linalg.norm(ahead)
    aside = np.cross(normal, ahead)
    along = capture.centres @ ahead
    roads, right, skies, wrong = 0, 0, 0, 0
    for found in maps:
        view = found.view
        (height, width), T = view.size, np.linalg.inv(view.T_camera_world)
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(view.K).T @ T[:3, :3].T
        down = np.minimum(rays @ normal, -1e-9)
        depth = (offset - T[:3, 3] @ normal) / down
        points = T[:3, 3] + depth[..., None] * rays
        way = np.interp(points @ ahead, along, capture.centres @ aside)
        road = (rays @ normal < -0.01) & (np.abs(points @ aside - way) < ROAD * metre)
        road &= np.linalg.norm(points - T[:3, 3], axis=-1) < FAR * metre
        height_of = (T[:3, 3] + found.depth[..., None] * rays) @ normal - offset
        roads += road.sum()
        right += (road & (found.depth > 0) & (np.abs(height_of) < 0.3 * metre)).sum()
        red, _, blue = np.moveaxis(view.rgb.astype(float), -1, 0)
        sky = (blue > 1.4 * red) & (blue > 110) & (rays @ normal > 0.1)
        skies += sky.sum()
        wrong += (sky & (found.depth > 0)).sum()
    return roads, right, skies, wrong


@pytest.mark.nightly
@pytest.mark.assets
@pytest.mark.skipif(not STREET.is_dir(), reason=f"no photographs at {STREET}")
@pytest.mark.timeout(1800)
def test_the_road_of_a_real_street_has_depth_and_its_sky_has_none(tmp_path):
    calibrate(STREET, tmp_path / "capture", CalibrateOptions(), lambda _: None)
    capture = read_capture(tmp_path / "capture")
    maps = depth_maps(
        capture, tmp_path / "capture", tmp_path, DepthOptions(), lambda _: None, threads=2
    )
    roads, right, skies, wrong = road_and_sky(capture, maps)
    assert roads > 100_000
    assert right / roads >= 0.6
    assert wrong / skies < 0.02  # Where it meets roofs.
