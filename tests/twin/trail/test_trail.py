"""Trails are proposed over what lies on a walk: bars, gaps, slopes, boards and stairs."""

import math

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_places.gaps import GAPS
from nw_places.hurdles import HURDLES
from nw_places.ramps import RAMPS
from nw_places.stairs import STAIRS
from nw_scenes.mesh import box_mesh, merge, quad_mesh
from nw_scenes.rays import RayScene
from nw_scenes.robots import get_robot
from nw_scenes.scene import Plane, Scene
from nw_sim.survey.course import stance_of
from nw_sim.survey.ground import survey_ground
from nw_twin.course import propose_course, propose_free_course

GROUND = quad_mesh((-5, -5, 0), (30, 0, 0), (0, 10, 0), "ground")


def box(x, z, y=(-0.8, 0.8), *, roll=0.0, pitch=0.0):
    """Return a box from x to x, y to y and z to z, turned about its middle."""
    center = [(low + high) / 2 for low, high in (x, y, z)]
    half = [(high - low) / 2 for low, high in (x, y, z)]
    quat = (math.cos((roll or pitch) / 2), math.sin(roll / 2), math.sin(pitch / 2), 0.0)
    return box_mesh(center, half, quat, "obstacle")


def walk(length, *, height=1.4, heading=0.0, step=0.25, swing=0.03):
    """Return where the cameras of a walk were, heights and sides swinging a little."""
    along = np.arange(0.0, length + 1e-9, step)
    side = swing * np.sin(7.0 * along)
    c, s = math.cos(heading), math.sin(heading)
    centres = np.column_stack([c * along - s * side, s * along + c * side, height + 0 * along])
    centres[:, 2] += 0.02 * np.cos(5.0 * along)
    return centres


def turned(mesh, heading):
    """Return a mesh turned about z."""
    c, s = math.cos(heading), math.sin(heading)
    vertices = mesh.vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return type(mesh)(vertices=vertices, faces=mesh.faces, kinds=mesh.kinds)


def test_a_flat_way_is_a_trail_without_obstacles():
    proposal = propose_course(GROUND, walk(5.0))
    assert proposal.task == "hurdles"
    assert proposal.features == ()
    assert "flat" in proposal.reasons[0]
    np.testing.assert_allclose(proposal.trail, [(5.0, 0.0, 0.0)], atol=0.05)


@pytest.mark.parametrize("heading", [0.0, 0.9])
def test_bars_are_hurdles_with_a_waypoint_on_each(heading):
    bars = [box((2.0, 2.35), (0, 0.25)), box((3.6, 3.95), (0, 0.35))]
    mesh = turned(merge([GROUND, *bars]), heading)
    proposal = propose_course(mesh, walk(6.5, heading=heading))
    assert proposal.task == "hurdles"
    assert [feature.size for feature in proposal.features] == pytest.approx([0.25, 0.35], abs=0.01)
    along = np.array(proposal.trail)[:, :2] @ [math.cos(heading), math.sin(heading)]
    np.testing.assert_allclose(along, [2.175, 3.775, 5.35], atol=0.1)
    np.testing.assert_allclose(np.array(proposal.trail)[:, 2], [0.25, 0.35, 0.0], atol=0.01)
    assert proposal.spawn.yaw == pytest.approx(heading, abs=0.1)
    assert proposal.warnings == ()


def test_platforms_are_gaps_with_a_waypoint_behind_each():
    platforms = [box(x, (-0.4, 0.0)) for x in ((-1.0, 1.3), (1.7, 2.75), (3.25, 6.0))]
    lower = quad_mesh((-5, -5, -0.4), (30, 0, 0), (0, 10, 0), "ground")
    proposal = propose_course(merge([lower, *platforms]), walk(5.5))
    assert proposal.task == "gaps"
    assert [feature.size for feature in proposal.features] == pytest.approx([0.4, 0.5], abs=0.06)
    assert len(proposal.trail) == 3
    assert proposal.trail[0][0] == pytest.approx(2.225, abs=0.1)
    assert {z for _, _, z in proposal.trail} == {0.0}


