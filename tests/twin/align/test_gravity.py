"""Up is found in rooms, whatever else is large and flat in them, and however phones are held."""

import re

import cv2
import numpy as np
import pytest
from known_truth import drawn
from rooms import (
    about_z,
    capture,
    degrees_off,
    floor_off,
    room,
    scale_off,
    similarity,
    straight,
    walk,
)
from twin_parts import grid

from nw_base.errors import SceneError
from nw_twin.align.align import align
from nw_twin.align.alignment import AlignOptions

METRIC = AlignOptions(camera_height=1.5)


def aligned(points, poses, T, **options):
    return align(capture(points, poses, T), None, **{"options": METRIC, **options})


@pytest.mark.parametrize("way", [walk, straight])
@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"floor": 300, "ceiling": 1200},
        {"floor": 400, "ramp": 1200},
        {"floor": 400, "ramp": 1200, "slope": 8.0},
        {"floor": 400, "table": 800},
        {"walls": 0},
    ],
    ids=["room", "ceiling", "ramp", "shallow ramp", "table", "no walls"],
)
def test_up_is_within_a_third_of_a_degree_and_the_floor_within_a_centimetre(parts, way):
    rng = np.random.default_rng(5)
    points, poses, T = room(rng, **parts), way(rng), similarity(rng)
    alignment = aligned(points, poses, T)
    assert degrees_off(alignment, T) < 0.3
    assert abs(floor_off(alignment, T)) < 0.01


def test_a_place_that_is_one_ramp_is_not_levelled():
    rng = np.random.default_rng(2)
    points, T = room(rng, floor=0, ramp=1500, walls=300), similarity(rng)
    poses = walk(rng)
    alignment = aligned(points, poses, T, options=AlignOptions(metric=True))
    assert degrees_off(alignment, T) < 1.5  # By cameras and walls; the ramp has 14 degrees.
    assert any("no level plane" in warning for warning in alignment.warnings)
    unscaled = aligned(points, poses, T, options=AlignOptions(camera_height=1.5))
    assert not unscaled.is_to_scale
    assert any("no level floor was found, so that" in line for line in unscaled.warnings)


def test_phones_on_their_sides_are_told_from_phones_held_upright():
    rng = np.random.default_rng(3)
    poses = walk(rng, pitch=10.0)
    poses[:, :3, :3] = poses[:, :3, :3] @ about_z(np.pi / 2)
    T = similarity(rng)
    alignment = aligned(room(rng), poses, T)
    assert degrees_off(alignment, T) < 0.3
    assert any("on their sides" in warning for warning in alignment.warnings)


def test_some_rolled_photographs_do_not_matter():
    rng = np.random.default_rng(4)
    poses = walk(rng)
    poses[::4, :3, :3] = poses[::4, :3, :3] @ about_z(np.pi / 2)
    T = similarity(rng)
    alignment = aligned(room(rng, floor=0, walls=0, stray=400), poses, T)
    assert alignment.gravity[0].name == "horizon"
    assert degrees_off(alignment, T) < 3.0


def test_a_source_that_knows_up_decides_where_cameras_do_not():
    rng = np.random.default_rng(6)
    points, poses = room(rng, floor=0, ramp=1500, walls=0), straight(rng)
    unsure = aligned(points, poses, np.eye(4))
    sure = aligned(points, poses, np.eye(4), options=AlignOptions(metric=True, up="+z"))
    assert degrees_off(sure, np.eye(4)) < 0.2 < degrees_off(unsure, np.eye(4))


def test_a_source_that_says_another_way_is_up_is_warned_of():
    rng = np.random.default_rng(7)
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.radians([4.0, 0.0, 0.0]))[0]
    options = AlignOptions(metric=True, up="+z")
    alignment = aligned(room(rng), walk(rng), T, options=options)
    said = [re.search(r"up by poses is ([\d.]+)", warning) for warning in alignment.warnings]
    assert [float(found[1]) for found in said if found] == [pytest.approx(4.0, abs=0.5)]
    assert degrees_off(alignment, T) < 1.0


