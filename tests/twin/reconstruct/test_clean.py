"""Meshes become one piece, flat where they are flat, and of few faces."""

import numpy as np
import pytest
from twin_parts import grid, joined

from nw_base.errors import SceneError
from nw_twin.reconstruct.clean import flatten, flatten_small, holes, large_parts, simplify
from nw_twin.reconstruct.planes import SupposedPlane
from nw_twin.reconstruct.surface import ColourMesh, read_colour_mesh, write_mesh

CELL = 0.02


def sheet(height, across=100, cell=CELL):
    """A grid of across * across cells, whose z is a function of x and y; faces look up."""
    side = across * cell
    vertices, faces = grid((0, 0, 0), (side, 0, 0), (0, side, 0), (across, across))
    vertices[:, 2] = height(*vertices[:, :2].T)
    return shaded(vertices, faces)


def shaded(vertices, faces):
    shade = np.broadcast_to(np.where(vertices[:, :1] > 1.0, 200, 50), vertices.shape)
    return ColourMesh(vertices=vertices, faces=faces, colours=shade.astype(np.uint8))


def noisy(height, sigma=0.002):
    rng = np.random.default_rng(3)
    return sheet(lambda x, y: height(x, y) + rng.normal(0, sigma, x.shape))


def beside(first, *others):
    """One mesh of several, of which all but the first are shifted."""
    shifted = [(each.vertices + np.array(by), each.faces) for each, by in others]
    return shaded(*joined((first.vertices, first.faces), *shifted))


def test_a_noisy_floor_becomes_a_plane():
    floor, planes = flatten(noisy(lambda x, y: 0.1 * x + 0 * y), CELL)
    (plane,) = planes
    assert plane.normal == pytest.approx(np.array([-0.1, 0, 1]) / np.hypot(0.1, 1), abs=1e-3)
    assert plane.noise == pytest.approx(0.002, rel=0.15)
    assert plane.moved > 0.95
    assert plane.area == pytest.approx(4.0 * np.hypot(0.1, 1), rel=0.02)
    assert np.abs(floor.vertices @ plane.normal - plane.offset).max() < 1e-3


def test_two_sheets_that_are_nearly_parallel_become_one_and_a_step_beside_the_floor_stays():
    floor = noisy(lambda x, _: 0 * x)
    twice = sheet(lambda x, _: 0.05 + 0.01 * x, across=70)
    one, planes = flatten(beside(floor, (twice, (0.3, 0.3, 0.0))), CELL)
    assert len(planes) == 1
    assert len(one.vertices) < len(floor.vertices) + 0.1 * len(twice.vertices)
    step = noisy(lambda x, _: np.where(x < 0.8, 0.05, 0.0))
    after, planes = flatten(step, CELL)
    assert len(after.faces) == len(step.faces)
    assert len(planes) == 2


@pytest.mark.parametrize("high", [0.012, 0.04, 0.3])
def test_a_step_stays_as_high_as_it_was(high):
    """A mat of half a voxel, a threshold and a step, each 0.5 m broad, on a floor."""

    def steps(x, y):
        return np.where((np.abs(x - 1.0) < 0.25) & (np.abs(y - 1.0) < 0.7), high, 0.0)

    before = noisy(steps)
    after, _ = flatten(before, CELL)
    assert np.abs(after.vertices - before.vertices).max() < CELL
    x, y, z = after.vertices.T
    inner = (np.abs(x - 1.0) < 0.2) & (np.abs(y - 1.0) < 0.6)
    outer = (np.abs(x - 1.0) > 0.35) | (np.abs(y - 1.0) > 0.8)
    assert z[inner].mean() == pytest.approx(high, abs=0.0015)
    assert z[outer].mean() == pytest.approx(0.0, abs=0.0015)
    assert z[outer].std() < 0.001  # It was 0.002.


def test_a_small_top_becomes_flat_where_a_plane_was_supposed():
    """A box of 0.7 x 0.5 m on 4 x 4 m: too little of all to be looked for by its area."""

    def box(x, y):
        return np.where((np.abs(x - 1.0) < 0.35) & (np.abs(y - 1.0) < 0.25), 0.3, 0.0)

    rng = np.random.default_rng(3)
    before = sheet(lambda x, y: box(x, y) + rng.normal(0, 0.002, x.shape), across=200)
    flat, planes = flatten(before, CELL)
    top = (np.abs(flat.vertices[:, 0] - 1.0) < 0.2) & (np.abs(flat.vertices[:, 1] - 1.0) < 0.15)
    lids = [
        SupposedPlane(normal=np.array([0.0, 0.0, 1.0]), offset=z, prior=0.0, one_sided=False)
        for z in (0.3, 0.6)
    ]
    assert flat.vertices[top, 2].std() > 0.0015
    after, small = flatten_small(flat, planes, lids, CELL)
    (plane,) = small
    assert plane.offset == 0.3
    assert after.vertices[top, 2].std() < 0.0005
    assert flatten_small(flat, planes, [], CELL)[1] == []


