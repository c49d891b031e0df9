"""Holes of planes are filled where somebody looked at them and nobody looked through."""

import numpy as np
import pytest

from nw_eval.twin.reconstruct.clean import FlatPlane
from nw_eval.twin.reconstruct.complete import complete
from nw_eval.twin.reconstruct.depth import DepthMap
from nw_eval.twin.reconstruct.mesh import ColourMesh
from nw_eval.twin.reconstruct.views import WorkingView

CELL = 0.02
FLOOR = FlatPlane(normal=(0.0, 0.0, 1.0), offset=0.0, area=4.0, noise=0.0, moved=1.0)


def floor(is_known):
    """A floor of 2 x 2 m at z = 0 with the cells that a function of x and y says are known."""
    x, y = np.meshgrid(*(np.arange(101) * CELL,) * 2, indexing="ij")
    first = (np.arange(100)[:, None] * 101 + np.arange(100)).ravel()
    a, b, c, d = first, first + 101, first + 102, first + 1
    middle_x, middle_y = (grid[:-1, :-1].ravel() + CELL / 2 for grid in (x, y))
    known = is_known(middle_x, middle_y)
    faces = [np.stack([a, b, c], 1)[known], np.stack([a, c, d], 1)[known]]
    mesh = ColourMesh(
        vertices=np.stack([x, y, 0 * x], -1).reshape(-1, 3),
        faces=np.concatenate(faces).astype(np.int32),
        colours=np.full((101 * 101, 3), 90, np.uint8),
    )
    return mesh.keep(np.ones(len(mesh.faces), bool))


def over(mesh, left, right):
    """A mesh over one more floor, 0.4 m lower, from one x to another."""
    lower = floor(lambda x, y: (x < 1.0) & (y < 1.0))
    x, y, z = lower.vertices.T
    moved = np.stack([left + x * (right - left), y, z - 0.4], axis=1)
    return ColourMesh(
        vertices=np.concatenate([mesh.vertices, moved]),
        faces=np.concatenate([mesh.faces, lower.faces + len(mesh.vertices)]),
        colours=np.concatenate([mesh.colours, lower.colours]),
    )


def look_down(depth, count=3):
    """Maps of cameras 2 m over the floor's middle that look straight down at (80, 90, 200)."""
    T = np.array([[1, 0, 0, -1.0], [0, -1, 0, 1.0], [0, 0, -1, 2.0], [0, 0, 0, 1]])
    K = np.array([[60.0, 0, 50], [0, 60, 50], [0, 0, 1]])
    rgb = np.full((100, 100, 3), (80, 90, 200), np.uint8)
    return [
        DepthMap(
            view=WorkingView(name=f"{n}", rgb=rgb, mask=None, K=K, T_camera_world=T),
            depth=np.full((100, 100), depth, np.float32),
            confidence=np.ones((100, 100), np.float32),
            normal=np.zeros((100, 100, 3), np.float32),
        )
        for n in range(count)
    ]


def round_hole(x, y):
    return (x - 1.0) ** 2 + (y - 1.0) ** 2 > 0.3**2


def test_a_hole_that_nobody_knows_the_depth_of_is_filled_in_the_colour_that_is_seen():
    mesh, area = complete(floor(round_hole), [FLOOR], look_down(0.0), CELL)
    assert np.pi * 0.3**2 < area < np.pi * 0.4**2, "and a cell beyond its edge"
    added = mesh.vertices[len(floor(round_hole).vertices) :]
    np.testing.assert_allclose(added[:, 2], 0.0, atol=1e-12)
    assert (mesh.normals[:, 2] > 0.0).all(), "the same side is up"
    middle = np.argmin(np.linalg.norm(mesh.vertices - (1.0, 1.0, 0.0), axis=1))
    assert mesh.colours[middle].tolist() == [80, 90, 200]
    assert mesh.colours.min() >= 80, "nothing is black at the seams"


@pytest.mark.parametrize(("depth", "views"), [(2.4, 3), (1.5, 3), (0.0, 1)])
def test_a_hole_of_a_deck_that_is_looked_through_or_hidden_or_seen_once_stays(depth, views):
    before = over(floor(round_hole), 2.1, 3.1)
    mesh, area = complete(before, [FLOOR], look_down(depth, views), CELL)
    assert area == 0.0
    assert len(mesh.faces) == len(before.faces)


def test_a_floor_goes_on_where_it_is_hidden():
    before = floor(round_hole)
    mesh, area = complete(before, [FLOOR], look_down(1.5), CELL)
    assert np.pi * 0.3**2 < area < np.pi * 0.4**2
    middle = np.argmin(np.linalg.norm(mesh.vertices - (1.0, 1.0, 0.0), axis=1))
    assert mesh.colours[middle].tolist() == [90, 90, 90], "as the floor that was seen"
    assert complete(before, [FLOOR], look_down(2.4), CELL)[1] == 0.0, (
        "but not if it is seen through"
    )


def test_a_trench_in_a_floor_stays_open_where_its_bottom_shows():
    trench = floor(lambda x, _: np.abs(x - 1.0) > 0.3)
    shows = over(trench, 0.95, 1.05)
    shows = shows.keep(np.arange(len(shows.faces)) < len(trench.faces) + 60)
    mesh, _ = complete(shows, [FLOOR], look_down(0.0), CELL)
    lid = (np.abs(mesh.vertices[:, 0] - 1.0) < 0.05) & (np.abs(mesh.vertices[:, 2]) < 0.01)
    assert lid.any(), "where nothing shows, it is closed as a floor is"
    assert mesh.vertices[lid, 1].min() > 0.005


def test_a_gap_right_across_a_deck_is_no_hole():
    gap = over(floor(lambda x, _: np.abs(x - 1.0) > 0.3), 2.1, 3.1)
    mesh, area = complete(gap, [FLOOR], look_down(0.0), CELL)
    inner = np.abs(mesh.vertices[:, 0] - 1.0) < 0.2
    assert not (inner & (np.abs(mesh.vertices[:, 1] - 1.0) < 0.8)).any()
    assert area < 0.1


def test_a_small_plane_goes_on_through_its_hole_and_no_farther():
    holed, area = complete(floor(round_hole), [], look_down(0.0), CELL, small=[FLOOR])
    assert np.pi * 0.3**2 < area < 1.5 * np.pi * 0.3**2
    assert len(holed.faces) > len(floor(round_hole).faces)

    def ell(x, y):
        return (x < 0.5) | (y < 0.5)

    assert complete(floor(ell), [FLOOR], look_down(0.0), CELL)[1] > 0.5, "a floor bounds a place"
    assert complete(floor(ell), [], look_down(0.0), CELL, small=[FLOOR])[1] < 0.05
