"""Meshes whose surface is known by construction, as terrain."""

from dataclasses import replace

import numpy as np
import pytest

from nw_scenes.grid import TerrainOptions
from nw_scenes.mesh import TriangleMesh, box_mesh, merge, quad_mesh, rotation_matrix
from nw_scenes.scene import Box, HeightField, Triangles
from nw_scenes.terrain import build_terrain

TRAIL = np.array([[2.0, 0.0, 0.2], [4.0, 0.0, 0.0]])
SPAWN = np.zeros(3)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
TURNED = (np.cos(0.15), 0.0, 0.0, np.sin(0.15))  # 17 degrees about z


def floor(z=0.0, x=(-8.0, 8.0), y=(-8.0, 8.0)):
    return quad_mesh((x[0], y[0], z), (x[1] - x[0], 0, 0), (0, y[1] - y[0], 0), "ground")


def compiled(*parts, trail=TRAIL, **options):
    return build_terrain(merge(parts), trail=trail, spawn=SPAWN, options=TerrainOptions(**options))


def boxes(terrain):
    return [solid for solid in terrain.solids if isinstance(solid, Box)]


def top_of(box, xy):
    """Return where a vertical line leaves a box at its top; nan beside the box."""
    R = rotation_matrix(box.quat)
    o = np.array([*xy, 10.0]) - box.center
    origin, direction = R.T @ o, R.T @ [0, 0, -1.0]
    half = np.array(box.half_size)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (-half - origin) / direction, (half - origin) / direction
    near, far = np.nanmax(np.minimum(a, b)), np.nanmin(np.maximum(a, b))
    return 10.0 - near if near <= far else np.nan


def height_of_all(terrain, xy):
    """Return the upper side of all solids, (N,)."""
    fields = [s.height(xy) for s in terrain.solids if isinstance(s, HeightField)]
    heights = np.max(fields, axis=0)
    for index, point in enumerate(xy):
        heights[index] = np.nanmax([heights[index], *(top_of(b, point) for b in boxes(terrain))])
    return heights


def codes(terrain):
    return [finding.code for finding in terrain.findings]


def test_a_riser_stays_upright_to_a_millimetre():
    """A height field alone would slope over a whole cell before or behind the face at x = 2."""
    terrain = compiled(floor(), box_mesh((2.5, 0, 0.075), (0.5, 0.7, 0.075), UPRIGHT, "obstacle"))
    y = np.linspace(-0.65, 0.65, 27)
    before = height_of_all(terrain, np.column_stack([np.full(27, 1.999), y]))
    behind = height_of_all(terrain, np.column_stack([np.full(27, 2.001), y]))
    assert np.abs(before).max() < 1e-4
    assert np.abs(behind - 0.15).max() < 1e-4


def test_an_oblique_riser_stays_upright_to_a_millimetre():
    terrain = compiled(floor(), box_mesh((2.0, 0, 0.1), (0.3, 0.5, 0.1), TURNED, "obstacle"))
    R = rotation_matrix(TURNED)[:2, :2]
    along = np.linspace(-0.48, 0.48, 25)
    for side in (-1, 1):
        out = (R @ np.stack([np.full(25, side * 0.301), along])).T + np.array([2.0, 0.0])
        within = (R @ np.stack([np.full(25, side * 0.299), along])).T + np.array([2.0, 0.0])
        assert np.abs(height_of_all(terrain, out)).max() < 1e-3
        assert np.abs(height_of_all(terrain, within) - 0.2).max() < 1e-3


def test_every_step_of_a_staircase_has_its_own_riser():
    steps = [
        box_mesh(
            (1.5 + 0.3 * i, 0, 0.06 * (i + 1)), (0.15, 0.7, 0.06 * (i + 1)), UPRIGHT, "obstacle"
        )
        for i in range(5)
    ]
    trail = np.array([[1.5 + 0.3 * i, 0.0, 0.12 * (i + 1)] for i in range(5)])
    terrain = compiled(floor(), *steps, trail=trail)
    x = np.linspace(1.0, 2.8, 901) + 0.0007
    truth = np.where(x < 1.35, 0.0, 0.12 * np.minimum(np.floor((x - 1.35) / 0.3) + 1, 5))
    found = height_of_all(terrain, np.column_stack([x, np.full(901, 0.013)]))
    assert np.abs(found - truth).max() < 1e-3