def test_a_gentle_hill_is_no_floor():
    before = noisy(lambda x, y: 0.15 * np.exp(-4 * ((x - 1) ** 2 + (y - 1) ** 2)))
    after, _ = flatten(before, CELL)
    top = np.hypot(before.vertices[:, 0] - 1, before.vertices[:, 1] - 1) < 0.1
    assert after.vertices[top, 2].mean() == pytest.approx(before.vertices[top, 2].mean(), abs=0.002)


def test_flattening_again_gives_the_same_bits():
    mesh = noisy(lambda x, y: 0 * x * y)
    assert (flatten(mesh, CELL)[0].vertices == flatten(mesh, CELL)[0].vertices).all()


def test_crumbs_go_and_large_parts_stay():
    whole, side, crumb = (sheet(lambda x, y: 0 * x * y, n) for n in (30, 10, 3))
    kept, facts = large_parts(beside(whole, (side, (5, 0, 0)), (crumb, (0, 5, 0))), 0.05)
    assert (facts.kept, facts.dropped) == (2, 1)
    assert facts.dropped_area == pytest.approx(9 / (900 + 100 + 9))
    assert len(kept.faces) == 2 * (900 + 100)
    assert len(kept.vertices) == len(whole.vertices) + len(side.vertices)


@pytest.mark.parametrize(
    ("across", "flat", "stays"),
    [(30, 0.6, True), (30, 0.4, False), (10, 0.6, False), (10, 0.9, True)],
)
def test_a_platform_that_hangs_together_with_nothing_stays(across, flat, stays):
    """Half of what a foot has room on suffices; of a crumb it takes nearly all."""
    ground, island = (sheet(lambda x, y: 0 * x * y, n) for n in (200, across))
    count = len(ground.vertices)
    mesh = beside(ground, (island, (5, 0, 0.4)))
    on_plane = np.ones(len(mesh.vertices), dtype=bool)
    on_plane[count + round(flat * len(island.vertices)) :] = False
    kept, _ = large_parts(mesh, 0.05, on_plane, room=480 * CELL**2)
    assert (len(kept.faces) == len(mesh.faces)) == stays


def test_holes_are_reported_with_size_and_place():
    mesh = sheet(lambda x, y: 0 * x * y, 50)
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    gone = (np.abs(middle[:, 0] - 0.5) < 0.1) & (np.abs(middle[:, 1] - 0.3) < 0.06)
    rim, hole = holes(mesh.keep(~gone))
    assert rim.length == pytest.approx(4.0)
    assert rim.across == pytest.approx(np.sqrt(2.0))
    assert hole.length == pytest.approx(2 * (0.2 + 0.12))
    assert hole.centre == pytest.approx((0.5, 0.3, 0.0))


def test_simplifying_keeps_a_step_and_spends_few_faces_on_what_is_flat():
    before = sheet(lambda x, y: np.where(x > 1.0, 0.2, 0.0) + 0 * y)
    after = simplify(before, 1000)
    assert len(after.faces) <= 1000
    x, _, z = after.vertices.T
    assert np.abs(z - np.where(x > 1.01, 0.2, 0.0)).max() < 1e-4
    assert (after.colours == np.where(x[:, None] > 1.0, 200, 50)).mean() > 0.95
    # All of what it was.
    assert np.linalg.norm(after.normals, axis=1).sum() == pytest.approx(
        np.linalg.norm(before.normals, axis=1).sum(), rel=5e-3
    )


def test_meshes_are_read_as_they_were_written(tmp_path):
    mesh = sheet(lambda x, y: x * y, 5)
    write_mesh(mesh, tmp_path / "mesh.ply")
    again = read_colour_mesh(tmp_path / "mesh.ply")
    assert again.vertices == pytest.approx(mesh.vertices, abs=1e-6)
    assert (again.faces == mesh.faces).all()
    assert (again.colours == mesh.colours).all()
    (tmp_path / "cut.ply").write_bytes((tmp_path / "mesh.ply").read_bytes()[:-200])
    with pytest.raises(SceneError, match=r"cut\.ply"):
        read_colour_mesh(tmp_path / "cut.ply")