@pytest.mark.parametrize("down", [False, True])
def test_steps_are_stairs_with_a_waypoint_on_every_other(down):
    rise, depth, count = 0.15, 0.3, 6
    steps = [
        box((1.5 + depth * i, 1.5 + depth * (i + 1) + 3.0 * (i == count - 1)), (0, rise * (i + 1)))
        for i in range(count)
    ]
    mesh, centres = merge([GROUND, *steps]), walk(5.5, height=2.3)
    if down:
        centres = centres[::-1]
    proposal = propose_course(mesh, centres)
    assert proposal.task == "stairs"
    assert "6 steps" in proposal.features[0].words
    assert proposal.features[0].size == pytest.approx(0.9, abs=0.02)
    heights = [z for _, _, z in proposal.trail]
    want = [0.75, 0.45, 0.15, 0.0] if down else [0.15, 0.45, 0.75, 0.9]
    np.testing.assert_allclose(heights, want, atol=0.01)
    assert any("0.90 m" in warning for warning in proposal.warnings) == down  # The spawn is above.


def test_a_hump_is_a_ramp_with_a_waypoint_on_its_deck():
    angle = math.radians(15.0)
    run = 1.2 * math.cos(angle)
    rise = run * math.tan(angle)
    parts = [
        GROUND,
        quad_mesh((1.5, -0.5, 0), (run, 0, rise), (0, 1, 0), "obstacle"),
        quad_mesh((1.5 + run, -0.5, rise), (0.8, 0, 0), (0, 1, 0), "obstacle"),
        quad_mesh((2.3 + run, -0.5, rise), (run, 0, -rise), (0, 1, 0), "obstacle"),
    ]
    proposal = propose_course(merge(parts), walk(6.5))
    assert proposal.task == "ramps"
    assert [feature.size for feature in proposal.features] == pytest.approx([15, 15], abs=1.5)
    assert proposal.trail[0][2] == pytest.approx(rise, abs=0.01)
    assert 1.5 + run < proposal.trail[0][0] < 2.3 + run
    assert proposal.trail[-1][2] == 0.0


def test_boards_that_lean_to_the_sides_are_ramps():
    boards = []
    for number, side in enumerate((1, -1, 1)):
        x = 1.2 + 0.95 * number
        lift = 0.9 * math.sin(math.radians(18.0))
        low, along = (-0.45 * side, 0.9 * side)
        origin, u, v = (x, low, 0.03), (0.85, 0, 0), (0, along, lift)
        if side < 0:  # Its face is to look up.
            origin, v = (x, low + along, 0.03 + lift), (0, -along, -lift)
        boards.append(quad_mesh(origin, u, v, "obstacle"))
    proposal = propose_course(merge([GROUND, *boards]), walk(6.0, swing=0.0))
    assert proposal.task == "ramps"
    leaning = [feature for feature in proposal.features if "board" in feature.words]
    assert len(leaning) == 3
    assert [feature.words.split()[-1] for feature in leaning] == ["right", "left", "right"]


@pytest.mark.parametrize(
    "entry",
    [
        pytest.param(entry, id=entry.name, marks=[] if number < 2 else [pytest.mark.nightly])
        for entries in (HURDLES, GAPS, RAMPS, STAIRS)
        for number, entry in enumerate(entries)
    ],
)
def test_the_shipped_scenes_are_taken_for_what_they_are(entry):
    scene = entry.scene()
    path = np.vstack([scene.spawn.position, scene.trail, scene.trail[-1:] + np.array([0.8, 0, 0])])
    along = np.linspace(0, len(path) - 1, 60)
    centres = np.column_stack([np.interp(along, np.arange(len(path)), axis) for axis in path.T])
    proposal = propose_course(scene.mesh(), centres + np.array([0, 0, 1.2]))
    assert proposal.task == scene.task
    # Nearly all of the shipped waypoints have one near; the last one depends on the walk's end.
    proposed = np.array(proposal.trail)
    if len(scene.trail) > 1:
        near = np.linalg.norm(scene.trail[:-1, None] - proposed, axis=2).min(axis=1)
        assert np.mean(near < 0.35) >= 0.75


def test_a_way_that_no_camera_saw_the_beginning_of_begins_where_a_robot_can_stand():
    for edge in (1.0, -0.05):  # The second is below the first camera, and its rear legs' void.
        ground = quad_mesh((edge, -5, 0), (30, 0, 0), (0, 10, 0), "ground")
        proposal = propose_course(ground, walk(6.0))
        assert proposal.spawn.position[0] == pytest.approx(edge + 0.3, abs=0.05)
    np.testing.assert_allclose(proposal.trail, [(6.0, 0.0, 0.0)], atol=0.05)
    assert not any("holes" in warning for warning in proposal.warnings)


