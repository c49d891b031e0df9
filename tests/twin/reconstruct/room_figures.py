"""How a mesh compares with the room: by the room's exact distances."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from small_room import STEPS, distance_to_room, is_seen, spread

from nw_scenes.mesh import FACE_KINDS, TriangleMesh
from nw_scenes.rays import RayScene


@dataclass(frozen=True)
class Figures:
    """Metres and shares. `recall` counts what two cameras see."""

    accuracy: float
    precision: float
    recall: float

    @property
    def f(self):
        return 2 * self.precision * self.recall / (self.precision + self.recall)


def sampled(mesh, count):
    """Points on a mesh, by area."""
    rng, area = np.random.default_rng(0), np.linalg.norm(mesh.normals, axis=1)
    faces = rng.choice(len(area), count, p=area / area.sum())
    root, share = np.sqrt(rng.uniform(size=count)), rng.uniform(size=count)
    weights = np.stack([1 - root, root * (1 - share), root * share], 1)
    return (mesh.vertices[mesh.faces[faces]] * weights[:, :, None]).sum(axis=1)


def figures(mesh, capture, within, count=60_000):
    points = sampled(mesh, count)
    off = distance_to_room(points)
    truth, _ = spread(0.04)
    views = sum(is_seen(truth, shot.camera).astype(int) for shot in capture.shots)
    gap, _ = cKDTree(points).query(truth[views >= 2])
    return Figures(
        accuracy=float(np.median(off)),
        precision=float((off < within).mean()),
        recall=float((gap < within).mean()),
    )


def tread_heights(mesh):
    """Median height of each step, 4 cm away from its edges and from what stands on it."""
    points, found = sampled(mesh, 100_000), []
    for x0, y0, x1, y1, high in STEPS:
        right = min([x1] + [x for x, *_ in STEPS if x0 < x < x1])
        low, most = np.array([x0, y0]) + 0.04, np.array([right, y1]) - 0.04
        on = ((points[:, :2] > low) & (points[:, :2] < most)).all(axis=1)
        tread = points[on & (np.abs(points[:, 2] - high) < 0.1), 2]
        assert len(tread) > 100
        found.append(np.median(tread))
    return found


def edge_off(mesh):
    """How far the first step's front edge lies inside the true one: least and median, metres.

    Of each slice of 5 cm along the edge, the surface's outermost point in the direction between
    the tread's normal and the riser's. Third, the share of slices that have a surface: at the far
    end few pictures see the edge, and whether it is known there hangs on last bits of the cameras,
    which OpenBLAS's kernels give otherwise on each processor.
    """
    points = sampled(mesh, 400_000)
    x0, y0, _, y1, high = STEPS[0]
    near = (np.abs(points[:, 0] - x0) < 0.1) & (np.abs(points[:, 2] - high) < 0.1)
    inside = (points[near, 0] - x0 + high - points[near, 2]) / np.sqrt(2.0)
    along = points[near, 1]
    slices = np.arange(y0 + 0.05, y1 - 0.05, 0.05)
    found = [inside[(along >= y) & (along < y + 0.05)] for y in slices]
    outermost = [each.min() for each in found if len(each)]
    return min(outermost), float(np.median(outermost)), len(outermost) / len(found)


def heights(mesh, x, y):
    """The heights of what lies below places x, y, top down: of the first three faces, -inf else."""
    kinds = np.full(len(mesh.faces), FACE_KINDS.index("ground"), np.uint8)
    rays = RayScene(TriangleMesh(vertices=mesh.vertices, faces=mesh.faces, kinds=kinds))
    x, y = (each.ravel() for each in np.meshgrid(x, y))
    top, found = np.full(len(x), mesh.vertices[:, 2].max() + 1.0), []
    for _ in range(3):
        down = np.tile([0.0, 0.0, -1.0], (len(x), 1))
        top = top - rays.distance(np.column_stack([x, y, top]), down) - 1e-4
        found.append(top)
        top = np.maximum(top, mesh.vertices[:, 2].min() - 1.0)
    return np.array(found)


def stacked(mesh, up, step):
    """Share of rays along -up that meet two or more faces that look up, of those that meet one."""
    facing = mesh.normals @ up > 0.7 * np.linalg.norm(mesh.normals, axis=1)
    along = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    along /= np.linalg.norm(along)
    turned = mesh.vertices @ np.array([along, np.cross(up, along), up]).T
    ground = type(mesh)(vertices=turned, faces=mesh.faces[facing], colours=mesh.colours)
    low, high = turned.min(axis=0), turned.max(axis=0)
    found = heights(ground, *(np.arange(low[k], high[k], step) for k in range(2)))
    met = np.isfinite(found)
    return met[1].sum() / met[0].sum()
