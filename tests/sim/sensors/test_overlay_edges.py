"""Outlines of drawn objects are soft: their pixels are covered in part."""

import numpy as np

from nw_scenes.mesh import cone_mesh
from nw_sim.sensors.drawing.overlay import Cones, draw, ray_directions
from nw_splat.camera import Camera, Pixels, look_at

WAYPOINTS = np.array([[0.6, 0.02, 0.0], [1.1, -0.1, 0.0]])
WIDTH = 64


def camera_of(width):
    T = look_at((0.0, 0.0, 0.15), (1.0, 0.05, 0.1))
    return Camera.from_fovy(width=width, height=width, fovy=0.9, T_world_camera=T)


def overlay(width, *, soft):
    camera = camera_of(width)
    pitch = (1.0 / camera.fx, 1.0 / camera.fy) if soft else None
    return draw(
        ray_directions(camera, Pixels()), camera.T_world_camera,
        cones=Cones(WAYPOINTS), robot=None, pitch=pitch,
    )  # fmt: skip


def finer(times):
    """Return hard edges' coverage and depth in each pixel's `times` squared parts, (H, W, n)."""
    fine = overlay(WIDTH * times, soft=False)
    split = (WIDTH, times, WIDTH, times)
    return (
        image.reshape(split).swapaxes(1, 2).reshape(WIDTH, WIDTH, -1)
        for image in (fine.coverage, fine.depth)
    )


def eroded(mask):
    """Return the pixels of a mask (H, W) that have no side in common with one outside it."""
    kept = mask.copy()
    kept[1:] &= mask[:-1]
    kept[:-1] &= mask[1:]
    kept[:, 1:] &= mask[:, :-1]
    kept[:, :-1] &= mask[:, 1:]
    return kept


def clip(polygon, side):
    """Return what of a polygon (N, 3) lies on the positive side of a plane through the eye."""
    kept = []
    for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        a, b = side @ here, side @ there
        if a >= 0.0:
            kept.append(here)
        if a * b < 0.0:
            kept.append(here + (there - here) * (a / (a - b)))
    return np.array(kept).reshape(-1, 3)


def depths_of_surfaces():
    """Return least and greatest depth, each (H, W), of what faces the camera in each pixel.

    Each triangle is cut at the four planes of a pixel's sides: no ray is cast.
    """
    camera = camera_of(WIDTH)
    T = camera.T_world_camera
    corners = np.concatenate([cone_mesh().mesh.triangles + place for place in WAYPOINTS])
    faces = (corners - T[:3, 3]) @ T[:3, :3]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    least, most = np.full((WIDTH, WIDTH), np.inf), np.full((WIDTH, WIDTH), -np.inf)
    for face in faces[(normals * faces[:, 0]).sum(axis=1) < 0.0]:
        shown = face[:, :2] / face[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        low, high = np.floor(shown.min(axis=0)).astype(int), np.floor(shown.max(axis=0)).astype(int)
        for column, row in (low + step for step in np.ndindex(*(high - low + 1))):
            left, right = (np.array([column, column + 1]) - camera.cx) / camera.fx
            top, bottom = (np.array([row, row + 1]) - camera.cy) / camera.fy
            piece = face
            for side in ((1, 0, -left), (-1, 0, right), (0, 1, -top), (0, -1, bottom)):
                piece = clip(piece, np.array(side))
            if len(piece):
                least[row, column] = min(least[row, column], piece[:, 2].min())
                most[row, column] = max(most[row, column], piece[:, 2].max())
    return least, most


def test_the_coverage_of_an_outline_is_that_of_many_rays():
    many = next(finer(12)).mean(axis=2)
    soft = overlay(WIDTH, soft=True).coverage
    hard = overlay(WIDTH, soft=False).coverage
    assert set(np.unique(hard)) == {0.0, 1.0}
    partly = (soft > 0.0) & (soft < 1.0)
    assert partly.sum() > 50
    # Nine rays cannot be off by more than about two of them, and mean far less.
    assert np.abs(soft - many)[partly].max() < 0.3
    assert np.abs(soft - many).mean() < 0.35 * np.abs(hard - many).mean()


def test_an_outlines_pixel_is_the_mean_of_a_picture_three_times_as_fine():
    soft, covered = overlay(WIDTH, soft=True), overlay(WIDTH, soft=False).coverage > 0.0
    coverage, depth = finer(3)
    outline = ~(eroded(covered) | eroded(~covered))
    np.testing.assert_allclose(soft.coverage[outline], coverage.mean(axis=2)[outline], atol=1e-6)
    met = outline & (soft.coverage > 0.0)
    assert met.sum() > 100
    mean = np.where(coverage > 0.0, depth, 0.0).sum(axis=2)[met] / coverage.sum(axis=2)[met]
    np.testing.assert_allclose(soft.depth[met], mean, rtol=1e-6)


def test_depth_in_a_pixel_is_one_that_a_surface_has_there():
    least, most = depths_of_surfaces()
    drawn = overlay(WIDTH, soft=True)
    met = drawn.coverage > 0.0
    assert (drawn.depth[met] > least[met] - 1e-6).all()
    assert (drawn.depth[met] < most[met] + 1e-6).all()
    # The bound says something: half of these pixels' surfaces are less than 2 cm deep.
    assert np.median((most - least)[met]) < 0.02


def test_soft_edges_change_nothing_inside_and_nothing_outside():
    soft, hard = overlay(WIDTH, soft=True), overlay(WIDTH, soft=False)
    inside = eroded(hard.coverage > 0.0)
    assert inside.sum() > 200
    outside = eroded(hard.coverage == 0.0)
    for image in ("coverage", "depth", "rgb"):
        one, other = getattr(soft, image), getattr(hard, image)
        np.testing.assert_array_equal(one[inside | outside], other[inside | outside])
    empty = soft.coverage == 0.0
    assert np.isinf(soft.depth[empty]).all()
    np.testing.assert_array_equal(soft.rgb[empty], 0.0)