def test_a_long_way_begins_one_and_a_half_metres_before_what_lies_on_it():
    bar = box((3.9, 4.1), (0.0, 0.15), (-1, 1))
    proposal = propose_course(merge([GROUND, bar]), walk(6.0, swing=0.0))
    assert proposal.spawn.position[0] == pytest.approx(2.4, abs=0.1)
    assert proposal.features[0].start == pytest.approx(1.5, abs=0.05)
    assert proposal.trail[0] == pytest.approx((4.0, 0.0, 0.15), abs=0.05)


def test_a_robot_is_not_set_down_with_a_foot_over_a_hole():
    # Ground all along, but for a hole to the left of the way, 0.2 m wide and 0.26 m long.
    parts = [
        quad_mesh((-2, -2, 0), (10, 0, 0), (0, 2.0, 0), "ground"),
        quad_mesh((-2, 0.25, 0), (10, 0, 0), (0, 2.0, 0), "ground"),
        quad_mesh((-2, 0, 0), (1.7, 0, 0), (0, 0.25, 0), "ground"),
        quad_mesh((-0.04, 0, 0), (8, 0, 0), (0, 0.25, 0), "ground"),
    ]
    x = propose_course(merge(parts), walk(6.0, swing=0.0)).spawn.position[0]
    assert -0.04 + 0.25 < x < 0.6


def test_who_walks_over_the_course_and_then_once_around_it_gets_the_way_over_it():
    over = walk(5.0)
    turn = np.linspace(0.0, 2.0 * math.pi, 24)
    around = np.column_stack([2.5 - 2.8 * np.cos(turn), 1.4 * np.sin(turn), 1.4 + 0 * turn])
    proposal = propose_course(GROUND, np.concatenate([over, around]))
    np.testing.assert_allclose(proposal.trail, [(5.0, 0.0, 0.0)], atol=0.05)
    assert proposal.spawn.yaw == pytest.approx(0.0, abs=0.1)


def test_ceilings_and_walks_back_do_not_matter():
    ceiling = box((-1, 8), (2.2, 2.5), (-3, 3))
    mesh = merge([GROUND, box((2.0, 2.35), (0, 0.25)), ceiling])
    there = walk(5.0)
    proposal = propose_course(mesh, np.concatenate([there, there[::-1]]))
    assert len(proposal.features) == 1
    assert proposal.trail[-1][0] == pytest.approx(2.35 + 1.4, abs=0.25)


def scanned(height, rng, *, cell=0.04, noise=0.006, holes=0.03):
    """Return a scan of a height z(x): a grid of triangles, edges rounded, noise and holes."""
    x, y = np.arange(-1.0, 7.0, cell), np.arange(-1.0, 1.0, cell)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    z = height(gx) + rng.normal(0, noise, gx.shape)
    vertices = np.column_stack([gx.ravel(), gy.ravel(), z.ravel()])
    corner = (np.arange(len(x) - 1)[:, None] * len(y) + np.arange(len(y) - 1)).ravel()
    corner = corner[rng.random(len(corner)) > holes]
    a, b, c, d = corner, corner + len(y), corner + len(y) + 1, corner + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    kinds = np.zeros(len(faces), np.uint8)
    return type(GROUND)(vertices=vertices, faces=faces.astype(np.int32), kinds=kinds)


@pytest.mark.parametrize(
    ("height", "task", "count"),
    [
        (lambda x: 0.0 * x, "hurdles", 0),
        (lambda x: 0.3 * (abs(x - 2.5) < 0.2) + 0.2 * (abs(x - 4.0) < 0.2), "hurdles", 2),
        (lambda x: -0.4 * ((abs(x - 1.5) < 0.25) | (abs(x - 3.2) < 0.3)), "gaps", 2),
        (lambda x: np.clip(0.25 * (x - 1.5), 0, 0.4), "ramps", 1),
        (lambda x: 0.16 * np.clip(np.floor((x - 1.5) / 0.3) + 1, 0, 6), "stairs", 1),
    ],
    ids=["flat", "bars", "gaps", "ramp", "stairs"],
)
def test_scans_with_noise_and_holes_are_read_as_well(height, task, count):
    for seed in range(3):
        mesh = scanned(height, np.random.default_rng(seed))
        proposal = propose_course(mesh, walk(6.0, height=2.4))
        assert (proposal.task, len(proposal.features)) == (task, count), proposal.reasons


