"""Rungs: the course of a ladder at any value of its range, in one of three settings."""

from __future__ import annotations

import math
import re
import subprocess
import sys

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_places.ladders import FAMILIES
from nw_places.splits import split_of
from nw_scenes.rays import RayScene
from nw_sim.catalogue import get_scene, inspect_scene, is_built_in, names, references


def _profile(reference, x, y=0.0):
    return RayScene(get_scene(reference).mesh()).height(np.column_stack([x, np.full(len(x), y)]))


def _rises(reference):
    """Return every step of the ground along the middle of a course, up or down, metres."""
    x = np.arange(-1.0, get_scene(reference).trail[-1, 0], 0.005)
    steps = np.diff(_profile(reference, x))
    return np.round(steps[np.abs(steps) > 0.02], 6)


def test_there_are_a_dozen_families_of_fourteen_rungs_each():
    assert len(FAMILIES) == 12
    for family in FAMILIES.values():
        assert len(family.rungs) == 14
        assert len(family.looks) == 3
        apart = np.diff(family.rungs)
        np.testing.assert_allclose(apart, apart[0], atol=1e-9)


@pytest.mark.parametrize("value", [0.1, 0.34, 0.62])
def test_the_number_of_a_rung_is_the_size_of_its_obstacle(value):
    np.testing.assert_allclose(_rises(f"hurdles/bar@{value}"), [value, -value] * 3)
    np.testing.assert_allclose(_rises(f"hurdles/block@{value}"), [value, -value])
    np.testing.assert_allclose(_rises(f"stairs/drop@{value}"), [-value])
    rise = round(value / 2, 4)
    if rise >= 0.08:
        np.testing.assert_allclose(_rises(f"stairs/up@{rise}"), [rise] * 5)
        np.testing.assert_allclose(_rises(f"stairs/down@{rise}"), [-rise] * 5)


def test_a_gap_and_a_beam_are_as_wide_as_they_are_called():
    x = np.arange(0.0, 6.0, 0.002)
    low = _profile("gaps/gap@0.56", x) < -0.4
    assert 0.002 * low.sum() == pytest.approx(3 * 0.56, abs=0.01)
    y = np.arange(-0.7, 0.7, 0.002)
    across = RayScene(get_scene("gaps/beam@0.24").mesh()).height(
        np.column_stack([np.full(len(y), 2.5), y])
    )
    assert 0.002 * (across > -0.01).sum() == pytest.approx(0.24, abs=0.004)


@pytest.mark.parametrize(("name", "way"), [("ramps/up", 1.0), ("ramps/down", -1.0)])
def test_a_slope_has_its_angle_and_no_lip(name, way):
    x = np.arange(-1.0, 4.5, 0.002)
    steps = np.diff(_profile(f"{name}@0.35", x))
    assert np.abs(steps).max() == pytest.approx(0.002 * math.tan(0.35), rel=0.05)
    assert steps.sum() == pytest.approx(way * 2.4 * math.sin(0.35), abs=1e-3)


def test_boards_lean_by_their_angle_to_alternate_sides():
    slopes = []
    for x in (1.5, 2.5):
        y = np.array([-0.1, 0.1])
        height = RayScene(get_scene("ramps/side@0.3").mesh()).height(
            np.column_stack([np.full(2, x), y])
        )
        slopes.append(math.atan2(height[1] - height[0], 0.2))
    np.testing.assert_allclose(slopes, [0.3, -0.3], atol=1e-6)


def test_no_stone_is_higher_than_the_rung_and_one_nearly_is():
    scene = get_scene("open/stones@0.12")
    tops = [
        box.center[2] + box.half_size[2]
        for box in scene.solids
        if box.kind == "obstacle"
    ]  # fmt: skip
    assert 0.115 < max(tops) <= 0.12
    assert min(tops) >= 0.03


def test_what_hangs_low_is_touched_and_is_no_ground():
    scene = get_scene("hurdles/clearance@0.3")
    boards = [box for box in scene.solids if box.kind == "overhead"]
    assert [round(box.center[2] - box.half_size[2], 9) for box in boards] == [0.3, 0.3]
    middles = np.array([[box.center[0], 0.0] for box in boards])
    np.testing.assert_array_equal(RayScene(scene.mesh()).height(middles), 0.0)