def test_a_mesh_makes_the_floor_exact_where_points_are_few():
    rng = np.random.default_rng(8)
    T = similarity(rng)
    points = room(rng, floor=60, walls=40, stray=30) + rng.normal(0, 0.02, (170, 3))
    vertices, faces = grid((0, 0, 0), (6, 0, 0), (0, 5, 0), (19, 19))
    vertices[:, 2] = rng.normal(0, 0.005, 400)
    mesh = (vertices @ T[:3, :3].T + T[:3, 3], faces)
    alignment = aligned(points, walk(rng), T, mesh=mesh)
    assert degrees_off(alignment, T) < 0.1
    assert abs(floor_off(alignment, T)) < 0.005
    assert "mesh" in [cue.name for cue in alignment.gravity]


@pytest.mark.parametrize("slope", [0.0, 3.0])
def test_upright_edges_tell_a_floor_that_slopes_from_one_that_is_level(tmp_path, slope):
    rng = np.random.default_rng(12)
    T, poses, angle = similarity(rng), straight(rng, 12), np.radians(slope)
    tilt = cv2.Rodrigues(np.array([0.0, -angle, 0.0]))[0]
    # A street between houses without a wall that a plane would be found in: it slopes, they do not.
    points = room(rng, walls=0) @ tilt.T
    poses[:, :3, 3] = poses[:, :3, 3] @ tilt.T
    found = capture(points, poses, T, files=[f"{i}.png" for i in range(12)], size=(640, 480))
    feet = np.array([(x, y, 0.1) for x in np.linspace(2, 12, 14) for y in (0.5, 4.5)])
    uprights = np.stack([feet, feet + np.array([0.0, 0.0, 2.0])], axis=1)
    drawn(tmp_path, found, uprights @ T[:3, :3].T + T[:3, 3])
    alignment = align(found, tmp_path, options=METRIC)
    cues = {cue.name: cue for cue in alignment.gravity}
    assert degrees_off(alignment, T) < 0.4
    # Where two cues contradict each other, what is stated holds both.
    assert slope - 0.4 < alignment.up_uncertain < slope + 2.0
    assert cues["floor"].degrees == pytest.approx(slope, abs=0.4)
    assert any("up by floor is " in line for line in alignment.warnings) == (slope > 0)
    # Cameras 1.4 m above the floor, wherever it has risen to.
    assert scale_off(alignment, T) == pytest.approx(1.5 / 1.4 - 1, abs=0.02)


def test_edges_that_lie_anyhow_say_nothing_about_up(tmp_path):
    rng = np.random.default_rng(13)
    poses = walk(rng, 12)
    found = capture(room(rng), poses, files=[f"{i}.png" for i in range(12)], size=(640, 480))
    middles = rng.uniform((-1, -1, 0), (7, 6, 2.5), (150, 3))
    ways = rng.normal(size=(150, 3))
    drawn(tmp_path, found, np.stack([middles, middles + ways], axis=1))
    alignment = align(found, tmp_path, options=METRIC)
    assert "edges" not in {cue.name for cue in alignment.gravity}


def test_cues_that_agree_are_not_warned_of():
    rng = np.random.default_rng(9)
    alignment = aligned(room(rng), walk(rng), similarity(rng))
    assert alignment.warnings == ()
    assert {cue.name for cue in alignment.gravity} == {"horizon", "floor", "walls"}
    assert max(cue.degrees for cue in alignment.gravity) < 2.0
    assert 0.3 < alignment.floor_share < 0.5  # 900 of 2020 points, and some of the walls' feet.


def test_too_few_points_are_an_error_that_says_so():
    rng = np.random.default_rng(1)
    with pytest.raises(SceneError, match="11 points cannot be aligned"):
        align(capture(room(rng)[:11], walk(rng)), None, options=METRIC)