def test_steps_with_rounded_edges_are_as_high_as_their_treads():
    def height(x):
        along = np.asarray(x)[..., None] - 1.5 - 0.32 * np.arange(5)
        return 0.1 * (0.5 + 0.5 * np.tanh(along / 0.03)).sum(axis=-1)

    mesh = scanned(height, np.random.default_rng(0), cell=0.02, noise=0.001, holes=0.0)
    (feature,) = propose_course(mesh, walk(6.0, height=2.4)).features
    assert feature.words == "5 steps up, 0.10 m each"


def test_what_lies_too_near_is_warned_of():
    proposal = propose_course(merge([GROUND, box((0.3, 0.6), (0, 0.2))]), walk(3.0))
    assert any("start farther back" in warning for warning in proposal.warnings)


def test_no_walk_and_no_ground_are_errors_in_words():
    with pytest.raises(SceneError, match=r"went 0\.50 m"):
        propose_course(GROUND, walk(0.5, swing=0.0))
    far = walk(4.0) + np.array([100.0, 0.0, 0.0])
    with pytest.raises(SceneError, match="0% of the way has ground"):
        propose_course(GROUND, far)


def test_a_trail_begins_a_step_later_where_the_ground_at_its_first_camera_is_uneven():
    bump = box((-0.3, 0.1), (0.0, 0.05))
    start = propose_course(merge([GROUND, bump]), walk(5.0)).spawn.position
    assert 0.35 < start[0] < 0.7
    assert start[2] == pytest.approx(0.0, abs=0.005)
    rough = merge([GROUND, *(box((x, x + 0.2), (0.0, 0.05)) for x in np.arange(-0.5, 5.0, 0.4))])
    assert propose_course(rough, walk(5.0)).spawn.position[0] < 0.05, "nowhere is better"


def island(length):
    """Return ground that ends so many metres ahead of the walk's start."""
    return quad_mesh((-1, -1, 0), (1 + length, 0, 0), (0, 2, 0), "ground")


@pytest.mark.parametrize("length", [2.0, 3.1, 4.0])
def test_the_last_waypoint_has_a_robots_length_of_ground_behind_it(length):
    (last,) = propose_course(island(length), walk(5.0)).trail
    assert length - 0.75 < last[0] < length - 0.55


def bent(radius, width, sweep):
    """Return a curved corridor in pieces, and the cameras of a walk along its middle."""
    turns = np.linspace(0.0, sweep, 40)
    inner, outer = (
        np.column_stack([r * np.sin(turns), radius - r * np.cos(turns), 0 * turns])
        for r in (radius - width / 2, radius + width / 2)
    )
    vertices = np.concatenate([inner, outer])
    pieces = [(k, 40 + k, 41 + k) for k in range(39)] + [(k, 41 + k, k + 1) for k in range(39)]
    kinds = np.zeros(len(pieces), dtype=GROUND.kinds.dtype)
    mesh = type(GROUND)(vertices=vertices, faces=np.array(pieces, dtype=np.int32), kinds=kinds)
    middle = np.column_stack([radius * np.sin(turns), radius - radius * np.cos(turns)])
    return mesh, np.column_stack([middle, np.full(len(middle), 1.4)])


@pytest.mark.parametrize(("radius", "width"), [(1.5, 0.9), (3.0, 0.8), (8.0, 0.7)])
def test_behind_the_last_waypoint_the_check_of_the_scene_finds_ground_in_a_bend(radius, width):
    mesh, centres = bent(radius, width, 4.0 / radius)
    proposal = propose_course(mesh, centres)
    scene = Scene(
        name="bent",
        task=proposal.task,
        title="",
        solids=(),
        trail=np.array(proposal.trail),
        static_mesh=mesh,
        splat=None,
        ground=Plane(z=-3.0),
        spawn=proposal.spawn,
    )
    stance = stance_of(get_robot("go1"))
    ground = survey_ground(scene, RayScene(mesh), stance.half_width, stance.length)
    assert ground.end > 1.0
    assert not [flaw for flaw in ground.flaws if flaw.kind == "missing" and flaw.last > ground.end]


