"""What the check says about scenes in order and out of it."""

from dataclasses import replace

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_scenes import Box, Plane, Scene, Spawn
from nw_scenes.check import check_scene
from nw_scenes.finding import has_errors
from nw_scenes.mesh import box_mesh, merge, quad_mesh
from nw_sim.catalogue import get_scene, inspect_scene, names

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
FLOOR = quad_mesh((-5, -5, 0), (10, 0, 0), (0, 10, 0), "ground")


class Splat:
    """Gaussians at given centres, or none that can be read."""

    key = "test"

    def __init__(self, folder, means=None, error=None):
        self._path, self._means, self._error = folder / "a.nwsplat", means, error

    def store(self, _progress=None):
        from nw_splat.gaussians import Gaussians
        from nw_splat.store import compile_store

        if self._error:
            raise SceneError(self._error)
        count = len(self._means)
        gaussians = Gaussians(
            means=self._means,
            log_scales=np.full((count, 3), -3.0),
            quats=np.tile([1.0, 0, 0, 0], (count, 1)),
            opacity_logits=np.full(count, 3.0),
            sh=np.zeros((count, 1, 3)),
        )
        compile_store(gaussians, self._path)
        return self._path


def scene(*parts, solids=(), **changes):
    plain = Scene(
        name="test",
        task="hurdles",
        title="",
        solids=solids,
        trail=np.array([[2.0, 0.0, 0.0]]),
        static_mesh=merge(parts or (FLOOR,)),
        splat=None,
    )
    return replace(plain, **changes)


def codes(checked, **options):
    return [finding.code for finding in check_scene(checked, **options)]


def test_a_plain_floor_has_nothing_to_be_said():
    assert codes(scene()) == []


@pytest.mark.parametrize("name", names())
def test_built_in_scenes_have_no_errors(name):
    assert not has_errors(check_scene(get_scene(name), read_splat=False))


def test_a_floor_that_is_not_at_zero_is_said_with_its_height():
    low = quad_mesh((-5, -5, -0.1), (10, 0, 0), (0, 10, 0), "ground")
    (finding,) = check_scene(scene(low, trail=np.array([[2.0, 0, -0.1]])))
    assert (finding.code, finding.severity) == ("floor_offset", "warning")
    assert finding.value == pytest.approx(-0.1)
    assert "-0.100 m" in str(finding)


def test_no_floor_is_an_error():
    beside = quad_mesh((1, -5, 0), (10, 0, 0), (0, 10, 0), "ground")
    assert codes(scene(beside)) == ["no_floor_under_spawn"]


def test_a_floor_seen_from_behind_is_inside_out():
    behind = quad_mesh((-5, -5, 0), (0, 10, 0), (10, 0, 0), "ground")
    assert codes(scene(behind))[0] == "inside_out"


@pytest.mark.parametrize("height", [0.15, 0.4])
def test_a_block_at_the_spawn_is_found_if_it_is_no_step(height):
    block = box_mesh((0, 0, height / 2), (0.1, 0.4, height / 2), UPRIGHT, "obstacle")
    assert ("spawn_blocked" in codes(scene(FLOOR, block))) == (height > 0.2)


def test_a_solid_that_no_ray_sees_still_blocks_the_spawn():
    hidden = Box(center=(0.0, 0.0, 0.3), half_size=(0.1, 0.1, 0.05))
    assert codes(scene(solids=(hidden,))) == ["spawn_blocked"]


def test_the_robot_may_start_beside_a_wall_that_it_is_turned_along():
    wall = box_mesh((0, 0.22, 0.5), (2, 0.02, 0.5), UPRIGHT, "structure")
    assert codes(scene(FLOOR, wall)) == []
    assert codes(scene(FLOOR, wall, spawn=Spawn(yaw=np.pi / 2))) == ["spawn_blocked"]


@pytest.mark.parametrize(
    ("z", "found"),
    [
        (0.0, []),
        (-0.04, []),
        (-0.06, ["waypoint_below_surface"]),
        (0.5, []),
        (1.5, ["waypoint_above_surface"]),
    ],
)
def test_waypoints_lie_on_the_surface_or_a_little_above(z, found):
    assert codes(scene(trail=np.array([[2.0, 0.0, z]]))) == found


def test_a_waypoint_beside_the_mesh_is_named_by_its_number():
    (finding,) = check_scene(scene(trail=np.array([[1.0, 0, 0], [7.0, 0, 0]])))
    assert finding.code == "waypoint_off_mesh"
    assert "waypoint 1 at (7.00, 0.00, 0.00)" in finding.message


def test_a_splat_of_another_size_is_found(tmp_path):
    means = np.random.default_rng(0).uniform((-1, -1, 0), (3, 1, 0.4), (1000, 3))
    there = scene(splat=Splat(tmp_path, means))
    assert codes(there) == []
    assert codes(replace(there, T_world_splat=np.diag([50.0, 50, 50, 1]))) == ["splat_elsewhere"]
    assert codes(replace(there, T_world_splat=np.diag([50.0, 50, 50, 1])), read_splat=False) == []


def test_a_short_trail_in_a_long_street_has_its_splat_where_it_should_be(tmp_path):
    street = quad_mesh((-5, -5, 0), (400, 0, 0), (0, 10, 0), "ground")
    means = np.random.default_rng(0).uniform((-5, -5, 0), (395, 5, 0.2), (20_000, 3))
    there = scene(street, splat=Splat(tmp_path, means))
    assert codes(there) == []
    aside = np.eye(4)
    aside[1, 3] = 20.0
    assert codes(replace(there, T_world_splat=aside)) == ["splat_elsewhere"]


def test_splats_that_cannot_be_read_are_told_from_empty_ones(tmp_path):
    assert codes(scene(splat=Splat(tmp_path, np.zeros((0, 3))))) == ["splat_empty"]
    assert codes(scene(splat=Splat(tmp_path, error="a.pt: cut short"))) == ["splat_invalid"]


def test_inspection_never_raises(tmp_path):
    for reference in ("hurdles/nowhere", tmp_path, f"neverwhere:{tmp_path}"):
        (finding,) = inspect_scene(reference).findings
        assert (finding.code, finding.severity) == ("unreadable", "error")


def test_ground_hidden_by_nothing_but_the_plane_is_ground():
    assert codes(scene(ground=Plane(z=-1.0))) == []
