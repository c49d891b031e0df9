"""Hints say what the default policy can do, by what the ground along the course is like."""

import math

import numpy as np
import pytest
import trimesh
from label_places import block, floor
from test_label_ground import mesh_of

from nw_twin.label.ground import Ground, height_profile, hints_on, obstacles_of

ALONG = [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (5.0, 0.0, 0.0)]


def obstacles(*solids, stops=ALONG):
    return obstacles_of(height_profile(Ground(mesh_of(*solids)), stops))


def hints(*solids, stops=ALONG):
    profile = height_profile(Ground(mesh_of(*solids)), stops)
    found = hints_on(stops, profile)
    return (
        " ".join(hint.text for hint in found if hint.severity == "warning"),
        " ".join(hint.text for hint in found if hint.severity == "note"),
    )


def ramp(angle):
    """A slope up from x = 1 to 2, and a level top behind it."""
    rise = math.tan(angle)
    corners = [(1.0, 0.0), (2.0, rise), (7.0, rise), (7.0, -0.05), (1.0, -0.05)]
    points = np.array([(x, y, z) for y in (-1.5, 1.5) for x, z in corners])
    return trimesh.convex.convex_hull(points)


@pytest.mark.parametrize("height", [0.12, 0.24, 0.34])
@pytest.mark.parametrize("length", [0.05, 0.36])
def test_a_bar_on_the_way_is_a_hurdle_of_its_height(height, length):
    (found,) = obstacles(floor(), block(2.0, length, height))
    assert found.kind == "hurdle"
    assert found.size == pytest.approx(height, abs=1e-6)
    assert found.at == pytest.approx(2.0, abs=0.03)


@pytest.mark.parametrize("width", [0.3, 0.4, 0.6])
def test_a_break_in_the_floor_is_a_gap_of_its_width(width):
    (found,) = obstacles(floor(-2.0, 4.0), floor(2.0 + width, 5.0))
    assert found.kind == "gap"
    assert found.size == pytest.approx(width, abs=0.03)


def test_a_flight_of_stairs_is_its_steps():
    found = obstacles(floor(), *(block(1.0 + 0.3 * i, 6.0, 0.15 * (i + 1)) for i in range(4)))
    assert [each.kind for each in found] == ["step"] * 4
    assert [each.size for each in found] == pytest.approx([0.15] * 4, abs=1e-6)


@pytest.mark.parametrize("degrees", [15, 25, 35])
def test_a_slope_is_a_ramp_of_its_angle(degrees):
    found = obstacles(floor(), ramp(math.radians(degrees)))
    assert [each.kind for each in found] == ["ramp"]
    assert math.degrees(found[0].size) == pytest.approx(degrees, abs=0.5)


def test_a_scan_s_noise_is_no_obstacle():
    mesh = trimesh.creation.box((9.0, 5.0, 0.2)).subdivide_to_size(0.06)
    noise = np.random.default_rng(3).normal(scale=0.008, size=len(mesh.vertices))
    mesh.apply_translation((2.5, 0.0, -0.1))
    vertices = mesh.vertices + np.outer(noise, [0, 0, 1])
    noisy = trimesh.Trimesh(vertices, mesh.faces, process=False)
    assert obstacles(noisy) == ()


def test_what_the_policy_does_well_is_a_note():
    warnings, notes = hints(floor(), block(1.0, 0.3, 0.25), block(4.0, 0.3, 0.2))
    assert warnings == ""
    assert notes == "2 hurdles, 0.25 m at most: within reach."


@pytest.mark.parametrize(
    ("solids", "words"),
    [
        ([floor(), block(1.0, 0.3, 0.30)], "hurdle of 0.30 m at 1.0 m: the default policy manages"),
        ([floor(), block(1.0, 0.3, 0.36)], "probably fails; 0.25 m it does well"),
        ([floor(-2.0, 4.0), floor(2.7, 5.0)], "at 2.0 m: the default policy probably fails; 0.40"),
        ([floor(), block(1.0, 6.0, 0.28)], "step of 0.28 m"),
        ([floor(), ramp(math.radians(33))], "ramp of 33 degrees"),
    ],
)
def test_what_the_policy_may_fail_at_is_a_warning_with_its_size(solids, words):
    warnings, _ = hints(*solids)
    assert words in warnings


@pytest.mark.parametrize(
    ("stops", "words"),
    [
        ([(0.0, 0.0, 0.0)], "no waypoint yet"),
        ([(0.0, 0.0, 0.0), (4.5, 0.0, 0.0)], "4.5 m to waypoint 1"),
        ([(-5.0, 0.0, 0.0), (-1.5, 0.0, 0.0)], "no ground under the start"),
        ([(0.0, 0.0, 0.0), (2.0, 0.0, 0.5)], "Waypoint 1 is 0.50 m above"),
        ([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.1, 0.0, 0.0)], "0.10 m from the last"),
        ([(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (0.5, 0.0, 0.0)], "turns by 180 degrees at 1"),
        ([(0.0, y, 0.0) for y in (-2.0, 2.0, -2.0, 2.0)], "12.0 m long"),
        ([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)], "starts at its goal"),
    ],
)
def test_a_trail_that_cannot_work_is_a_warning(stops, words):
    warnings, _ = hints(floor(), stops=stops)
    assert words in warnings