def test_a_bend_that_is_too_narrow_to_arrive_in_has_a_course_that_is_not_whole():
    proposal = propose_course(*bent(1.5, 0.7, 4.0 / 1.5))
    assert proposal.trail
    assert not proposal.whole


def test_no_waypoint_is_within_reach_of_the_start():
    bar = box((0.2, 0.4), (0, 0.15))
    proposal = propose_course(merge([GROUND, bar]), walk(4.0))
    start = np.array(proposal.spawn.position)
    away = np.linalg.norm(np.array(proposal.trail) - start, axis=1)
    assert len(away) >= 1
    assert away.min() > 0.59


def test_too_little_ground_for_a_waypoint_gives_no_course():
    with pytest.raises(SceneError, match=r"too little for a waypoint 0\.60 m from the start"):
        propose_course(island(0.8), walk(1.1))


def cobbled(seed, *, rough=0.025):
    """Return a street of stones of 0.1 m whose heights have such a standard deviation, metres."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0.0, rough, (120, 40))
    return scanned(
        lambda x: heights[
            (10 * (x + 2)).astype(int), (10 * (np.arange(x.shape[1]) * 0.04)).astype(int)
        ],
        rng,
        noise=0.002,
        holes=0.0,
    )


def test_cobbles_are_a_flat_way():
    for seed in range(4):
        proposal = propose_course(cobbled(seed, rough=0.035), walk(5.0))
        assert proposal.features == (), proposal.reasons
        assert proposal.spawn.position[0] < 0.1


def test_on_cobbles_a_trail_begins_where_they_are_as_even_as_usual():
    bump = box((-0.3, 0.1), (0.0, 0.15))
    start = propose_course(merge([cobbled(0), bump]), walk(5.0)).spawn.position
    assert 0.35 < start[0] < 0.8


def test_a_way_across_a_hole_is_a_trail_on_its_longer_side():
    parts = [
        quad_mesh((-5, -5, 0), (6.5, 0, 0), (0, 10, 0), "ground"),
        quad_mesh((3.0, -5, 0), (20, 0, 0), (0, 10, 0), "ground"),
    ]
    proposal = propose_course(merge(parts), walk(8.0))
    assert proposal.spawn.position[0] == pytest.approx(3.3, abs=0.05)
    assert proposal.trail[-1][0] == pytest.approx(8.0, abs=0.05)
    assert "1.5 m of the way lie beyond" in proposal.warnings[0]
    assert proposal.whole


def test_no_course_leads_over_ground_that_no_photograph_shows():
    proposal = propose_course(GROUND, walk(8.0), shown=lambda xy: xy[:, 0] > 2.0)
    assert proposal.spawn.position[0] == pytest.approx(2.0, abs=0.35)


def test_a_trail_is_no_longer_than_a_robot_walks_in_a_trial():
    proposal = propose_course(GROUND, walk(20.0))
    assert proposal.trail[-1][0] == pytest.approx(8.0, abs=0.05)
    assert "the way continues for 20.0 m: the course is 8 m long at most" in proposal.warnings[0]


def test_a_way_that_bends_has_a_waypoint_in_the_bend():
    corner = np.array([(0, 0, 1.4), (1.5, 0, 1.4), (3, 0, 1.4), (3, 1.5, 1.4), (3, 3, 1.4)])
    proposal = propose_course(GROUND, corner)
    bend, last = np.array(proposal.trail)[:, :2]
    np.testing.assert_allclose(bend, (3.0, 0.0), atol=0.3)
    np.testing.assert_allclose(last, (3.0, 3.0), atol=0.05)


@pytest.mark.parametrize("length", [0.55, 0.9])
def test_a_longer_robot_has_a_longer_trail_and_more_ground_to_arrive_on(length):
    (last,) = propose_course(island(3.0), walk(5.0), length=length).trail
    assert last[0] == pytest.approx(3.0 - length - 0.05, abs=0.06)
    with pytest.raises(SceneError, match=f"a waypoint {max(0.6, length):.2f} m from the start"):
        propose_course(island(length + 0.55), walk(1.7), length=length)


def table(*things):
    """Return a table of 4 x 2.4 m with things on it, at whose sides there is nothing."""
    top = quad_mesh((0, 0, 0), (4, 0, 0), (0, 2.4, 0), "ground")
    return merge([top, *things])


def orbit():
    """Return cameras that go round the table, farther out than it reaches."""
    turn = np.linspace(0.0, 5.0, 24)
    return np.column_stack([2 + 3.5 * np.cos(turn), 1.2 + 2.5 * np.sin(turn), 1.5 + 0 * turn])


def test_where_the_cameras_stood_off_the_ground_the_trail_is_on_the_longest_free_strip():
    toy = box((1.8, 2.4), (0.0, 0.6), (1.3, 2.0))
    with pytest.raises(SceneError, match="of the way has ground below it"):
        propose_course(table(toy), orbit())
    proposal = propose_free_course(table(toy), orbit())
    assert proposal.whole
    assert proposal.features == ()
    stops = np.array([proposal.spawn.position, *proposal.trail])
    assert np.linalg.norm(stops[-1] - stops[0]) > 2.0
    assert (stops[:, :2] > 0.25).all()
    assert (stops[:, :2] < (3.75, 2.15)).all()


def test_a_trail_on_a_free_strip_begins_where_the_strip_does():
    """A bar far off on it does not take the level ground before it away."""
    strip = quad_mesh((0, 0, 0), (12, 0, 0), (0, 1.0, 0), "ground")
    bar = box((9.0, 9.3), (0, 0.1), (0, 1.0))
    aside = np.column_stack([np.linspace(0, 12, 30), np.full(30, -1.0), np.full(30, 1.5)])
    with_bar = propose_free_course(merge([strip, bar]), aside)
    without = propose_free_course(strip, aside)
    assert with_bar.spawn.position[0] == pytest.approx(without.spawn.position[0], abs=0.1)
    assert with_bar.spawn.position[0] < 2.0


def test_a_table_with_no_room_for_a_robot_has_no_trail():
    with pytest.raises(SceneError, match="too little for a waypoint") as caught:
        propose_free_course(quad_mesh((0, 0, 0), (1.2, 0, 0), (0, 0.8, 0), "ground"), orbit())
    assert "label page" in str(caught.value)
    with pytest.raises(SceneError, match=r"no level ground 0\.6 m wide"):
        propose_free_course(quad_mesh((0, 0, 0), (3, 0, 0), (0, 0.5, 0), "ground"), orbit())


@pytest.mark.parametrize("wide", [0.60, 0.62])
def test_half_a_square_metre_of_ground_has_no_course_and_says_how_much_there_is(wide):
    # As wide as a robot: one square of 0.1 m has level ground all round it.
    ground = quad_mesh((0, 0, 0), (wide + 0.1, 0, 0), (0, wide + 0.1, 0), "ground")
    centres = np.array([[0.3, 0.3, 1.5], [0.4, 0.3, 1.5]])
    with pytest.raises(SceneError, match=r"strip of ground is 0\.\d+ m long, .* too short"):
        propose_free_course(ground, centres)


def test_no_patch_of_ground_however_small_is_more_than_an_error_in_words():
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        size = rng.uniform(0.02, 1.5, 2)
        ground = quad_mesh((0, 0, 0), (size[0], 0, rng.normal(0, 0.05)), (0, size[1], 0), "ground")
        centres = rng.uniform(-1, 2, (rng.integers(1, 5), 3)) * (1, 1, 0) + (0, 0, 1.5)
        for propose in (propose_course, propose_free_course):
            try:
                propose(ground, centres)
            except SceneError:
                refused += 1
    assert refused > 60


def test_a_way_that_climbs_is_not_called_flat_and_says_by_how_much():
    even = propose_course(GROUND, walk(4.0))
    assert even.reasons[0] == "the way is flat: a course without obstacles"
    assert "heights from +0.00 to +0.00 m" in even.reasons[-1]
    rise = math.tan(math.radians(4.0))  # Flatter than what counts as a slope.
    hill = quad_mesh((-5, -5, -5 * rise), (30, 0, 30 * rise), (0, 10, 0), "ground")
    climbing = propose_course(hill, walk(4.0, height=2.5))
    assert climbing.reasons[0] == "no bar, gap, slope or step stands out along the way"
    assert "heights from -0.00 to +0.28 m" in climbing.reasons[-1].replace("+0.00", "-0.00")
    assert "rises by 0.01 m and falls by 0.00 m" in climbing.reasons[-1]
