"""Depth maps that graze a platform become its top, whole and no farther than its edge."""

import numpy as np
import pytest

from nw_eval.scenes.mesh import FACE_KINDS, TriangleMesh
from nw_eval.scenes.rays import RayScene
from nw_eval.splat.camera import Camera, look_at
from nw_eval.twin.reconstruct.depth import DepthMap
from nw_eval.twin.reconstruct.surface import extract, fuse
from nw_eval.twin.reconstruct.views import WorkingView

VOXEL, DECK = 0.02, 0.4
LOW, HIGH = np.array([0.0, -0.5, 0.0]), np.array([1.0, 0.5, DECK])
"""Corners of a platform on a floor at z = 0, metres."""


def seen_from(eye, end=1.0):
    """The exact depths of the platform, to an end along x, and the floor."""
    eye = np.array(eye)
    T = look_at(eye, np.array([0.5, 0.0, 0.3]))
    camera = Camera.from_fovy(width=320, height=180, fovy=np.radians(45.0), T_world_camera=T)
    x, y = np.meshgrid(np.arange(320) + 0.5, np.arange(180) + 0.5)
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 0 * x + 1], -1)
    rays = local @ T[:3, :3].T
    to_low, to_high = (LOW - eye) / rays, ((end, *HIGH[1:]) - eye) / rays
    enter, leave = np.minimum(to_low, to_high), np.maximum(to_low, to_high)
    hit = (enter.max(axis=-1) > 0) & (enter.max(axis=-1) < leave.min(axis=-1))
    depth = np.where(hit, enter.max(axis=-1), -eye[2] / rays[..., 2])
    depth = np.where((depth > 0) & (depth < 6.0), depth, 0.0).astype(np.float32)
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    view = WorkingView(
        name=f"{eye}",
        rgb=np.full((180, 320, 3), 120, np.uint8),
        mask=None,
        K=K,
        T_camera_world=camera.T_camera_world,
    )
    sure, normal = np.full(depth.shape, 0.5, np.float32), np.zeros((*depth.shape, 3), np.float32)
    return DepthMap(view=view, depth=depth, confidence=sure, normal=normal)


def heights_of(maps):
    """Heights of the mesh of some maps, by x and y."""
    mesh = extract(fuse(maps, VOXEL, 100_000, lambda _: None, threads=1), 0.5)
    kinds = np.full(len(mesh.faces), FACE_KINDS.index("ground"), np.uint8)
    rays = RayScene(TriangleMesh(vertices=mesh.vertices, faces=mesh.faces, kinds=kinds))

    def at(x, y):
        x, y = np.meshgrid(x, y)
        return rays.height(np.column_stack([x.ravel(), y.ravel()]))

    return at


@pytest.fixture(scope="module")
def heights():
    """Of three views from before the platform, from low: the top is seen at a slant."""
    return heights_of([seen_from((-2.2, y, 1.0)) for y in (-0.3, 0.0, 0.3)])


def test_a_top_that_is_seen_at_a_slant_has_no_slits(heights):
    found = heights(np.arange(0.1, 0.95, 0.01), np.arange(-0.4, 0.4, 0.01))
    assert (np.abs(found - DECK) < 0.25 * VOXEL).mean() > 0.97


def test_a_top_ends_where_the_platform_does(heights):
    beyond = heights(np.arange(1.0 + 1.1 * VOXEL, 1.3, 0.01), np.arange(-0.4, 0.4, 0.01))
    assert not (beyond > 0.5 * DECK).any()


def test_many_views_from_afar_do_not_lengthen_a_top_that_two_near_ones_end():
    """Beside an edge pixels are taken for those of the surface before it: from afar, decimetres."""
    far = [seen_from((-4.0, y, 1.2), end=1.1) for y in np.linspace(-0.6, 0.6, 6)]
    near = [seen_from((0.2, y, 1.5)) for y in (-0.2, 0.2)]
    beyond = heights_of([*far, *near])(np.arange(1.0 + 2.6 * VOXEL, 1.3, 0.01), [-0.2, 0.0, 0.2])
    assert not (beyond > 0.5 * DECK).any()