def test_all_rungs_are_free_of_errors():
    for family in FAMILIES.values():
        for value, number in ((family.rungs[0], None), (family.rungs[-1], 1)):
            found = inspect_scene(family.reference(value, number), read_splat=False).findings
            assert [each for each in found if each.severity == "error"] == []


def test_the_other_two_settings_have_the_same_course_and_another_look():
    one, two, three = (get_scene(f"gaps/gap@0.5{end}") for end in ("", "~1", "~2"))
    assert len({scene.digest for scene in (one, two, three)}) == 3
    for other in (two, three):
        np.testing.assert_array_equal(other.trail, one.trail)
        bearing = {(b.center, b.half_size) for b in one.solids if b.kind == "obstacle"}
        assert bearing <= {(b.center, b.half_size) for b in other.solids}


def test_one_value_is_one_scene_however_it_is_written():
    assert references(["hurdles/bar@0.340", "hurdles/bar@0.34"]) == (
        ("hurdles/bar@0.34", "terrain"),
    )
    assert get_scene("hurdles/bar@0.340").digest == get_scene("hurdles/bar@0.34").digest
    assert get_scene("hurdles/bar@0.340").name == "hurdles/bar@0.34"
    assert get_scene("hurdles/bar@0.3401").digest != get_scene("hurdles/bar@0.34").digest


def test_globs_name_the_published_rungs_and_those_of_scenes_name_none():
    found = [reference for reference, _ in references(["stairs/*@*~2"])]
    assert len(found) == 42
    assert found[0] == "stairs/up@0.08~2"
    assert not any("@" in name for name in names())
    assert not any("@" in reference for reference, _ in references(["*"]))
    assert not is_built_in("hurdles/bar")


def test_a_rung_belongs_to_no_split():
    assert split_of("hurdles/bar@0.34") is None
    assert split_of("stairs/up@0.2~1") is None


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("hurdles/bar@0.63", "0.1 to 0.62 m; name a value in that range, such as hurdles/bar@0.62"),
        ("gaps/beam@0.01", "0.09 to 1 m; name a value in that range, such as gaps/beam@0.09"),
        ("ramps/up@20", "angle of the slope is 0.1 to 0.75 rad"),
        ("hurdles/bar@0.12345", "more than 4 decimals; write hurdles/bar@0.123"),
        ("hurdles/bar@high", "write a number behind @, such as hurdles/bar@0.1"),
        ("hurdles/bar@-0.2", "write a number behind @"),
        ("hurdles/bar@0.2~3", "names setting 3"),
        ("hurdles/bar", "hurdles/bar is a ladder; name a rung, such as hurdles/bar@0.1"),
        ("hurdles/baar@0.2", "did you mean 'hurdles/bar@0.1'"),
    ],
)
def test_what_is_no_rung_is_said_with_range_and_fix(wrong, message):
    assert not is_built_in(wrong)
    for ask in (lambda: references([wrong]), lambda: get_scene(wrong)):
        with pytest.raises(SceneError, match=re.escape(message)):
            ask()


def test_a_rung_is_the_same_in_another_process():
    code = "from nw_sim.catalogue import get_scene; print(get_scene('ramps/side@0.37~1').digest)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )  # fmt: skip
    assert done.stdout.strip() == get_scene("ramps/side@0.37~1").digest


def test_waypoints_stay_on_a_beam_and_stones_leave_no_way_round():
    assert get_scene("gaps/beam@0.09").waypoint_noise == (0.0, 0.0)
    x, y = np.meshgrid(np.arange(1.2, 3.6, 0.01), np.arange(-5.0, 5.0, 0.01))
    ground = RayScene(get_scene("open/stones@0.28").mesh()).height(
        np.column_stack([x.ravel(), y.ravel()])
    )
    free = (ground.reshape(x.shape) < 0.05).all(axis=1)
    # A lane without a stone from end to end is nowhere as wide as a robot.
    lanes = "".join("." if each else "x" for each in free).split("x")
    assert max(map(len, lanes)) * 0.01 < 0.3


def test_the_floor_below_a_platform_is_a_round_number_of_nanometres():
    for reference in ("ramps/down@0.37", "stairs/down@0.34", "stairs/drop@0.1"):
        floor = get_scene(reference).ground.z
        assert floor == round(floor, 9) < 0.0
