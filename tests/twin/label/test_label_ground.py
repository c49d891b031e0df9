"""Clicks land on the mesh; crops cut it where they say; profiles follow it."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from label_places import block, floor, opened
from twin_parts import terrain

from nw_twin.label.ground import Ground, height_profile
from nw_twin.label.state import CropBox, cropped


def mesh_of(*solids):
    joined = trimesh.util.concatenate(list(solids))
    return terrain(joined.vertices, joined.faces)


def area(mesh):
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


BALL = trimesh.creation.icosphere(subdivisions=3, radius=1.0)


@settings(max_examples=50)
@given(
    origin=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1),
    aim=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    far=st.floats(3, 60),
)
def test_what_a_click_snaps_to_lies_on_the_mesh_and_on_its_ray(origin, aim, far):
    start = np.array(origin) / np.linalg.norm(origin) * far
    direction = np.array(aim) - start
    point = Ground(mesh_of(BALL)).hit(tuple(start), tuple(direction))
    _, distance, _ = trimesh.proximity.closest_point_naive(BALL, [point])
    assert distance[0] < 1e-6
    along = np.array(point) - start
    assert np.linalg.norm(np.cross(along, direction)) < 1e-6 * np.linalg.norm(direction)
    assert along @ direction > 0


def test_a_click_beside_the_place_snaps_to_nothing(tmp_path):
    labelling = opened(tmp_path)
    assert labelling.snapped((0.0, 0.0, 2.0), (0.0, 0.0, 1.0)) is None
    assert labelling.snapped((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)) is None
    assert labelling.snapped((math.nan, 0.0, 2.0), (0.0, 0.0, -1.0)) is None
    assert labelling.snapped((2.5, 0.3, 2.0), (0.0, 0.0, -3.0)) == pytest.approx((2.5, 0.3, 0.1))


@settings(max_examples=30)
@given(
    low=st.tuples(*[st.floats(-1.2, 0)] * 3),
    size=st.tuples(*[st.floats(0.3, 2)] * 3),
)
def test_a_crop_cuts_the_mesh_as_an_independent_slicing_does(low, size):
    box = CropBox(low=low, high=tuple(np.add(low, size)))
    after = cropped(mesh_of(BALL), box)
    expected = BALL
    for axis in np.eye(3):
        for origin, normal in ((box.low, axis), (box.high, -axis)):
            expected = trimesh.intersections.slice_mesh_plane(expected, normal, origin)
    assert area(after) == pytest.approx(expected.area, abs=1e-6)
    if len(after.faces):
        assert (after.vertices >= np.array(box.low) - 1e-9).all()
        assert (after.vertices <= np.array(box.high) + 1e-9).all()
        # Faces still look outwards.
        normals = np.cross(*np.diff(after.triangles, axis=1).transpose(1, 0, 2))
        assert (np.einsum("ij,ij->i", normals, after.triangles.mean(axis=1)) > -1e-12).all()


def test_a_profile_climbs_the_step_and_knows_where_its_waypoints_are():
    ground = Ground(mesh_of(floor(), block(2.0, 1.0, 0.1)))
    profile = height_profile(ground, [(0.0, 0.0, 0.0), (2.5, 0.0, 0.1), (2.5, 2.0, 0.0)])
    assert profile.stops == pytest.approx([0.0, 2.5, 4.5])
    height = np.interp([1.9, 2.1, 3.9, 4.1], profile.distance, profile.height)
    assert height == pytest.approx([0.0, 0.1, 0.1, 0.0])
    assert (np.diff(profile.distance) >= 0).all()


def test_a_profile_looks_below_ceilings_and_says_where_there_is_no_ground():
    ceiling = trimesh.creation.box((9.0, 5.0, 0.1))
    ceiling.apply_translation((2.5, 0.0, 2.5))
    ground = Ground(mesh_of(floor(-2.0, 4.0), ceiling))
    profile = height_profile(ground, [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0)])
    at = np.interp([1.0, 3.0], profile.distance, np.where(np.isfinite(profile.height), 1, 0))
    assert at.tolist() == [1.0, 0.0]


def test_no_stops_have_an_empty_profile():
    ground = Ground(mesh_of(floor()))
    assert len(height_profile(ground, []).distance) == 0
    assert height_profile(ground, [(0.0, 0.0, 0.0)]).stops.tolist() == [0.0]
