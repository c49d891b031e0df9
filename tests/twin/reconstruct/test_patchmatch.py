"""Depth and normals of a street whose every distance is known."""

import os
import subprocess
import sys
from hashlib import sha256

import numpy as np
import pytest
from street import GROUND, PLAIN, RIM, SKY, seen, walker_seen, write_street

from nw_twin.options import DepthOptions
from nw_twin.reconstruct.depth import array_file, depth_maps, read_depth, write_map

OPTIONS, QUICK = DepthOptions(side=144), DepthOptions(side=72, rounds=1)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A capture's folder, the capture, the folder of what was matched, and its maps."""
    folder = tmp_path_factory.mktemp("street")
    capture = write_street(folder / "capture")
    maps = depth_maps(capture, folder / "capture", folder, OPTIONS, lambda _: None, threads=2)
    return folder, capture, maps


@pytest.fixture(scope="module")
def quick(street, tmp_path_factory):
    """The maps of half as large pictures, in one round."""
    folder, capture, _ = street
    out = tmp_path_factory.mktemp("quick")
    return depth_maps(capture, folder / "capture", out, QUICK, lambda _: None)


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


def digest(maps):
    arrays = [array for each in maps for array in (each.depth, each.confidence, each.normal)]
    return sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def test_a_run_that_was_cut_short_goes_on_to_the_same_maps(street, quick, tmp_path):
    (folder, capture, _), said = street, []

    def cut(line):
        said.append(line)
        if len(said) == 7:  # In the second round.
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        depth_maps(capture, folder / "capture", tmp_path / "cut", QUICK, cut, threads=1)
    assert said[4] == "depth of 4.jpg is matched: 5 of 5"
    assert said[6] == "depth of 1.jpg is compared with its neighbours: 2 of 5"
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "cut").rglob("*.npz")}
    assert 7 <= len(before) < 10  # No more was begun.
    again = depth_maps(capture, folder / "capture", tmp_path / "cut", QUICK, lambda _: None)
    assert digest(again) == digest(quick)
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


def test_a_map_is_kept_at_the_size_of_its_picture(street, quick, tmp_path):
    _, capture, _ = street
    found = quick[0]
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
