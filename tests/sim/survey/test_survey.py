"""What is found along a trail: in a sound corridor nothing, in damaged ones the damage."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from sample_corridor import box, corridor, floor_with_hole, gaussians_on

from nw_sim.catalogue import get_scene, inspect_scene, names
from nw_sim.survey import footing_lines, survey_scene


def found(scene):
    return {finding.code: finding for finding in survey_scene(scene).findings}


def test_a_sound_corridor_has_nothing_wrong_and_its_figures_are_small(place):
    surveyed = survey_scene(place())
    assert surveyed.findings == ()
    assert surveyed.feet.count > 100
    assert surveyed.ground.sound > 0.99
    assert min(view.covered for view in surveyed.views.views) > 0.98
    assert surveyed.views.disagreement.p95 < 0.06


@pytest.mark.parametrize(
    "shift", [(0.2, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, -0.2, 0.0), (0.0, 0.0, -0.2)]
)
def test_a_splat_that_is_moved_is_found_and_the_move_is_told(place, shift):
    T = np.eye(4)
    T[:3, 3] = shift
    finding = found(replace(place(), T_world_splat=T))["splat_shifted"]
    assert finding.severity == "error"
    assert finding.value == pytest.approx(0.2, abs=0.05)
    x, y, z = (round(-part, 1) + 0.0 for part in shift)
    told = finding.fix.split("adding (")[1].split(")")[0]
    assert [round(float(part), 1) for part in told.split(",")] == pytest.approx([x, y, z], abs=0.1)


def test_a_splat_of_half_the_place_covers_too_little(place):
    means = gaussians_on(corridor())
    thin = found(place(means=means[means[:, 1] < 0.0]))["splat_thin"]
    assert thin.severity == "error"
    assert thin.value == pytest.approx(0.5, abs=0.05)
    assert "m along the course" in thin.message
    assert "90 % is wanted" in thin.message


def test_gaussians_that_float_in_the_way_are_named_with_their_place(place):
    means = gaussians_on(corridor())
    y, z = np.random.default_rng(0).uniform((-0.4, 0.0), (0.4, 0.5), (4000, 2)).T
    curtain = np.column_stack([np.full(4000, 3.0), y, z])
    finding = found(place(means=np.concatenate([means, curtain])))["splat_off_mesh"]
    assert finding.place is not None
    assert 1.5 < finding.place[0] < 3.0


@pytest.mark.parametrize(
    ("hole", "code", "severity"),
    [
        ((3.0, 3.1, -0.1, 0.1), "ground_unseen", "warning"),  # Physics closes it.
        ((3.0, 3.6, -0.4, 0.2), "ground_unseen", "error"),  # So much of it is no longer the place.
        ((3.0, 3.9, -0.45, 0.45), "ground_missing", "error"),  # Left open.
    ],
)
def test_a_hole_where_feet_go_is_found_from_where_to_where(place, hole, code, severity):
    scene = place(corridor(floor_with_hole(*hole)), splat=False)
    finding = found(scene)[code]
    assert finding.severity == severity
    first, last = finding.message.split("from ")[1].split(" m along")[0].split(" to ")
    assert float(first) == pytest.approx(hole[0], abs=0.03)
    assert float(last) == pytest.approx(hole[1], abs=0.03)


def test_a_hole_behind_the_last_waypoint_is_found_where_the_robot_arrives(place):
    finding = found(place(corridor(floor_with_hole(4.1, 4.5, -0.45, 0.3)), splat=False))
    assert "behind the last waypoint" in finding["ground_unseen"].message
    assert found(place(corridor(floor_with_hole(4.7, 5.1, -0.45, 0.3)), splat=False)) == {}


def cobbles(height, *, cell=0.1, x=(-1.5, 5.5), y=(-1.0, 1.0)):
    """Return ground of stones of 0.1 m, each so high or at 0, as on a chessboard; m."""
    columns, rows = (round((high - low) / cell) for low, high in (x, y))
    parts = [box((x[0], y[0], -0.2), (x[1], y[1], 0.0))]
    parts += [
        box(
            (x[0] + cell * i, y[0] + cell * j, -0.1),
            (x[0] + cell * (i + 1), y[0] + cell * (j + 1), height),
        )
        for i in range(columns)
        for j in range(i % 2, rows, 2)
    ]
    return trimesh.util.concatenate(parts)


@pytest.mark.parametrize(("height", "rough"), [(0.03, False), (0.06, True)])
def test_ground_is_as_rough_as_it_is_and_too_rough_where_a_go1_falls(place, height, rough):
    surveyed = survey_scene(place(cobbles(height), splat=False))
    # Of stones at two heights, half of each.
    assert np.nanmedian(surveyed.ground.footing.roughness) == pytest.approx(height / 2, rel=0.1)
    assert ("ground_rough" in {one.code for one in surveyed.findings}) == rough
    said = footing_lines(surveyed)
    # A ray down an edge meets the higher of two stones.
    off = float(re.findall(r"roughness: the ground is (\d+) mm off", said[0])[0])
    assert off == pytest.approx(1e3 * height / 2, abs=1.0)
    assert f"steps: {height:.2f} m over 0.04 m" in said[1]


def test_stairs_and_bars_are_steps_and_not_rough():
    for name in ("stairs/seven_high_courtyard", "hurdles/three_benches_cloister"):
        footing = survey_scene(get_scene(name), read_splat=False).ground.footing
        assert np.nanquantile(footing.roughness, 0.9) < 0.003
        assert np.nanmax(footing.step) == pytest.approx(0.2 if "stairs" in name else 0.22, abs=0.01)


def test_a_hole_beside_the_feet_is_nobodys_business(place):
    assert found(place(corridor(floor_with_hole(3.0, 3.5, 0.4, 0.9)), splat=False)) == {}


def test_a_gap_that_the_course_is_about_is_a_note(place):
    shape = corridor(floor_with_hole(3.0, 3.6, -0.99, 0.99))
    assert found(place(shape, splat=False))["ground_missing"].severity == "error"
    gap = found(place(shape, splat=False, task="gaps"))["ground_missing"]
    assert gap.severity == "note"


def test_ground_that_is_seen_and_not_there_is_an_error(place):
    scene = place(splat=False)
    untouched = found(replace(scene, solids=()))["ground_untouched"]
    assert untouched.severity == "error"
    assert untouched.value > 1.0


def test_a_plank_over_the_way_that_cannot_be_touched_is_found(place):
    plank = box((3.0, -0.6, 0.25), (3.3, 0.6, 0.3))
    seen = place(trimesh.util.concatenate([corridor(), plank]), splat=False)
    finding = found(replace(seen, solids=place(splat=False).solids))["ground_untouched"]
    assert "from 3.00 to 3.30 m" in finding.message
    assert "by 0.30 m" in finding.message


@pytest.mark.parametrize(
    ("height", "turn", "far"),
    [(0.4, 0.0, False), (1.4, 0.0, False), (2.5, 0.0, True), (0.4, 1.5, True)],
)
def test_views_that_nobody_photographed_are_a_warning(place, cameras, height, turn, far):
    scene = place(captures=cameras(height, turn))
    assert ("far_from_captures" in found(scene)) == far


@pytest.mark.parametrize("name", ["gaps/two_14in_underpass", "stairs/eight_open_wood_lobby"])
def test_the_ground_of_built_in_places_carries_feet(name):
    surveyed = survey_scene(get_scene(name), read_splat=False)
    assert (surveyed.findings, surveyed.ground.flaws, surveyed.views) == ((), (), None)


@pytest.mark.nightly
@pytest.mark.parametrize("name", names())
def test_nothing_is_wrong_along_the_trails_of_built_in_places(name):
    inspected = inspect_scene(name)
    assert inspected.findings == ()
    assert inspected.survey.views is not None
