"""Trails that give success away, or leave a robot no ground to arrive on."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from sample_corridor import box

from nw_eval import api, cli
from nw_places.entries import has_variants
from nw_scenes.robots import get_robot
from nw_scenes.scene import Spawn
from nw_sim.catalogue import get_scene, names
from nw_sim.survey.course import course_findings, stance_of
from nw_sim.tasks.course import start_finding, waypoints_at_start

OPEN = trimesh.util.concatenate(
    [box((-1.5, -1, -0.2), (5.5, 1, 0)), box((1.5, -1, -0.1), (2.5, 1, 0.1))]
)
"""The corridor without walls: it ends at x = 5.5."""


ASSETS = Path(
    os.environ.get("NW_EVAL_ASSETS", Path(__file__).resolve().parents[4] / "shared" / "assets")
)
STAIRS = ASSETS / "photographs" / "stairs" / "real_stairs_125cm.png"


def real_stairs():
    """Return a scan of real stairs that lead up along x, z = 0 at (0, 0), 4 cm a triangle; m."""
    grey, alpha = np.moveaxis(np.array(Image.open(STAIRS, formats=["PNG"]))[..., [0, 3]], 2, 0)
    known = ((alpha > 0) & (grey > 4))[::-1, ::-1]
    z = 1.25 * (grey / 255.0 - grey[40, 75] / 255.0)[::-1, ::-1]
    rows, columns = z.shape
    y, x = 0.04 * (np.indices(z.shape) - np.array([rows - 41, columns - 76])[:, None, None])
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b, c, d = a + 1, a + columns + 1, a + columns
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    faces = faces[known.ravel()[faces].all(axis=1)]
    return trimesh.Trimesh(np.column_stack([x.ravel(), y.ravel(), z.ravel()]), faces, process=False)


@pytest.mark.assets
@pytest.mark.skipif(not STAIRS.is_file(), reason="needs the real stairs")
@pytest.mark.parametrize(
    ("before_end", "walked"), [(0.15, "0 of 4"), (0.3, "0 of 4"), (0.6, "3 of 4"), (0.8, "4 of 4")]
)
def test_on_real_stairs_a_waypoint_is_too_near_the_end_where_go1_parkour_fails(
    place, before_end, walked
):
    top = (2.52 - before_end, 0.0, 0.56 if before_end < 0.7 else 0.37)
    scene = replace(place(real_stairs(), splat=False), trail=np.array([(1.16, 0, 0.19), top]))
    assert ("waypoint_at_end" in codes(scene)) == (walked[0] == "0")


def codes(scene, robot="go1"):
    return {finding.code: finding for finding in course_findings(scene, robot)}


def along(place, *x, **changes):
    """Return the corridor with waypoints at so many metres ahead of the start."""
    trail = np.array([[each, 0.0, 0.0] for each in x])
    return replace(place(OPEN, splat=False), trail=trail, **changes)


def test_a_trail_that_has_to_be_walked_has_nothing_wrong(place):
    assert codes(along(place, 2.0, 4.0)) == {}


@pytest.mark.parametrize(
    ("x", "free"), [((0.0,), 1), ((0.05, 0.1, -0.1, 4.0), 3), ((4.0, 0.0), 0), ((0.39, 2.0), 1)]
)
def test_waypoints_that_are_reached_at_the_start_are_counted_in_order(place, x, free):
    scene = along(place, *x)
    assert waypoints_at_start(scene) == free
    assert (start_finding(scene) is not None) == bool(free)
    assert ("waypoint_at_start" in codes(scene)) == bool(free)


def test_where_a_trial_may_begin_counts_and_so_does_a_waypoint_that_moves(place):
    still = Spawn(x_jitter=0.0, y_jitter=0.0)
    assert waypoints_at_start(along(place, 0.35, 2.0, spawn=still)) == 0
    assert waypoints_at_start(along(place, 0.35, 2.0)) == 1
    moves = {"spawn": still, "waypoint_noise": (0.1, 0.0)}
    assert waypoints_at_start(along(place, 0.35, 2.0, **moves)) == 1


def test_a_trail_shorter_than_the_robot_is_an_error_and_robots_differ(place):
    short = codes(along(place, 0.5))["trail_short"]
    assert (short.severity, short.value) == ("error", pytest.approx(0.5))
    length = {robot: stance_of(get_robot(robot)).length for robot in ("go1", "go2")}
    assert 0.5 < length["go1"] < length["go2"] < 0.6
    between = along(place, (length["go1"] + length["go2"]) / 2)
    assert "trail_short" not in codes(between, "go1")
    assert "shorter than a go2 (0.56 m" in codes(between, "go2")["trail_short"].message


def test_waypoints_that_are_reached_together_are_a_warning(place):
    finding = codes(along(place, 2.0, 2.1, 2.2, 4.0))["waypoints_together"]
    assert finding.severity == "warning"
    assert "2 of 4 waypoints lie within 0.3 m" in finding.message


def test_a_last_waypoint_at_the_scans_end_is_an_error_that_says_how_far(place):
    finding = codes(along(place, 2.0, 5.3))["waypoint_at_end"]
    assert finding.severity == "error"
    assert finding.value == pytest.approx(0.2, abs=0.03)
    assert "move it back by 0.33 m or more" in finding.fix
    assert "waypoint_at_end" not in codes(along(place, 2.0, 4.9))


@pytest.mark.parametrize("name", names())
def test_no_built_in_place_and_no_variant_of_one_has_such_a_trail(name):
    for reference in (name, f"{name}~1") if has_variants(name) else (name,):
        scene = get_scene(reference)
        assert course_findings(scene, "go1") == course_findings(scene, "go2") == []


def test_the_published_stairs_whose_steps_lie_close_together_are_not_refused(place):
    # lucidsim_real_stairs_2 of the release: the trail of which least is ahead of the start.
    x = (0.536, 0.7287, 0.9155, 1.0924, 1.2815, 1.8766)
    scene = along(place, *x, waypoint_noise=(0.0, 0.1))
    assert start_finding(scene) is None
    assert set(codes(scene)) == {"waypoints_together"}


def test_check_names_the_robot_that_it_goes_by(tmp_path, capsys):
    OPEN.export(tmp_path / "collision.ply")
    (tmp_path / "scene.yaml").write_text(
        "nw-scene: 1\nname: my/corridor\ntask: stairs\nlicence: MIT\ncollision: collision.ply\n"
        "trail: [[2.0, 0, 0.1], [4.0, 0, 0]]\n"
    )
    for robot in ("go1", "go2"):
        (checked,) = api.check_scenes([str(tmp_path)], robot=robot)
        assert checked.survey.robot == robot
        with pytest.raises(SystemExit) as left:
            cli.main(["scenes", "check", str(tmp_path), "--robot", robot])
        assert left.value.code == 0
        assert f"where the feet of {robot} go" in capsys.readouterr().out
