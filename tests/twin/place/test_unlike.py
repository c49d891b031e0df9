"""A mesh is held against what its photographs show."""

import numpy as np
import pytest
from twin_parts import captured, grid, joined, placed, terrain

from nw_scenes.rays import RayScene
from nw_splat.camera import Camera
from nw_twin.building.unlike import (
    SeenDepth,
    depth_differences,
    difference_findings,
    seen_depths,
    shown_ground,
    unlike_photographs,
)
from nw_twin.reconstruct.depth import write_arrays

LINE = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
FIRST, SECOND, THIRD = (-0.5, 1.2), (1.6, 2.6), (3.0, 5.0)
"""Platforms along x with two gaps of 0.4 m between them, all 0.4 m above their pit."""


def sheet(low, high, z):
    """A level rectangle of two faces, which look up."""
    return grid((*low, z), (high[0] - low[0], 0, 0), (0, high[1] - low[1], 0), (1, 1))


def course(*platforms):
    tops = [sheet((start, -0.8), (end, 0.8), 0.0) for start, end in platforms]
    return terrain(*joined(sheet((-1, -2), (6, 2), -0.4), *tops))


def photographs(mesh, count=6, noise=0.005):
    """What cameras at a person's height see, walking along beside the line, looking ahead."""
    rng, rays = np.random.default_rng(0), RayScene(mesh)
    for x in np.linspace(-1.5, 2.5, count):
        origin = np.array([x, 0.3, 1.5])
        across, down = np.meshgrid(np.linspace(-0.5, 0.5, 160), np.linspace(0.2, 1.0, 120))
        toward = np.stack([np.ones_like(across), across, -down], axis=-1).reshape(-1, 3)
        toward /= np.linalg.norm(toward, axis=1)[:, None]
        far = rays.distance(np.broadcast_to(origin, toward.shape), toward)
        there = np.isfinite(far)
        far = far[there] + rng.normal(0.0, noise, int(there.sum()))
        yield SeenDepth(origin=origin, points=origin + toward[there] * far[:, None])


TRUE = course(FIRST, SECOND, THIRD)


def test_a_mesh_that_is_as_photographed_has_no_finding():
    assert unlike_photographs(TRUE, LINE, photographs(TRUE)) == []


def test_a_platform_that_the_mesh_lacks_is_named_with_its_size_and_place():
    (found,) = unlike_photographs(course(FIRST, THIRD), LINE, photographs(TRUE))
    assert (found.code, found.severity) == ("unlike_photographs", "error")
    assert "photographs show ground that the mesh lacks" in found.message
    assert found.value == pytest.approx(1.0 * 1.2, rel=0.15)  # 0.6 m to each side of the line.
    assert found.place[:2] == pytest.approx((2.1, 0.0), abs=0.1)


def test_a_gap_that_the_mesh_closes_is_named():
    (found,) = unlike_photographs(course(FIRST, (SECOND[0], THIRD[1])), LINE, photographs(TRUE))
    assert "the mesh has ground where photographs show none" in found.message
    assert found.place[:2] == pytest.approx((2.8, 0.0), abs=0.1)


def test_edges_that_are_uncertain_by_centimetres_are_no_fault():
    edges = course((-0.5, 1.25), (1.55, 2.64), (2.96, 5.0))
    assert unlike_photographs(edges, LINE, photographs(TRUE, noise=0.01)) == []


def test_what_one_photograph_alone_shows_is_not_believed():
    seen = list(photographs(course(FIRST, THIRD)))
    (one,) = photographs(TRUE, count=1)
    assert unlike_photographs(course(FIRST, THIRD), LINE, [*seen, one]) == []


def test_what_is_beyond_reach_of_the_trail_does_not_count():
    aside = LINE + np.array([0.0, 1.6, 0.0])
    assert unlike_photographs(course(FIRST, THIRD), aside, photographs(TRUE)) == []


STATIONS = np.column_stack([np.linspace(0.0, 4.0, 41), np.zeros(41), np.zeros(41)])


@pytest.mark.parametrize("off", [0.0, 0.02])
def test_depths_are_as_far_from_the_mesh_as_it_is_wrong(off):
    ground = course((-1.0, 6.0))
    seen = [
        SeenDepth(origin=each.origin, points=each.points + np.array([0.0, 0.0, off]))
        for each in photographs(ground, noise=0.0)
    ]
    found = depth_differences(ground, STATIONS, seen)
    assert found.overall == pytest.approx((off, off), abs=0.001)
    assert 1 <= found.photographs[5] < found.photographs[30]
    assert np.nanmax(found.most) == pytest.approx(off, abs=0.001)
    assert f"mesh and depth maps are {1e3 * off:.0f} mm apart (median)" in str(found)
    assert list(difference_findings(found, STATIONS[:, 0], STATIONS)) == []


def test_ground_that_is_wrong_or_that_no_photograph_shows_is_named_by_where_it_is():
    ground, raised = course((-1.0, 6.0)), course((-1.0, 2.0), (2.0, 6.0))
    raised.vertices[-4:, 2] += 0.15
    near = [
        SeenDepth(origin=each.origin, points=each.points[each.points[:, 0] > 1.0])
        for each in photographs(ground)
    ]
    found = depth_differences(raised, STATIONS, near)
    wrong, blind = difference_findings(found, STATIONS[:, 0], STATIONS)
    assert "more than 0.05 m apart (median) from 2.1" in wrong.message
    assert "to 4.00 m along the course" in wrong.message
    assert "no photograph shows the ground" in blind.message
    assert "from 0.00 to 0.90 m along the course" in blind.message
    assert {wrong.severity, blind.severity} == {"warning"}
    shown = shown_ground(raised, near)
    assert shown(np.array([[0.5, 0.0], [1.5, 0.0], [3.0, 0.0], [1.5, 9.0]])).tolist() == [
        False, True, False, False,
    ]  # fmt: skip


def test_depths_of_a_photograph_that_was_made_smaller_lie_where_it_shows_them(tmp_path):
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 2.0
    camera = Camera.from_fovy(width=800, height=600, fovy=0.9, T_world_camera=down)
    capture = captured([placed("a.jpg", camera)])
    half = np.full((300, 400), 2.0, np.float32)
    write_arrays(tmp_path / "a.jpg.npz", depth=half, confidence=np.ones_like(half))
    (seen,) = seen_depths(capture, np.eye(4), tmp_path)
    reach = 2.0 * np.tan(0.45)
    np.testing.assert_allclose(
        np.abs(seen.points).max(axis=0), [4 * reach / 3, reach, 0], atol=0.01
    )
    np.testing.assert_allclose(seen.points.mean(axis=0), 0.0, atol=0.01)
