"""Whether the two meshes of a scanned scene are where the XML says.

The collision mesh was cut out of the placed visual mesh, so the two must coincide. Files of
different ages do not: some scenes were labelled anew, with another scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nw_eval.scenes.health.finding import SceneFinding
from nw_eval.scenes.mesh import TriangleMesh
from nw_eval.scenes.rays import RayScene

Values = NDArray[np.float64]

# What the label tool cuts out, metres.
LABEL_LOW = np.array([-2.0, -3.0, -3.0])
LABEL_HIGH = np.array([7.0, 3.0, 3.0])

_PROBES = 4000
_OFF = 0.02
# Distances are looked for within this, along the surface's normal, metres.
_REACH = 1.0
_MEDIAN_LIMIT = 0.01
_SHARE_LIMIT = 0.05
# Seen from the visual mesh the box's rim is not compared: it may have been cut at another place.
_RIM = 0.05


@dataclass(frozen=True, kw_only=True)
class Consistency:
    """How far two surfaces are apart along their normals, metres, capped at 1.

    Attributes:
        median: of points on the collision mesh from the visual mesh.
        p95: likewise.
        share_off: of the points of both, those further than 2 cm from the other mesh.
    """

    median: float
    p95: float
    share_off: float


def compare(visual: TriangleMesh, collision: TriangleMesh, shift: Values) -> Consistency:
    """Measure how well two meshes coincide.

    Args:
        visual: placed in the world.
        collision: placed in the world.
        shift: (3,) of the collision body: the label box moves with it.
    """
    random = np.random.default_rng(0)
    on_collision, normals = _samples(collision, random)
    there = _distance(visual, on_collision, normals)
    on_visual, visual_normals = _samples(visual, random, low=LABEL_LOW, high=LABEL_HIGH)
    # Of the visual mesh only what the collision mesh spans.
    low = np.maximum(collision.vertices.min(axis=0), LABEL_LOW + np.minimum(shift, 0.0)) + _RIM
    high = np.minimum(collision.vertices.max(axis=0), LABEL_HIGH + np.maximum(shift, 0.0)) - _RIM
    inside = ((on_visual > low) & (on_visual < high)).all(axis=1)
    back = _distance(collision, on_visual[inside], visual_normals[inside])
    both = np.concatenate([there, back])
    median, p95 = np.quantile(there, [0.5, 0.95]).tolist()
    return Consistency(median=median, p95=p95, share_off=float((both > _OFF).mean()))


def consistency_findings(
    visual: TriangleMesh, collision: TriangleMesh, shift: Values
) -> tuple[SceneFinding, ...]:
    """Return the finding that the meshes disagree, with numbers, or nothing."""
    found = compare(visual, collision, shift)
    if found.median <= _MEDIAN_LIMIT and found.share_off <= _SHARE_LIMIT:
        return ()
    return (
        SceneFinding(
            code="inconsistent_meshes",
            severity="error",
            message="collision mesh and placed visual mesh do not coincide: median distance "
            f"{1000 * found.median:.1f} mm, 95 % within {1000 * found.p95:.0f} mm, "
            f"{100 * found.share_off:.0f} % of the surface more than {1000 * _OFF:.0f} mm off",
            fix="XML and meshes are of different ages, or scale, pos or euler are wrong: "
            "take all from one download",
            value=found.median,
        ),
    )


def _samples(
    mesh: TriangleMesh,
    random: np.random.Generator,
    low: Values | None = None,
    high: Values | None = None,
) -> tuple[Values, Values]:
    """Return points spread evenly over a mesh (N, 3) and unit normals there."""
    corners = mesh.triangles
    if low is not None and high is not None:
        near = (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
        corners = corners[near]
    if len(corners) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    total = np.cumsum(area)
    face = np.searchsorted(total, random.uniform(0.0, total[-1], _PROBES))
    face = np.minimum(face, len(corners) - 1)
    u, v = random.uniform(size=(2, _PROBES, 1))
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    a, b, c = (corners[face, i] for i in range(3))
    return a + u * (b - a) + v * (c - a), normal[face] / area[face, None]


def _distance(mesh: TriangleMesh, points: Values, normals: Values) -> Values:
    """Return how far a mesh is from points along their normals, (N,) m, at most the reach."""
    if len(points) == 0:
        return np.zeros(0)
    rays = RayScene(mesh)
    # A little beyond the surface, so that one that coincides is met.
    step = 1e-3
    distances = [
        np.abs(rays.distance(points - sign * step * normals, sign * normals) - step)
        for sign in (1.0, -1.0)
    ]
    return np.minimum(np.minimum(*distances), _REACH)