def test_one_can_pass_under_a_bench():
    terrain = compiled(floor(), box_mesh((2.0, 0, 0.4), (0.2, 0.6, 0.03), TURNED, "obstacle"))
    assert "overhang" in codes(terrain)
    (seat,) = boxes(terrain)
    assert seat.center == pytest.approx((2.0, 0, 0.4), abs=2e-3)
    assert seat.half_size == pytest.approx((0.2, 0.6, 0.03), abs=2e-3)
    under = np.column_stack([np.linspace(1.5, 2.5, 21), np.zeros(21)])
    assert np.abs(terrain.solids[0].height(under)).max() < 1e-6


def test_open_treads_hang_free():
    treads = [
        box_mesh((1.5 + 0.28 * i, 0, 0.17 * (i + 1)), (0.15, 0.5, 0.02), UPRIGHT, "obstacle")
        for i in range(4)
    ]
    trail = np.array([[1.5 + 0.28 * i, 0.0, 0.17 * (i + 1)] for i in range(4)])
    terrain = compiled(floor(), *treads, trail=trail)
    found = sorted(boxes(terrain), key=lambda box: box.center[2])
    assert [box.center[2] for box in found] == pytest.approx([0.17, 0.34, 0.51, 0.68], abs=2e-3)
    assert all(2 * box.half_size[2] == pytest.approx(0.04, abs=2e-3) for box in found)


def test_what_hangs_above_the_headroom_is_not_there():
    roof = box_mesh((2.0, 0, 2.5), (3.0, 3.0, 0.1), UPRIGHT, "structure")
    terrain = compiled(floor(), roof)
    assert not boxes(terrain)
    assert np.abs(terrain.solids[0].heights).max() < 1e-6


def test_a_roof_of_a_single_sheet_is_said_and_passed_under():
    sheet = quad_mesh((1.0, -2.0, 2.5), (2.0, 0, 0), (0, 4.0, 0), "structure")
    terrain = compiled(floor(), sheet)
    assert codes(terrain) == ["layered_sheet"]
    assert np.abs(terrain.solids[0].heights).max() < 1e-6


def test_a_bridge_is_the_ground_where_the_trail_crosses_it():
    deck = box_mesh((2.0, 0, -0.1), (1.5, 0.6, 0.1), UPRIGHT, "obstacle")
    banks = [box_mesh((x, 0, -1.5), (2.0, 3.0, 1.5), UPRIGHT, "structure") for x in (-1.5, 5.5)]
    terrain = compiled(floor(-3.0), deck, *banks, trail=np.array([[2.0, 0, 0], [4.0, 0, 0]]))
    middle = np.column_stack([np.linspace(0.6, 3.4, 15), np.zeros(15)])
    assert np.abs(terrain.solids[0].height(middle)).max() < 1e-4


@pytest.mark.parametrize("thickness", [0.0, 0.004])
def test_a_panel_thinner_than_the_samples_stops_a_robot(thickness):
    if thickness:
        panel = box_mesh((2.0, 0, 0.2), (thickness / 2, 0.6, 0.2), UPRIGHT, "obstacle")
    else:
        panel = quad_mesh((2.003, -0.6, 0.0), (0, 1.2, 0), (0, 0, 0.4), "obstacle")
    terrain = compiled(floor(), panel)
    assert "thin_wall" in codes(terrain)
    heights = terrain.solids[0].heights
    assert heights.max() == pytest.approx(0.4, abs=1e-3)
    # Every row that crosses the panel is blocked.
    low = terrain.solids[0].center[1] - terrain.solids[0].half_size[1]
    y = low + terrain.solids[0].spacing[1] * np.arange(len(heights))
    assert (heights[np.abs(y) < 0.59].max(axis=1) > 0.39).all()


def test_a_wall_behind_which_nothing_was_scanned_stops_a_robot():
    """An open scan of a room ends at its walls: no vertical ray meets them."""
    wall = quad_mesh((4.5, -2.0, 0.0), (0, 4.0, 0), (0, 0, 2.5), "structure")
    terrain = compiled(floor(x=(-2.0, 4.5)), wall)
    field = terrain.solids[0]
    across = np.column_stack([np.linspace(4.0, 4.6, 300), np.full(300, 0.2)])
    assert field.height(across).max() > 1.0


