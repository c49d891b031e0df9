"""Exact depth maps of rectangles become one sheet each, whole, and no farther than its edge."""

import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from room_figures import heights

from nw_base.errors import SceneError
from nw_splat.camera import Camera, look_at
from nw_twin.reconstruct.depth import DepthMap
from nw_twin.reconstruct.surface import samples, surface
from nw_twin.reconstruct.views import WorkingView

WIDTH, HEIGHT = 160, 90
DECK = 0.4
FLOOR = (2, 0.0, (-9.0, -9.0), (9.0, 9.0))
PLATFORM = (
    FLOOR,
    (2, DECK, (0.0, -0.5), (1.0, 0.5)),
    (0, 0.0, (-0.5, 0.0), (0.5, DECK)),
    (0, 1.0, (-0.5, 0.0), (0.5, DECK)),
)
"""Rectangles square to an axis: axis, place along it, and the other coordinates' ends; metres."""


def seen_from(eye, target, rectangles, *, noise=0.0, hidden=None, farthest=12.0):
    """The depths and normals of rectangles; none where a function of a point's x, y, z says so."""
    eye, T = np.array(eye, float), look_at(np.array(eye), np.array(target))
    camera = Camera.from_fovy(width=WIDTH, height=HEIGHT, fovy=np.radians(45.0), T_world_camera=T)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 0 * x + 1], -1)
    rays = local @ T[:3, :3].T
    depth, normal = np.full(x.shape, np.inf), np.zeros(rays.shape)
    for axis, place, low, high in rectangles:
        along = (place - eye[axis]) / rays[..., axis]
        at = np.delete(eye + along[..., None] * rays, axis, axis=-1)
        hit = (along > 0) & (along < depth) & ((at > low) & (at < high)).all(axis=-1)
        depth[hit] = along[hit]
        normal[hit] = np.eye(3)[axis] * np.sign(eye[axis] - place)
    known = depth < farthest
    if hidden is not None:
        points = eye + np.where(known, depth, 0.0)[..., None] * rays
        known &= ~hidden(*np.moveaxis(points, -1, 0))
    rng = np.random.default_rng(int(1000 * abs(eye).sum()))
    depth = np.where(known, depth, 0.0) * (1.0 + noise * rng.normal(size=depth.shape))
    view = WorkingView(
        name=f"{eye}",
        rgb=np.full((HEIGHT, WIDTH, 3), 120, np.uint8),
        mask=None,
        K=np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]]),
        T_camera_world=camera.T_camera_world,
    )
    return DepthMap(
        view=view,
        depth=depth.astype(np.float32),
        confidence=np.where(known, 0.5, 0.0).astype(np.float32),
        normal=np.where(known[..., None], normal @ T[:3, :3], 0.0).astype(np.float32),
    )


def surface_of(maps, voxel=0.03):
    return surface(maps, voxel, 100_000, lambda _: None)


def test_ground_that_few_grazing_looks_show_is_one_sheet():
    maps = [seen_from((0, y, 1.5), (6, y / 2, 0.3), [FLOOR], noise=0.01) for y in (-0.6, 0.0, 0.6)]
    first, second, _ = heights(surface_of(maps, 0.06), np.arange(3, 6, 0.1), np.arange(-1, 1, 0.1))
    assert np.isfinite(first).mean() > 0.99
    assert np.isfinite(second).mean() < 0.01
    assert np.median(np.abs(first[np.isfinite(first)])) < 0.01


@pytest.fixture(scope="module")
def platform():
    """Of four views from before the platform, from low, and two from above."""
    eyes = [(-2.2, -0.3, 1.0), (-2.2, 0.0, 1.2), (-2.2, 0.3, 1.0), (2.6, 0.2, 1.4)]
    return surface_of(
        [seen_from(eye, (0.5, 0.0, 0.3), PLATFORM) for eye in (*eyes, (0.2, -0.2, 2.2))], 0.02
    )


def test_a_top_that_is_seen_at_a_slant_has_no_slits(platform):
    top = heights(platform, np.arange(0.06, 0.95, 0.02), np.arange(-0.44, 0.45, 0.02))[0]
    assert (np.abs(top - DECK) < 0.005).mean() > 0.97


def test_a_top_ends_where_the_platform_does(platform):
    beyond = heights(platform, np.arange(1.03, 1.3, 0.02), np.arange(-0.4, 0.4, 0.02))[0]
    assert not (beyond > 0.5 * DECK).any()


