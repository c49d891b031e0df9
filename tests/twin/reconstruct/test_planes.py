"""What is plain is measured by the planes that edges around it show."""

from dataclasses import replace

import numpy as np
import pytest
from twin_parts import grid, joined

from nw_splat.camera import Camera, look_at
from nw_twin.reconstruct import planes as supposing
from nw_twin.reconstruct.depth import DepthMap
from nw_twin.reconstruct.planar import labelled, planar_maps
from nw_twin.reconstruct.planes import Measured, SupposedPlane, hypotheses
from nw_twin.reconstruct.surface import ColourMesh
from nw_twin.reconstruct.views import WorkingView

DECK, LOW, HIGH = 0.3, np.array([-0.5, -0.5]), np.array([0.5, 0.5])
"""A platform, metres: the height of its top, and two of its corners."""

FLOOR = SupposedPlane(normal=np.array([0.0, 0.0, 1.0]), offset=0.0, prior=0.0, one_sided=True)
TOP = SupposedPlane(normal=np.array([0.0, 0.0, 1.0]), offset=DECK, prior=0.0, one_sided=True)
SIDES = [
    SupposedPlane(normal=sign * np.eye(3)[axis], offset=0.5, prior=0.05, one_sided=True)
    for axis in (0, 1)
    for sign in (-1.0, 1.0)
]
PLANES = [FLOOR, TOP, *SIDES]


def photographed(eye):
    """A plain brown box on a plain blue floor by exact rays: colours, and true depths."""
    T = look_at(np.array(eye), np.array([0.0, 0.0, 0.15]))
    camera = Camera.from_fovy(width=160, height=90, fovy=np.radians(50.0), T_world_camera=T)
    x, y = np.meshgrid(np.arange(160) + 0.5, np.arange(90) + 0.5)
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 0 * x + 1], -1)
    rays = local @ T[:3, :3].T
    box_low, box_high = np.array([*LOW, 0.0]), np.array([*HIGH, DECK])
    to_low, to_high = (box_low - eye) / rays, (box_high - eye) / rays
    enter = np.minimum(to_low, to_high)
    first, face = enter.max(axis=-1), enter.argmax(axis=-1)
    hit = (first > 0) & (first < np.maximum(to_low, to_high).min(axis=-1))
    depth = np.where(hit, first, -eye[2] / rays[..., 2])
    colours = np.array([[96, 70, 40], [110, 82, 50], [140, 104, 64], [50, 70, 130]])
    rgb = colours[np.where(hit, face, 3)].astype(np.uint8)
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    view = WorkingView(name=f"{eye}", rgb=rgb, mask=None, K=K, T_camera_world=camera.T_camera_world)
    return view, depth.astype(np.float32)


def near_an_edge(view):
    grey = view.grey
    change = np.abs(np.gradient(grey)[0]) + np.abs(np.gradient(grey)[1])
    return change > 2.0


@pytest.fixture(scope="module")
def walk():
    """Views from around the box; depth is known at edges of the picture alone, as it is."""
    eyes = [(1.9 * np.cos(a), 1.9 * np.sin(a), 1.5) for a in np.radians(np.arange(0, 360, 30))]
    maps, truth = [], []
    for eye in eyes:
        view, depth = photographed(eye)
        known = np.where(near_an_edge(view), depth, 0.0).astype(np.float32)
        sure = (known > 0).astype(np.float32)
        none = np.zeros((*known.shape, 3), np.float32)
        maps.append(DepthMap(view=view, depth=known, confidence=sure, normal=none))
        truth.append(depth)
    count = len(eyes)
    near = [[(n + step) % count for step in (1, count - 1, 2, count - 2)] for n in range(count)]
    return maps, near, truth


def whole(walk, planes):
    maps, near, truth = walk
    found = planar_maps(maps, near, planes, lambda _: None, threads=1)
    known = np.concatenate([each.depth.ravel() > 0 for each in found])
    depth = np.concatenate([each.depth.ravel() for each in found])
    right = np.abs(depth / np.concatenate([each.ravel() for each in truth]) - 1.0) < 0.02
    return found, float(known.mean()), float(right[known].mean())


def test_plain_faces_get_the_depth_of_their_planes(walk):
    before = np.mean([(each.depth > 0).mean() for each in walk[0]])
    _, known, right = whole(walk, PLANES)
    assert before < 0.05
    assert known > 0.5
    assert right > 0.93


def test_a_plane_that_is_not_there_is_shown_by_nobody(walk):
    lid = SupposedPlane(normal=TOP.normal, offset=0.6, prior=0.0, one_sided=True)
    _, known, right = whole(walk, [*PLANES, lid])
    assert known > 0.5
    assert right > 0.93


def test_nothing_is_invented_without_planes(walk):
    maps, near, _ = walk
    found = planar_maps(maps, near, [], lambda _: None)
    assert all((a.depth == b.depth).all() for a, b in zip(maps, found, strict=True))