def test_a_lintel_over_a_threshold_leaves_the_door_open():
    sill = box_mesh((2.0, 0, 0.05), (0.1, 0.6, 0.05), UPRIGHT, "structure")
    lintel = box_mesh((2.0, 0, 2.3), (0.1, 0.6, 0.2), UPRIGHT, "structure")
    terrain = compiled(floor(), sill, lintel, trail=np.array([[2.0, 0, 0.1], [3.0, 0, 0]]))
    assert terrain.solids[0].heights.max() == pytest.approx(0.1, abs=1e-4)


@pytest.mark.parametrize(
    ("x", "y", "severity", "where"),
    [
        ((1.0, 1.3), (0.1, 0.4), "warning", "on the way"),
        ((1.0, 1.3), (0.4, 0.7), "note", "0.4 m aside of the way"),
        ((-0.7, -0.4), (-0.2, 0.2), "note", "0.4 m behind the start"),
        ((3.3, 3.5), (-0.2, 0.2), "warning", "on the way"),
        ((3.61, 3.75), (-0.2, 0.2), "note", "0.6 m beyond the last waypoint"),
    ],
)
def test_a_hole_is_worth_a_warning_where_the_robot_walks_only(x, y, severity, where):
    parts = [floor(x=(-8, x[0])), floor(x=(x[1], 8)), floor(x=x, y=(-8, y[0])),
             floor(x=x, y=(y[1], 8))]  # fmt: skip
    (hole,) = compiled(*parts, trail=np.array([[1.5, 0, 0], [3.0, 0, 0]])).findings
    assert (hole.code, hole.severity) == ("hole", severity)
    assert where in hole.message


def test_small_holes_are_closed_and_large_ones_stay_open():
    def framed(x0, x1):
        return [floor(x=(-8, x0)), floor(x=(x1, 8)), floor(x=(x0, x1), y=(-8, -0.2)),
                floor(x=(x0, x1), y=(0.2, 8))]  # fmt: skip

    small = compiled(*framed(1.0, 1.5))
    assert codes(small) == ["hole"]
    assert small.findings[0].value == pytest.approx(0.2, rel=0.1)
    assert small.findings[0].place[:2] == pytest.approx((1.25, 0.0), abs=0.02)
    assert np.abs(small.solids[0].heights).max() < 1e-6
    assert "on the way" in small.findings[0].message
    large = compiled(*framed(1.0, 2.5))
    assert "left open" in large.findings[0].message
    assert large.solids[0].height(np.array([[1.75, 0.0]]))[0] < -0.4


def test_a_hole_in_a_slope_is_closed_by_the_slope():
    def slope(x0, x1, y0, y1):
        return quad_mesh(
            (x0, y0, 0.1 * x0), (x1 - x0, 0, 0.1 * (x1 - x0)), (0, y1 - y0, 0), "ground"
        )

    terrain = compiled(
        slope(-8, 1, -8, 8), slope(1.3, 8, -8, 8), slope(1, 1.3, -8, -0.1), slope(1, 1.3, 0.1, 8),
        trail=np.array([[4.0, 0, 0.4]]),
    )  # fmt: skip
    x = np.linspace(0.9, 1.4, 26)
    found = terrain.solids[0].height(np.column_stack([x, np.zeros(26)]))
    assert np.abs(found - 0.1 * x).max() < 5e-3


def test_a_closed_mesh_and_an_open_one_give_the_same_ground():
    block = box_mesh((2.0, 0, -1.0), (8.0, 8.0, 1.0), UPRIGHT, "ground")
    closed, opened = compiled(block), compiled(floor())
    inner = np.random.default_rng(0).uniform((-0.5, -0.5), (4.5, 0.5), (200, 2))
    assert closed.solids[0].height(inner) == pytest.approx(opened.solids[0].height(inner))


def test_ground_below_zero_is_found_and_the_catching_plane_lies_below_it():
    terrain = compiled(floor(-0.4), trail=np.array([[2.0, 0, -0.4]]))
    assert terrain.spawn_height == pytest.approx(-0.4)
    assert terrain.floor < -0.4 - 0.3


