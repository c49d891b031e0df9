"""A capture of a known room becomes depth maps and a mesh of it."""

import json
from dataclasses import replace
from shutil import copytree

import numpy as np
import pytest
from PIL import Image
from room_figures import edge_off, figures, sampled, tread_heights
from small_room import SMALL, STEPS, depth_of_room, write_room

from nw_base.errors import SceneError, UsageError
from nw_twin.capture import read_capture, write_capture
from nw_twin.options import DepthOptions, ReconstructOptions
from nw_twin.reconstruct.depth import array_file, depth_maps
from nw_twin.reconstruct.reconstruct import reconstruct
from nw_twin.reconstruct.surface import read_colour_mesh

PIXEL = 0.022
"""Metres, at the steps."""


def test_depth_is_right_where_confidence_says_that_it_is_known(room, built):
    out, report, _ = built
    off, sure, shares = [], [], []
    for shot in read_capture(room).shots:
        with np.load(array_file(out / "depth", shot.name)) as arrays:
            depth, confidence = arrays["depth"], arrays["confidence"]
            normal = arrays["normal"]
        assert depth.dtype == confidence.dtype == np.float32
        assert normal.dtype == np.float16
        assert ((depth > 0) == (confidence > 0)).all()
        assert confidence.max() <= 1.0
        true = depth_of_room(shot.camera)
        known = (depth > 0) & np.isfinite(true)
        off.append(np.abs(depth / np.where(known, true, 1.0) - 1.0)[known])
        sure.append(confidence[known])
        shares.append((depth > 0).mean())
    off, sure = np.concatenate(off), np.concatenate(sure)
    # Many pixels of so clear pictures have all the confidence that there is.
    kinds = (sure < 0.5, (sure >= 0.5) & (sure < 1.0), sure == 1.0)
    assert min(kind.mean() for kind in kinds) > 0.05
    low, middle, high = (off[kind].mean() for kind in kinds)
    assert low > 4.0 * middle
    assert middle > 1.5 * high
    assert np.median(off) < 0.0004
    # The report counts pixels of what was worked at, files have those of the larger pictures.
    assert np.mean(shares) == pytest.approx(report.coverage, abs=0.002)
    assert report.coverage > 0.45


def test_the_mesh_is_where_the_room_is_and_looks_at_the_cameras(room, built):
    out, report, _ = built
    mesh, capture = read_colour_mesh(out / "mesh.ply"), read_capture(room)
    found = figures(mesh, capture, 0.04)
    assert found.accuracy < 0.001
    assert found.f > 0.75
    assert len(mesh.faces) == report.faces
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    towards = capture.centres.mean(axis=0) - middles
    assert ((towards * mesh.normals).sum(axis=1) > 0).mean() > 0.97


def test_steps_stay_as_high_as_they_are(built):
    out, _, _ = built
    heights = tread_heights(read_colour_mesh(out / "mesh.ply"))
    assert heights == pytest.approx([step[-1] for step in STEPS], abs=PIXEL)


def test_no_edge_is_rounded_by_more_than_pixels_show(built):
    out, _, _ = built
    low, high, known = edge_off(read_colour_mesh(out / "mesh.ply"))
    assert low > -PIXEL
    assert high < 2.5 * PIXEL  # By night, with larger pictures, less than a voxel.
    assert known > 0.8


def test_the_floor_is_flat(built):
    out, report, _ = built
    floor = next(plane for plane in report.planes if plane.normal[2] > 0.9)
    assert floor.normal[2] > 0.9999
    assert floor.offset == pytest.approx(0.0, abs=0.01)
    points = sampled(read_colour_mesh(out / "mesh.ply"), 100_000)
    local = points @ floor.normal - floor.offset
    low = (np.abs(points[:, 2]) < 0.02) & (points[:, 0] < 2.3) & (points[:, 1] < 1.7)
    assert (np.abs(local[low]) < 0.002).mean() > 0.7


def test_a_report_says_what_was_done(built):
    out, report, words = built
    stored = json.loads((out / "report.json").read_text())
    assert stored["shots"] == report.shots == 10
    assert stored["faces"] == report.faces
    assert stored["words"] == report.lines()
    assert report.holes[0].length == max(hole.length for hole in report.holes)
    assert "depth of 09.jpg is matched: 10 of 10" in words
    assert not report.without_depth


@pytest.mark.nightly
def test_one_thread_gives_the_same_bits(room, tmp_path):
    options = replace(SMALL, voxel=0.06, depth=DepthOptions(side=72, neighbours=2, rounds=1))
    for threads in (1, 2):
        reconstruct(room, tmp_path / str(threads), options, lambda _: None, threads=threads)
    out = tmp_path / "2"
    files = [path.relative_to(out) for path in out.rglob("*") if path.is_file()]
    assert len(files) == 2 + 3 * 10
    for file in files:
        assert (tmp_path / "1" / file).read_bytes() == (out / file).read_bytes(), file


def test_shots_that_share_nothing_are_an_error_that_says_so(room, tmp_path):
    copytree(room, tmp_path / "capture")
    whole = read_capture(room)
    alone = tuple(replace(shot, seen=shot.seen[:3]) for shot in whole.shots)
    write_capture(replace(whole, shots=alone), tmp_path / "capture")
    with pytest.raises(SceneError, match="none of 10 shots shares enough points with another"):
        reconstruct(tmp_path / "capture", tmp_path / "mesh", SMALL, lambda _: None)


def test_what_a_mask_hides_is_not_known(room, tmp_path):
    copytree(room, tmp_path / "capture")
    whole = read_capture(room)
    hidden = np.full((126, 224), 255, np.uint8)
    hidden[:, :112] = 0
    Image.fromarray(hidden).save(tmp_path / "capture" / "mask.png")
    shots = tuple(replace(shot, mask="mask.png") for shot in whole.shots[:4])
    capture = replace(whole, shots=shots)
    options = DepthOptions(side=112, rounds=1)
    maps = depth_maps(capture, tmp_path / "capture", tmp_path, options, lambda _: None)
    assert len(maps) == 4
    assert not any(each.depth[:, :56].any() for each in maps)
    assert all(each.depth[:, 56:].any() for each in maps)


def test_options_that_make_no_sense_are_refused(room, tmp_path):
    with pytest.raises(UsageError, match=r"voxel is -0\.1; give more than 0"):
        ReconstructOptions(voxel=-0.1)
    with pytest.raises(UsageError, match="threads is 0; give 1 or more"):
        reconstruct(room, tmp_path, SMALL, lambda _: None, threads=0)
    with pytest.raises(SceneError, match="no capture in"):
        reconstruct(tmp_path, tmp_path, SMALL, lambda _: None)


@pytest.mark.nightly
def test_forty_pictures_give_a_mesh_right_to_ten_millimetres(tmp_path):
    capture = write_room(tmp_path / "capture", 40, 640, 360)
    options = ReconstructOptions(voxel=0.02)
    report = reconstruct(tmp_path / "capture", tmp_path / "mesh", options, lambda _: None)
    mesh = read_colour_mesh(tmp_path / "mesh" / "mesh.ply")
    found = figures(mesh, capture, 0.02, 400_000)
    assert found.accuracy <= 0.010
    assert found.f >= 0.8
    assert tread_heights(mesh) == pytest.approx([step[-1] for step in STEPS], abs=0.006)
    low, high, known = edge_off(mesh)
    assert known > 0.95
    assert low > -0.02
    assert high < 0.02
    assert report.coverage > 0.5
