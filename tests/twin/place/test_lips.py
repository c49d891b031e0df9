"""The rim of a platform is no plank of its own, and a bridge stays one."""

import numpy as np
import pytest
from twin_parts import joined, terrain

from nw_scenes.terrain import build_terrain
from nw_twin.place import without_lips

WIDE = 1.0
"""Of everything, along y, metres."""


def prism(outline):
    """A mesh along y over an outline (K, 2) of x and z, clockwise seen from -y."""
    outline = np.array(outline, dtype=np.float64)
    count = len(outline)
    near, far = (np.insert(outline, 1, y, axis=1) for y in (-WIDE / 2, WIDE / 2))
    sides = [
        face
        for a in range(count)
        for b in [(a + 1) % count]
        for face in ((a, b, b + count), (a, b + count, a + count))
    ]
    return np.concatenate([near, far]), np.array(sides)


def floor():
    return prism([(-2.0, 0.0), (3.0, 0.0), (3.0, -0.1), (-2.0, -0.1)])


def platform(lip, thick=0.1):
    """Its top 0.4 m high reaches from -1 m to 0 and beyond by a lip, under which it leans back."""
    return prism([(-1.0, 0.4), (lip, 0.4), (0.0, 0.4 - thick), (0.0, 0.0), (-1.0, 0.0)])


def physics(vertices, faces, x):
    """The height on which a foot stands, metres, without boxes."""
    found = build_terrain(
        terrain(vertices, faces),
        trail=np.array([[1.0, 0.0, 0.0]]),
        spawn=np.array([-0.5, 0.0, 0.4]),
    )
    return float(found.solids[0].height(np.array([[x, 0.0]]))[0])


def test_a_lip_becomes_the_edge_of_its_platform():
    vertices, faces = joined(floor(), platform(0.05))
    assert physics(vertices, faces, 0.03) < 0.3, "the ground below the lip"
    kept = without_lips(vertices, faces)
    assert physics(vertices, kept, 0.03) == pytest.approx(0.4, abs=1e-3)
    assert physics(vertices, kept, 0.1) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    "other",
    [
        prism([(0.5, 0.4), (1.0, 0.4), (1.0, 0.36), (0.5, 0.36)]),
        platform(0.0),
        platform(0.4),
    ],
    ids=["a plank", "an upright side", "a roof of 40 cm"],
)
def test_what_is_no_lip_stays(other):
    vertices, faces = joined(floor(), other)
    assert len(without_lips(vertices, faces)) == len(faces)
