from __future__ import annotations

import numpy as np

from nw_scenes.mesh import cone_mesh


def test_a_cone_has_the_published_size_and_stands_on_the_floor():
    # reference: about 0.18 x 0.18 x 0.20 m.
    vertices = cone_mesh().mesh.vertices
    assert np.allclose(vertices.min(axis=0), [-0.09, -0.09, 0.0])
    assert np.allclose(vertices.max(axis=0), [0.09, 0.09, 0.20])


def test_every_face_has_a_colour_and_a_white_band_runs_round():
    cone = cone_mesh()
    assert cone.colors.shape == (len(cone.mesh.faces), 3)
    white = cone.colors.min(axis=1) > 0.8
    heights = cone.mesh.triangles[white][..., 2]
    assert 0.05 < heights.min() < heights.max() < 0.16
    orange = (cone.colors[:, 0] > 0.7) & (cone.colors[:, 2] < 0.2)
    assert np.all(white | orange)


def test_its_mantle_looks_outward():
    triangles = cone_mesh().mesh.triangles[12:]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sound = np.linalg.norm(normal, axis=1) > 1e-9  # The tip's triangles have no area.
    outward = (normal[sound, :2] * triangles[sound].mean(axis=1)[:, :2]).sum(axis=1)
    assert np.all(outward > 0)
