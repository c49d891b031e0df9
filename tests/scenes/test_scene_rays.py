from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nw_scenes.mesh import TriangleMesh, box_mesh, merge, quad_mesh, rotation_matrix
from nw_scenes.rays import RayScene

_number = st.floats(-2.0, 2.0)
_size = st.floats(0.05, 1.0)


def _slabs(origin, direction, center, half, rotation):
    """Distance to a box by the slab method, in float64: independent of meshes and their tree."""
    o = (origin - center) @ rotation
    d = direction @ rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = (-half - o) / d, (half - o) / d
    near, far = np.minimum(low, high).max(), np.maximum(low, high).min()
    if near > far or far < 0:
        return np.inf
    return near if near > 0 else far


@settings(max_examples=60, deadline=None)
@given(
    center=st.tuples(_number, _number, _number),
    half=st.tuples(_size, _size, _size),
    quat=st.tuples(st.floats(0.2, 1.0), _number, _number, _number),
    seed=st.integers(0, 10_000),
)
def test_rays_meet_boxes_where_the_slab_method_says(center, half, quat, seed):
    rng = np.random.default_rng(seed)
    rays = RayScene(box_mesh(center, half, quat, "obstacle"))
    origins = rng.uniform(-4, 4, (64, 3))
    # Aim near the box, so that about half of the rays hit.
    aims = np.array(center) + rng.normal(size=(64, 3)) * 0.8
    ways = aims - origins
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    distance, face = rays.cast(origins, ways)
    rotation = rotation_matrix(quat)
    wanted = [
        _slabs(o, d, np.array(center), np.array(half), rotation)
        for o, d in zip(origins, ways, strict=True)
    ]
    for found, exact, hit, o, d in zip(distance, wanted, face, origins, ways, strict=True):
        # A ray that grazes an edge may go either way in float32.
        close = _slabs(o, d, np.array(center), np.array(half) * 1.0001 + 1e-5, rotation)
        clear = _slabs(o, d, np.array(center), np.array(half) * 0.9999 - 1e-5, rotation)
        if np.isinf(close) != np.isinf(clear):
            continue
        assert np.isinf(found) == np.isinf(exact)
        assert (hit < 0) == np.isinf(found)
        if np.isfinite(exact):
            assert abs(found - exact) < 2e-4


def test_heights_look_through_ceilings_and_overhead_things():
    mesh = merge(
        [
            quad_mesh((-5, -5, 0), (10, 0, 0), (0, 10, 0), "ground"),
            box_mesh((0, 0, 0.1), (0.2, 0.5, 0.1), (1, 0, 0, 0), "obstacle"),
            quad_mesh((-5, -5, 2.5), (0, 10, 0), (10, 0, 0), "structure"),  # Seen from below.
            box_mesh((0, 0, 2.0), (1, 1, 0.05), (1, 0, 0, 0), "overhead"),
        ]
    )
    rays = RayScene(mesh)
    found = rays.height(np.array([[0.0, 0.0], [1.0, 0.0], [20.0, 0.0]]))
    assert found.tolist() == [0.2, 0.0, -np.inf]


def test_heights_on_a_slope_are_exact_to_a_micrometre():
    mesh = quad_mesh((0, -1, 0), (4, 0, 1), (0, 2, 0), "obstacle")
    x = np.linspace(0.01, 3.99, 100)
    found = RayScene(mesh).height(np.stack([x, np.zeros(100)], axis=1))
    assert np.abs(found - x / 4).max() < 1e-6


def test_misses_and_empty_batches_are_answered():
    rays = RayScene(quad_mesh((0, 0, 0), (1, 0, 0), (0, 1, 0), "ground"))
    distance, face = rays.cast(np.array([[0.5, 0.5, 1.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert distance[0] == np.inf
    assert face[0] == -1
    assert rays.distance(np.array([[0.5, 0.5, 1.0]]), np.array([[0.0, 0.0, 1.0]]))[0] == np.inf
    assert len(rays.cast(np.zeros((0, 3)), np.zeros((0, 3)))[0]) == 0
    assert len(rays.height(np.zeros((0, 2)))) == 0


def test_an_empty_mesh_is_never_hit():
    empty = TriangleMesh(
        vertices=np.zeros((0, 3)),
        faces=np.zeros((0, 3), dtype=np.int32),
        kinds=np.zeros(0, dtype=np.uint8),
    )
    rays = RayScene(empty)
    assert rays.cast(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]]))[1].tolist() == [-1]
    assert rays.height(np.zeros((1, 2))).tolist() == [-np.inf]
