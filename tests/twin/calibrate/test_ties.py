"""Cameras that nothing ties to the others are left out; misplaced ones fit few matches."""

import os
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from nw_twin.calibrate.calibrate import calibrate
from nw_twin.calibrate.mapping import fitting, tied
from nw_twin.calibrate.solution import Placed, Solution
from nw_twin.capture import read_capture
from nw_twin.lens import Lens
from nw_twin.options import CalibrateOptions

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))
STREET = ASSETS / "photographs" / "street"
LENS = Lens(model="SIMPLE_PINHOLE", width=64, height=48, params=(50.0, 32.0, 24.0))


def solution(*seen):
    """Cameras a, b, ... that see the points of each range."""
    count = max(each.stop for each in seen)
    placed = [
        Placed(
            name=chr(ord("a") + place),
            lens=LENS,
            T_world_camera=np.eye(4),
            seen=np.array(each, np.int32),
        )
        for place, each in enumerate(seen)
    ]
    points = np.arange(count)[:, None] + np.zeros(3)
    return Solution(
        placed=tuple(placed),
        points=points,
        colours=np.zeros((count, 3), np.uint8),
        errors=np.arange(count, dtype=np.float32),
    )


def names(found):
    return "".join(one.name for one in found.placed)


def test_cameras_in_a_chain_hang_together_though_its_ends_share_nothing():
    chain = solution(range(60), range(30, 90), range(60, 120))
    assert tied(chain) is chain


def test_a_group_that_fewer_than_twenty_five_points_tie_to_the_others_is_left_out():
    both = solution(range(40), range(30), range(16, 90), range(50, 90), range(60, 90))
    assert names(tied(both)) == "cde"


def test_points_that_only_those_left_out_saw_are_gone_and_the_others_keep_their_own():
    found = tied(solution(range(20), range(20, 60), range(30, 60)))
    assert names(found) == "bc"
    assert found.points[found.placed[1].seen, 0].tolist() == list(range(30, 60))
    assert found.errors.tolist() == list(range(20, 60))


def test_nothing_placed_is_nothing_tied():
    assert tied(Solution(placed=())).placed == ()


def test_a_camera_that_only_far_points_hold_fits_fewer_of_its_matches_than_the_others(tmp_path):
    rng = np.random.default_rng(0)
    near = rng.uniform((-4, -2, 8), (4, 2, 20), (60, 3))
    points = np.concatenate([near, 1e5 * rng.uniform((-0.3, -0.3, 1), (0.3, 0.3, 1), (40, 3))])
    lens = Lens(model="SIMPLE_PINHOLE", width=640, height=480, params=(500.0, 320.0, 240.0))
    placed = []
    with closing(pycolmap.Database.open(tmp_path / "matches.db")) as opened:
        number = opened.write_camera(lens.camera())
        for place in range(4):
            T = np.eye(4)
            T[2, 3] = place
            placed.append(Placed(name=f"{place}", lens=lens, T_world_camera=T))
            opened.write_image(pycolmap.Image(name=f"{place}.jpg", camera_id=number))
            local = points - T[:3, 3]
            pixels = 500.0 * local[:, :2] / local[:, 2:] + (320.0, 240.0)
            opened.write_keypoints(place + 1, pixels.astype(np.float32))
        geometry = pycolmap.TwoViewGeometry()
        geometry.config = int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED)
        geometry.inlier_matches = np.repeat(np.arange(100, dtype=np.uint32)[:, None], 2, axis=1)
        for one in range(1, 5):
            for other in range(one + 1, 5):
                opened.write_two_view_geometry(one, other, geometry)
    files = {one.name: f"{one.name}.jpg" for one in placed}
    right = fitting(tmp_path / "matches.db", Solution(placed=tuple(placed)), files)
    assert right == dict.fromkeys("0123", (300, 300))
    away = placed[3].T_world_camera.copy()
    away[:3, 3] += (15.0, 19.0, 20.0)
    placed[3] = replace(placed[3], T_world_camera=away)
    wrong = fitting(tmp_path / "matches.db", Solution(placed=tuple(placed)), files)
    assert {name: of for name, (_, of) in wrong.items()} == dict.fromkeys("0123", 300)
    assert wrong["3"][0] < 0.6 * 300
    assert min(wrong[name][0] for name in "012") > 0.75 * 300


@pytest.mark.nightly
@pytest.mark.assets
@pytest.mark.timeout(1200)
@pytest.mark.skipif(not STREET.is_dir(), reason="the photographs are not shipped")
def test_the_cameras_of_a_walk_down_a_street_are_some_steps_apart(tmp_path):
    calibrate(STREET, tmp_path, CalibrateOptions(), lambda _: None)
    capture = read_capture(tmp_path)
    assert [shot.name for shot in capture.shots] == [f"{n:02}.jpg" for n in range(1, 15)]
    steps = np.linalg.norm(np.diff(capture.centres, axis=0), axis=1)
    assert steps.max() < 2.0 * np.median(steps)