@pytest.mark.nightly
def test_many_views_from_afar_do_not_lengthen_a_top_that_two_near_ones_end():
    """Beside an edge pixels are taken for those of the surface before it: from afar, decimetres."""
    longer = [FLOOR, (2, DECK, (0.0, -0.5), (1.1, 0.5))]
    far = [seen_from((-4.0, y, 1.2), (0.5, 0.0, 0.3), longer) for y in np.linspace(-0.6, 0.6, 6)]
    near = [seen_from((0.2, y, 1.5), (0.5, 0.0, 0.3), PLATFORM) for y in (-0.2, 0.2)]
    mesh = surface_of([*far, *near], 0.03)
    beyond = heights(mesh, np.arange(1.06, 1.3, 0.01), [-0.2, 0.0, 0.2])[0]
    assert not (beyond > 0.5 * DECK).any()


EYES = [(-1.5, 0.0, 1.5), (1.5, 0.3, 1.6), (0.0, -1.5, 1.4), (0.2, 1.5, 1.5)]


def pit(x, y, _z):
    return x**2 + y**2 < 0.3**2


def test_a_hole_of_flat_ground_that_nothing_is_known_of_is_filled():
    maps = [seen_from(eye, (0, 0, 0), [FLOOR], hidden=pit) for eye in EYES]
    span = np.arange(-0.2, 0.21, 0.02)
    assert np.abs(heights(surface_of(maps), span, span)[0]).max() < 0.02


def test_a_hole_that_photographs_look_through_stays_open():
    """A floor 25 cm down shows in it; its sides do not."""
    sides = [(-9, -9, 9, -0.3), (-9, 0.3, 9, 9), (-9, -0.3, -0.3, 0.3), (0.3, -0.3, 9, 0.3)]
    deck = [(2, 0.0, (a, b), (c, d)) for a, b, c, d in sides]
    below = (2, -0.25, (-2.0, -2.0), (2.0, 2.0))
    mesh = surface_of([seen_from(eye, (0, 0, 0), [*deck, below]) for eye in EYES])
    span = np.arange(-0.2, 0.21, 0.02)
    top = heights(mesh, span, span)[0]
    assert not (top > -0.2).any()
    assert (np.abs(top + 0.25) < 0.02).mean() > 0.5, "and its floor is there"


def test_a_sky_between_two_houses_has_no_faces():
    street = [FLOOR, (1, -2.0, (-6.0, 0.0), (6.0, 3.0)), (1, 2.0, (-6.0, 0.0), (6.0, 3.0))]
    eyes = [(-4.0 + n, 0.2 * (-1) ** n, 1.5) for n in range(4)]
    mesh = surface_of([seen_from(eye, (4, 0, 1.5), street) for eye in eyes], 0.06)
    assert mesh.vertices[:, 2].max() < 3.0 + 0.4, "a cell and a half of 24 cm"
    inside = np.abs(mesh.vertices[:, 1]) < 1.8
    assert np.abs(mesh.vertices[inside, 2]).max() < 0.1, "what is between them is ground"
    assert (mesh.vertices[~inside, 2] > 2.0).any(), "and houses stand beside it"


def test_a_cell_of_what_is_near_is_finer_than_one_of_what_is_far():
    found = samples([seen_from((0, 0, 1.5), (6, 0, 0.3), [FLOOR])], 0.06)
    far = found.points[:, 0] > np.median(found.points[:, 0])
    assert found.cells[~far].mean() < 0.7 * found.cells[far].mean()
    assert set(found.cells) <= {found.finest * 2**n for n in range(4)}


def test_too_many_points_are_refused_with_what_to_give():
    maps = [seen_from((0, 0, 1.5), (6, 0, 0.3), [FLOOR])]
    with pytest.raises(
        SceneError, match=r"points, 100 are allowed; give a larger voxel than 0\.06"
    ):
        surface(maps, 0.06, 100, lambda _: None)


@pytest.mark.parametrize("side", [0.0, 0.02, 0.3])
def test_depths_of_next_to_nothing_are_refused_or_become_what_they_show(side):
    def elsewhere(x, y, _z):
        return (np.abs(x) > side) | (np.abs(y) > side)

    maps = [seen_from(eye, (0, 0, 0), [FLOOR], hidden=elsewhere) for eye in EYES]
    if side < 0.1:
        with pytest.raises(SceneError, match=r"no depth is known|no surface in common"):
            surface_of(maps)
    else:
        assert np.abs(surface_of(maps).vertices).max() < side + 0.2


def _digest():
    mesh = surface_of([seen_from(eye, (0, 0, 0), PLATFORM) for eye in EYES])
    parts = (mesh.vertices, mesh.faces, mesh.colours)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()


@pytest.mark.nightly
def test_another_process_gives_the_same_bytes_and_open3d_says_nothing():
    words = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import test_surface"
    done = subprocess.run(
        [sys.executable, "-c", f"{words}; sys.stderr.write(test_surface._digest())"],
        capture_output=True,
        check=True,
        text=True,
    )
    assert done.stdout == ""
    assert done.stderr == _digest()