def test_there_is_no_spawn_height_where_there_is_no_ground():
    terrain = compiled(floor(x=(1.0, 8.0)))
    assert np.isnan(terrain.spawn_height)


def test_a_noisy_scan_is_met_to_a_millimetre():
    random = np.random.default_rng(5)
    X, Y = np.meshgrid(np.linspace(-2, 6, 230), np.linspace(-2, 2, 115))
    Z = 0.02 * np.sin(3 * X) * np.cos(2 * Y) + random.normal(0, 0.002, X.shape)
    index = np.arange(X.size).reshape(X.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    scan = TriangleMesh(
        vertices=np.stack([X, Y, Z], -1).reshape(-1, 3),
        faces=faces.astype(np.int32),
        kinds=np.zeros(len(faces), dtype=np.uint8),
    )
    terrain = build_terrain(scan, trail=TRAIL, spawn=SPAWN)
    assert terrain.accuracy.median < 2e-4
    assert terrain.accuracy.p99 < 2e-3


def test_triangles_are_kept():
    mesh = merge([floor(), box_mesh((2, 0, 0.1), (0.2, 0.5, 0.1), UPRIGHT, "obstacle")])
    terrain = build_terrain(
        mesh, trail=TRAIL, spawn=SPAWN, options=TerrainOptions(collision="triangles")
    )
    (solid,) = terrain.solids
    assert isinstance(solid, Triangles)
    assert (solid.faces == mesh.faces).all()


def test_compiling_twice_gives_the_same_bits():
    parts = (floor(), box_mesh((2, 0, 0.1), (0.3, 0.5, 0.1), TURNED, "obstacle"))
    first, second = compiled(*parts), compiled(*parts)
    assert first.solids[0].heights.tobytes() == second.solids[0].heights.tobytes()
    assert boxes(first) == boxes(second)


def test_a_block_that_the_trail_leads_over_is_no_roof_though_the_floor_goes_on_below_it():
    block = box_mesh((2.5, 0, 0.65), (1.0, 1.0, 0.65), UPRIGHT, "obstacle")
    corners = block.triangles
    seen = corners[:, :, 2].max(axis=1) > 0.1  # No scanner sees its underside.
    scanned = replace(block, faces=block.faces[seen], kinds=block.kinds[seen])
    terrain = compiled(floor(), scanned, trail=np.array([[2.0, 0, 1.3], [3.0, 0, 1.3]]))
    over = np.array([[2.0, 0.1], [2.6, -0.2], [3.1, 0.0]])
    assert terrain.solids[0].height(over) == pytest.approx([1.3] * 3, abs=1e-4)


def test_the_slivers_of_a_noisy_wall_are_no_slabs():
    random = np.random.default_rng(0)
    y, z = np.meshgrid(np.arange(-1.0, 1.0, 0.03), np.arange(0.0, 0.9, 0.03))
    x = 2.0 + random.normal(0, 0.003, y.shape)
    index = np.arange(y.size, dtype=np.int32).reshape(y.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, d, c], -1), np.stack([a, c, b], -1)]).reshape(-1, 3)
    wall = TriangleMesh(
        vertices=np.stack([x, y, z], -1).reshape(-1, 3),
        faces=faces.astype(np.int32),
        kinds=np.zeros(len(faces), dtype=np.uint8),
    )
    top = quad_mesh((2.0, -1.0, 0.87), (1.0, 0, 0), (0, 2.0, 0), "obstacle")
    terrain = compiled(floor(), wall, top)
    assert len(boxes(terrain)) <= 1  # The far edge of the top, which is straight.


def test_platforms_at_both_ends_of_the_grid_are_two():
    quat = (np.cos(0.05), 0.0, 0.0, np.sin(0.05))
    decks = [box_mesh((x, 0, 0.3), (2.0, 0.6, 0.05), quat, "obstacle") for x in (-2.4, 6.4)]
    terrain = compiled(floor(), *decks, trail=np.array([[2.0, 0, 0.0], [4.0, 0, 0.35]]))
    assert len(boxes(terrain)) < 10  # Row by row of the grid they would be dozens.