def test_any_number_of_threads_gives_the_same_bits(walk):
    maps, near, _ = walk
    one = planar_maps(maps, near, PLANES, lambda _: None, threads=1)
    two = planar_maps(maps, near, PLANES, lambda _: None, threads=2)
    for a, b in zip(one, two, strict=True):
        assert a.depth.tobytes() == b.depth.tobytes()
        assert a.confidence.tobytes() == b.confidence.tobytes()


def test_the_plain_top_of_a_striped_ramp_is_supposed(monkeypatch):
    """Its rim is few points among the many of stripes at all heights of the slope."""
    voxel, high = 0.02, 0.27
    parts = [
        grid((0, 0, 0), (4, 0, 0), (0, 3, 0), (200, 150)),
        grid((0, 3, 0), (4, 0, 0), (0, 0, 1.5), (200, 75)),
        grid((1, 1, 0), (1.1, 0, high), (0, 1.2, 0), (57, 60)),
    ]
    vertices, faces = joined(*parts)
    surface = ColourMesh(vertices=vertices, faces=faces, colours=np.zeros(vertices.shape, np.uint8))
    rng = np.random.default_rng(0)
    share, side = rng.random((2, 40_000))
    stripes = np.column_stack([1 + 1.1 * share, 1 + 1.2 * side, high * share])
    joints = np.column_stack([4 * side, 3 * share, 0 * share])
    rim = np.column_stack([2.1 + 0.7 * share, 1 + 1.2 * side.round(), 0 * share + high])[:1500]
    about = rng.uniform((0, 0, 0.05), (4, 2.9, 1.5), (4000, 3))
    drawn = np.concatenate([stripes, joints, rim, about]) + rng.normal(0, 0.004, (85_500, 3))
    monkeypatch.setattr(supposing, "_points_of_edges", lambda _: drawn)
    none = Measured(points=np.empty((0, 3)), normals=np.empty((0, 3)), weight=np.empty(0))
    monkeypatch.setattr(Measured, "of", lambda _: none)
    found = hypotheses(surface, [None], voxel)
    level = [plane.offset for plane in found if abs(plane.normal[2]) > 0.999]
    assert np.abs(np.abs(level) - high).min() < 0.25 * voxel


def test_a_plane_lies_where_pixels_are_and_not_where_a_leaning_one_was_found():
    maps = []
    for eye in ((1.5, 0.2, 1.2), (-0.4, 1.6, 1.3)):
        view, depth = photographed(eye)
        floor = -eye[2] / (rays_of(view) @ [0.0, 0.0, 1.0])
        known = np.where(np.abs(depth - floor) < 1e-4, depth, 0.0).astype(np.float32)
        noise = np.random.default_rng(0).normal(1.0, 0.001, depth.shape)
        up = np.broadcast_to(view.T_camera_world[:3, 2].astype(np.float32), (*depth.shape, 3))
        sure = (known > 0).astype(np.float32)
        depth = (known * noise).astype(np.float32)
        maps.append(DepthMap(view=view, depth=depth, confidence=sure, normal=up))
    leaning = np.array([np.sin(0.007), 0.0, np.cos(0.007)])
    normal, offset = Measured.of(maps).fitted(leaning, 0.012, voxel=0.03)
    assert np.degrees(np.arccos(min(1.0, normal[2]))) < 0.02
    assert abs(offset) < 0.0003


def rays_of(view):
    """Directions (H, W, 3) of a view's pixels in the world, 1 along the optical axis."""
    height, width = view.size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    local = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(view.K).T
    return local @ view.T_camera_world[:3, :3]


@pytest.mark.parametrize(("grey", "shown"), [(118, True), (70, False)])
def test_edges_alone_make_no_ground_of_a_stripe_that_is_darker_than_all_about_it(grey, shown):
    """The gap between two rims looks like a stripe 5 cm below them, as the ground far off is."""
    maps = []
    for eye in ((0.3, -1.5, 1.2), (-0.3, -1.5, 1.2), (0.0, -1.4, 1.3)):
        view, _ = photographed(eye)
        depth = (-eye[2] / (rays_of(view) @ [0.0, 0.0, 1.0])).astype(np.float32)
        lower = 1.0 + 0.05 / eye[2]
        at = np.array(eye) + depth[..., None] * rays_of(view)
        stripe = np.abs(at[..., 1]) < 0.15
        rgb = np.where(stripe[..., None], grey, 120).astype(np.uint8) * np.ones(3, np.uint8)
        known = np.where(stripe, 0.0, np.where(at[..., 1] > 0.8, lower * depth, depth))
        known = known.astype(np.float32)
        maps.append(
            DepthMap(
                view=replace(view, rgb=rgb),
                depth=known,
                confidence=(known > 0).astype(np.float32),
                normal=np.zeros((*known.shape, 3), np.float32),
            )
        )
    plane = SupposedPlane(normal=FLOOR.normal, offset=-0.05, prior=0.0, one_sided=False)
    found = labelled(maps[2], maps[:2], [plane], farthest=9.0)
    assert bool(found.planar[stripe].mean() > 0.5) is shown
