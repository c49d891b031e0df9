"""The four kinds of courses have the dimensions that the tasks are defined by."""

from __future__ import annotations

import math
from itertools import pairwise

import mujoco
import numpy as np
import pytest

from nw_places.bake.generate import generate
from nw_places.gaps import DEPTH
from nw_places.ramps import Boards, Humps
from nw_places.stairs import Stairs
from nw_scenes.rays import RayScene
from nw_scenes.robots import get_robot
from nw_sim.catalogue import _BY_NAME, get_scene, names
from nw_sim.physics.world import World


def _of(task):
    return [name for name in names() if name.startswith(task)]


def _profile(name, x, y=0.0):
    return RayScene(get_scene(name).mesh()).height(np.column_stack([x, np.full(len(x), y)]))


@pytest.mark.parametrize("name", _of("gaps/"))
def test_gaps_are_30_to_50_cm_of_nothing_between_level_platforms(name):
    x = np.arange(-1.3, get_scene(name).trail[-1, 0] + 0.2, 0.005)
    height = _profile(name, x)
    # The published floor lies 0.4064 m below the tops of the platforms.
    assert set(np.round(height, 6)) == {0.0, -0.4064}
    edges = np.flatnonzero(np.diff(height))
    falls = [(a, b) for a, b in pairwise(edges) if height[a] == 0.0]
    widths = [x[b] - x[a] for a, b in falls]
    assert len(widths) >= 2
    assert all(0.295 <= round(width, 9) <= 0.505 for width in widths), widths


@pytest.mark.parametrize("name", _of("gaps/"))
def test_the_robot_starts_on_a_platform_above_the_ground(name):
    scene = get_scene(name)
    assert scene.ground.z == -DEPTH
    under = [
        box
        for box in scene.solids
        if box.kind == "obstacle" and np.all(np.abs(box.center[:2]) < box.half_size[:2])
    ]
    assert [round(box.center[2] + box.half_size[2], 9) for box in under] == [0.0]


def test_the_gaussians_of_a_gap_scene_lie_on_its_platforms():
    # The place is baked with its ground at z = 0; the scene lowers it to the published floor.
    name = "gaps/two_12in_carpet"
    means = generate(_BY_NAME[name].place(), budget=4000).means
    T_world_splat = get_scene(name).T_world_splat
    points = means @ T_world_splat[:3, :3].T + T_world_splat[:3, 3]
    on_start = (np.abs(points[:, :2]) < [1.2, 0.7]).all(axis=1) & (np.abs(points[:, 2]) < 0.2)
    assert on_start.sum() > 100
    assert np.median(points[on_start, 2]) == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize("name", _of("stairs/"))
def test_rises_are_10_to_20_cm_and_treads_deep_enough_for_a_paw(name):
    course = _BY_NAME[name].course
    assert isinstance(course, Stairs)
    assert all(0.10 - 1e-9 <= rise <= 0.20 + 1e-9 for rise in course.rises)
    assert len(course.rises) >= 5
    assert all(depth >= 0.28 for depth in (course.depth, *(d for _, d in course.landings)))
    scene = get_scene(name)
    assert scene.trail[-1, 2] == pytest.approx(sum(course.rises), abs=1e-9)


def test_walking_along_the_trail_each_step_is_met_once_and_in_order():
    for name in _of("stairs/"):
        course, scene = _BY_NAME[name].course, get_scene(name)
        corners = np.vstack([[0, 0, 0], scene.trail])[:, :2]
        points = np.concatenate(
            [a + np.linspace(0, 1, 300)[:, None] * (b - a) for a, b in pairwise(corners)]
        )
        height = RayScene(scene.mesh()).height(points)
        climbs = np.diff(height)
        climbs = climbs[np.abs(climbs) > 1e-6]
        assert np.allclose(climbs, course.rises, atol=1e-6), name


def test_one_sees_through_open_risers_and_not_through_closed_ones():
    for name in _of("stairs/"):
        course, scene = _BY_NAME[name].course, get_scene(name)
        first = course.first
        eye = np.array([[first - 0.3, 0.0, course.rises[0] * 0.4]])
        seen = RayScene(scene.mesh()).cast(eye, np.array([[1.0, 0.0, 0.0]]))[0][0]
        assert (seen > 0.35) == course.open_risers, name


def test_there_are_open_curved_landed_and_uneven_stairs():
    courses = [_BY_NAME[name].course for name in _of("stairs/")]
    assert sum(course.open_risers for course in courses) >= 3
    assert sum(course.turn != 0.0 for course in courses) == 1
    assert any(depth >= 1.0 for course in courses for _, depth in course.landings)
    assert any(len(set(course.rises)) > 3 for course in courses)
    assert len({course.top or course.material for course in courses}) >= 8


def test_the_curved_stairs_turn_the_trail():
    trail = get_scene("stairs/curved_granite_plaza").trail
    ways = np.diff(trail[:, :2], axis=0)
    turn = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    assert turn[-1] - turn[0] > math.radians(25)


