"""Rays against a tree of boxes: against arithmetic in float64, against Embree, and at edges."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from nw_scenes.ray_tree.tree import Tree

MASKS = {
    "AVX2 and FMA": {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+f16c"},
    "SSE4 without FMA": {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": "+sse4.2"},
    "AVX-512": {
        "NUMBA_CPU_NAME": "skylake-avx512",
        "NUMBA_CPU_FEATURES": "+avx,+avx2,+fma,+f16c,+avx512f,+avx512vl,+avx512bw,+avx512dq",
    },
}


def soup(seed, count, size=0.4):
    """Return triangles without neighbours, vertices and faces."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(0, size, (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def ground(seed, side=120):
    """Return a rough field of triangles, `side` metres wide."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    steps = np.where(np.sin(x / 5) * np.sin(y / 7) > 0.6, 2.0, 0.0)
    vertices = np.stack([x, y, rng.normal(0, 0.05, x.shape) + steps], axis=-1).reshape(-1, 3)
    first = np.arange((side - 1) * side).reshape(side - 1, side)[:, :-1].reshape(-1)
    halves = [(0, side, 1), (1, side, side + 1)]
    return vertices, np.concatenate([first[:, None] + np.array(half) for half in halves])


def shot(seed, count):
    """Return rays from around the middle, which are exact in float32."""
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-1.5, 1.5, (count, 3)).astype(np.float32)
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    return origins.astype(np.float64), ways.astype(np.float32).astype(np.float64)


def exact(vertices, faces, origins, directions):
    """Return distances and the least margin to an edge, by the Moeller-Trumbore test in float64."""
    a, b, c = (vertices.astype(np.float32).astype(np.float64)[faces[:, k]] for k in range(3))
    best, margin = np.full(len(origins), np.inf), np.full(len(origins), np.inf)
    for row, (o, d) in enumerate(zip(origins, directions, strict=True)):
        p = np.cross(d, c - a)
        det = ((b - a) * p).sum(axis=1)
        u = ((o - a) * p).sum(axis=1) / det
        q = np.cross(o - a, b - a)
        v = (q @ d) / det
        t = ((c - a) * q).sum(axis=1) / det
        inside = np.minimum(np.minimum(u, v), 1 - u - v)
        best[row] = t[(inside >= 0) & (t > 0)].min(initial=np.inf)
        margin[row] = np.abs(inside[t > -1e-4]).min(initial=np.inf)
    return best, margin


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_those_of_all_triangles_in_float64(seed):
    mesh, rays = soup(seed, 200), shot(seed, 300)
    found, face = Tree(*mesh).cast(*rays)
    wanted, margin = exact(*mesh, *rays)
    clear = margin > 1e-4  # Who grazes an edge may go either way in float32.
    assert clear.mean() > 0.8
    assert np.isfinite(wanted[clear]).any()
    assert np.array_equal(np.isfinite(found[clear]), np.isfinite(wanted[clear]))
    assert np.array_equal(face < 0, np.isinf(found))
    met = clear & np.isfinite(wanted)
    assert np.abs(found[met] - wanted[met]).max() < 1e-4


@pytest.mark.parametrize("mesh", [soup(7, 150), soup(8, 90, size=5.0), ground(9, side=12)])
def test_the_tree_changes_nothing_of_what_the_triangles_give_one_by_one(mesh):
    rng = np.random.default_rng(3)
    origins, ways = shot(1, 500)
    vertices, faces = mesh
    # Every second ray at an edge, where two faces are equally near.
    edges = faces[rng.integers(len(faces), size=250), :2]
    share = rng.choice([0.0, 0.25, 0.5, 0.7], size=(250, 1))
    aims = vertices[edges[:, 0]] * share + vertices[edges[:, 1]] * (1 - share)
    ways[::2] = aims - origins[::2]
    distance, face = Tree(vertices, faces).cast(origins, ways)
    alone, first = np.full(500, np.inf), np.full(500, -1)
    for number in range(len(faces)):
        found = Tree(vertices, faces[number : number + 1]).distance(origins, ways)
        nearer = found < alone
        alone[nearer], first[nearer] = found[nearer], number
    assert (face >= 0).sum() > 100
    assert np.array_equal(distance, alone)
    assert np.array_equal(face, first)


@pytest.mark.parametrize("seed", range(6))
def test_no_ray_gets_out_of_a_closed_mesh_at_its_edges_and_corners(seed):
    rng = np.random.default_rng(seed)
    shape = [
        trimesh.creation.icosphere(subdivisions=3),
        trimesh.creation.box().subdivide().subdivide(),
        trimesh.creation.cylinder(1.0, 1.0, sections=17),
    ][seed % 3]
    turn = np.eye(3) if seed < 3 else np.linalg.qr(rng.normal(size=(3, 3)))[0]
    vertices = np.array(shape.vertices) * rng.uniform(0.2, 3.0, 3) @ turn + rng.normal(0, 30, 3)
    vertices = vertices.astype(np.float32).astype(np.float64)
    ends = vertices[np.asarray(shape.edges)[rng.integers(len(shape.edges), size=20_000)]]
    share = np.where(rng.random(20_000) < 0.5, rng.random(20_000), rng.choice([0, 0.5, 1], 20_000))
    inside = vertices.mean(axis=0) + 0.3 * (
        vertices[rng.integers(len(vertices))] - vertices.mean(0)
    )
    ways = ends[:, 0] * share[:, None] + ends[:, 1] * (1 - share)[:, None] - inside
    distance, face = Tree(vertices, np.asarray(shape.faces)).cast(inside, ways)
    assert (face >= 0).all()
    assert np.abs(distance - 1.0).max() < 1e-3


@pytest.mark.parametrize("seed", range(2))
def test_no_ray_straight_down_passes_between_faces_of_the_ground(seed):
    vertices, faces = ground(seed)
    rng = np.random.default_rng(seed)
    edges = faces[rng.integers(len(faces), size=20_000), :2]
    share = rng.choice([0.0, 0.25, 0.5, 1.0], size=(20_000, 1))
    above = vertices[edges[:, 0]] * share + vertices[edges[:, 1]] * (1 - share)
    height = above[:, 2].copy()
    above[:, 2] = 50.0
    down = np.tile([0.0, 0.0, -1.0], (20_000, 1))
    found = Tree(vertices, faces).distance(above, down)
    assert np.abs(50.0 - found - height).max() < 1e-4


def test_rays_meet_what_embree_says():
    mesh_construction = pytest.importorskip("embreex.mesh_construction")
    rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
    vertices, faces = ground(4)
    embree = rtcore_scene.EmbreeScene(robust=True)  # Without cracks between neighbours.
    mesh_construction.TriangleMesh(embree, vertices.astype(np.float32), faces.astype(np.int32))
    rng = np.random.default_rng(5)
    eye = np.array([60.3, 58.2, 3.0])
    ways = rng.normal(size=(20_000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    distance, face = Tree(vertices, faces).cast(eye, ways)
    begin = np.tile(eye.astype(np.float32), (len(ways), 1))
    hits = embree.run(begin, ways.astype(np.float32), output=True)
    wanted, of = hits["tfar"], hits["primID"]
    assert 5_000 < (face >= 0).sum() < 15_000
    assert np.array_equal(face >= 0, of >= 0)
    met = face >= 0
    assert np.abs(distance[met] / wanted[met] - 1.0).max() < 1e-4
    assert (face != of).mean() < 1e-3  # At an edge either of two.


def test_rays_along_planes_of_the_boxes_and_rays_of_zeros_are_answered():
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    tree = Tree(box.vertices, box.faces)
    o = np.array([[0, 0, 3.0], [1, 0, 3], [1, 1, 3], [1.001, 0, 3], [0, 0, 0], [0, 0, 3]])
    d = np.array([[0, 0, -1.0], [0, 0, -1], [-0.0, -0.0, -2], [0, 0, -1], [0, 0, 1], [0, 0, 0]])
    assert tree.distance(o, d).tolist() == [2.0, 2.0, 1.0, np.inf, 1.0, np.inf]
    assert tree.distance(np.array([np.nan, 0, 3]), d[:1]).tolist() == [np.inf]
    assert tree.distance(o[:1], np.array([[0, np.inf, -1.0]])).tolist() == [np.inf]


def test_a_ray_that_begins_on_a_face_meets_the_next():
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    on_top = np.array([[0.3, 0.2, 1.0], [0.3, 0.2, 1.0]])
    distance = Tree(box.vertices, box.faces).distance(on_top, np.array([[0, 0, -1.0], [0, 0, 1]]))
    assert distance.tolist() == [2.0, np.inf]


def test_the_first_of_equal_faces_counts_and_broken_ones_do_not():
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0], [np.nan, 0, 1], [0, np.inf, 2]])
    broken = [[0, 1, 3], [0, 4, 2], [0, 0, 1], [0, 1, 1]]
    faces = np.array([*broken, *[[0, 1, 2]] * 1000])
    distance, face = Tree(corners, faces).cast(np.array([0, 0, 2.0]), np.array([[0, 0, -1.0]]))
    assert (distance.tolist(), face.tolist()) == ([2.0], [4])
    nothing = Tree(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    assert nothing.face(np.zeros(3), np.ones((2, 3))).tolist() == [-1, -1]
    assert Tree(corners, faces[:4]).face(np.zeros(3), np.ones((0, 3))).shape == (0,)


def test_a_tree_is_as_deep_as_its_mesh_asks():
    # Each triangle farther and larger than the one before: a tree of them is lopsided.
    scale = 1.3 ** np.arange(120)[:, None, None] * 1e-5
    corners = np.array([[1.0, 1, 1], [1, -1, 1], [-1, 0, 1]]) * scale
    vertices, faces = corners.reshape(-1, 3), np.arange(360).reshape(-1, 3)
    tree = Tree(vertices, faces)
    for number in (0, 60, 119):
        over = np.array([0.0, 0.0, float(1.2 * scale[number, 0, 0])])
        assert tree.face(over, np.array([[0, 0, -1.0]])).tolist() == [number]


def test_rays_of_other_shapes_are_refused():
    tree = Tree(*soup(0, 3))
    with pytest.raises(ValueError, match=r"origins \(2, 3\) and directions \(5, 3\)"):
        tree.cast(np.zeros((2, 3)), np.ones((5, 3)))
    with pytest.raises(ValueError, match=r"directions \(5, 2\)"):
        tree.cast(np.zeros(3), np.ones((5, 2)))


def digest():
    """Return a digest of what many rays meet."""
    found = hashlib.sha256()
    for mesh in (soup(1, 3000, size=0.1), soup(2, 200, size=3.0), ground(3)):
        tree = Tree(*mesh)
        found.update(tree._tree.tobytes())
        origins, ways = shot(4, 5000)
        low, size = mesh[0].min(axis=0), np.ptp(mesh[0], axis=0)
        for begin in (origins, low + (origins + 1.5) / 3 * size):
            for each in tree.cast(begin, ways):
                found.update(each.tobytes())
    return found.hexdigest()


def masked(mask):
    """Return the digest of a process that compiles for another processor."""
    code = f"import runpy; print(runpy.run_path({__file__!r})['digest']())"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **mask}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return done.stdout.strip()


@pytest.mark.nightly
def test_rays_give_the_same_bits_without_avx_512():
    assert masked(MASKS["AVX2 and FMA"]) == digest()


@pytest.mark.nightly
@pytest.mark.parametrize("mask", ["SSE4 without FMA", "AVX-512"])
def test_rays_give_the_same_bits_on_other_processors(mask):
    assert masked(MASKS[mask]) == digest()