@pytest.mark.parametrize("name", [n for n in _of("ramps/") if "board" not in n])
def test_ramps_have_no_lip_at_their_foot_nor_at_their_crest(name):
    course = _BY_NAME[name].course
    assert isinstance(course, Humps)
    x = np.arange(0.5, get_scene(name).trail[-1, 0], 0.002)
    steps = np.abs(np.diff(_profile(name, x)))
    steepest = math.tan(math.radians(max(course.angles)))
    assert 12.0 <= min(course.angles) <= max(course.angles) <= 22.0
    assert steps.max() < 0.002 * steepest + 5e-4
    assert steps.max() == pytest.approx(0.002 * steepest, rel=0.05)


@pytest.mark.parametrize("name", ["ramps/one_ramp_plaza", "ramps/two_ramps_car_park_night"])
def test_a_slope_of_the_grounds_own_grey_has_strips_across_from_foot_to_crest(name):
    slopes = [patch for patch in get_scene(name).splat.place.patches if _is_slope(patch)]
    assert len(slopes) == 2 * len(_BY_NAME[name].course.angles)
    for slope in slopes:
        length, width = (math.hypot(*edge) for edge in (slope.u, slope.v))
        rects = [decal.rect for decal in slope.decals]
        assert len(rects) >= 3
        low, _, high, _ = np.transpose(rects)
        # As far from one end as from the other, evenly between, and nearly as wide as the slope.
        assert low[0] == pytest.approx(length - high[-1])
        assert np.diff(low) == pytest.approx(low[1] - low[0])
        assert 0.0 < low[0] < low[1] - low[0]
        assert all(0.0 < right < 0.1 < width - 0.1 < left < width for _, right, _, left in rects)
        assert all(decal.material != slope.material for decal in slope.decals)


def _is_slope(patch):
    """Whether a patch is the upper side of a board that rises or falls along the trail."""
    upwards = patch.u[0] * patch.v[1] - patch.u[1] * patch.v[0]
    return patch.kind == "obstacle" and upwards > 0.5 and abs(patch.u[2]) > 0.1


@pytest.mark.parametrize("name", [n for n in _of("ramps/") if "board" in n])
def test_boards_lean_inwards_from_alternate_sides(name):
    course, scene = _BY_NAME[name].course, get_scene(name)
    assert isinstance(course, Boards)
    rays = RayScene(scene.mesh())
    sides = []
    for (x, y, z), degrees in zip(scene.trail[:-1], course.angles, strict=True):
        left, right = rays.height(np.array([[x, y + 0.05], [x, y - 0.05]]))
        assert abs(left - right) / 0.1 == pytest.approx(math.tan(math.radians(degrees)), rel=1e-4)
        assert (left > right) == (y > 0)
        assert (left + right) / 2 == pytest.approx(z, abs=1e-6)
        sides.append(math.copysign(1, y))
    assert all(a == -b for a, b in pairwise(sides))


@pytest.mark.parametrize(
    "name",
    [
        "gaps/three_decks_garden",
        "ramps/steep_boards_cloister",
        "ramps/two_steep_ramps_workshop",
        "stairs/curved_granite_plaza",
        "stairs/seven_steel_warehouse",
    ],
)
def test_physics_and_rays_meet_the_same_surface(name):
    # MuJoCo's own ray casting against the compiled boxes is the independent source.
    scene = get_scene(name)
    with World(get_robot("go1"), scene) as world:
        world.reset(position=(-30.0, 0.0, 5.0), yaw=0.0)
        rng = np.random.default_rng(4)
        corners = np.vstack([[0, 0, 0], scene.trail])
        low, high = corners[:, :2].min(axis=0) - 0.4, corners[:, :2].max(axis=0) + 0.4
        points = rng.uniform(low, high, (400, 2))
        top = float(scene.trail[:, 2].max()) + 0.6
        down, geom = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
        physics = [
            top
            - mujoco.mj_ray(
                world._model, world._data, np.array([*xy, top]), down, None, 1, -1, geom
            )
            for xy in points
        ]
    eyes = np.column_stack([points, np.full(len(points), top)])
    distance, face = RayScene(scene.mesh()).cast(eyes, np.tile(down, (len(points), 1)))
    # Hand rails are drawn and not touched.
    solid = scene.mesh().kinds[face] != 4
    assert solid.mean() > 0.9
    assert np.abs(np.array(physics) - (top - distance))[solid].max() < 1e-5


@pytest.mark.parametrize("name", ["gaps/two_12in_carpet", "ramps/one_ramp_plaza"])
def test_the_robot_stands_where_it_is_put(name):
    with World(get_robot("go1"), get_scene(name)) as world:
        position = (0.0, 0.0, get_robot("go1").spawn_height)
        world.reset(position=position, yaw=0.0)
        for _ in range(75):
            world.step(np.array(get_robot("go1").default_pose))
        assert 0.2 < world.trunk_position[2] < 0.4
        assert np.abs(world.roll_pitch_yaw[:2]).max() < 0.2
