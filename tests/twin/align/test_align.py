"""An alignment gives one metric scene, whichever frame its capture came in."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rooms import capture, room, similarity, walk

from nw_base.errors import SceneError
from nw_scenes.saving import similarity_entry
from nw_splat.gaussians import Gaussians, transformed
from nw_twin.align.align import align
from nw_twin.align.alignment import AlignOptions, read_alignment, write_alignment
from nw_twin.place import moved_camera, moved_capture, moved_mesh, moved_points

RNG = np.random.default_rng(11)
POINTS = room(RNG, floor=300, walls=120, stray=40)
POSES = walk(RNG, 16)
OPTIONS = AlignOptions(camera_height=1.5)
HERE = align(capture(POINTS, POSES), None, options=OPTIONS)


@given(seed=st.integers(0, 10**6), size=st.floats(1e-3, 1e3))
@settings(max_examples=5, deadline=None)
def test_any_rotation_scale_and_place_of_the_input_gives_the_same_scene(seed, size):
    T = similarity(np.random.default_rng(seed), size)
    there = align(capture(POINTS, POSES, T), None, options=OPTIONS)
    np.testing.assert_allclose(
        moved_points(there.T_metric_capture @ T, POINTS),
        moved_points(HERE.T_metric_capture, POINTS),
        atol=1e-6,
    )


def test_the_origin_is_below_the_first_shot_and_x_leads_to_the_farthest():
    metric = moved_capture(HERE.T_metric_capture, capture(POINTS, POSES)).centres
    np.testing.assert_allclose(metric[0, :2], 0.0, atol=1e-9)
    farthest = metric[np.argmax(np.linalg.norm(metric[:, :2], axis=1))]
    assert farthest[0] > 2.5
    assert abs(farthest[1]) < 1e-9


def test_a_camera_that_never_moves_gives_x_where_it_looks():
    poses = np.repeat(POSES[:1], 6, axis=0)
    alignment = align(capture(POINTS, poses), None, options=AlignOptions(metric=True))
    forward = alignment.T_metric_capture[:3, :3] @ poses[0, :3, 2]
    assert abs(forward[1]) < 1e-9 < forward[0]


def test_an_alignment_survives_the_disk(tmp_path):
    write_alignment(HERE, tmp_path / "align.json")
    back = read_alignment(tmp_path / "align.json")
    assert (back.T_metric_capture == HERE.T_metric_capture).all()
    assert vars(back) | {"T_metric_capture": 0} == vars(HERE) | {"T_metric_capture": 0}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"nw-align": 1', '"nw-align": 2', "nw-align"),
        ('"scale": ', '"scale": 3', "its matrix has the scale"),
        ('"scale": ', '"scale": -', "greater than 0"),
        ('"warnings"', '"alarms"', "not an alignment"),
        ("{", "", "not an alignment"),
    ],
)
def test_a_damaged_file_is_an_error_in_words(tmp_path, old, new, message):
    path = tmp_path / "align.json"
    write_alignment(HERE, path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(SceneError, match=message):
        read_alignment(path)


def test_no_file_is_an_error_that_says_what_to_do(tmp_path):
    with pytest.raises(SceneError, match="nw-eval twin align"):
        read_alignment(tmp_path / "align.json")


def test_a_camera_in_metres_sees_the_same_pixels_at_metric_depth():
    T = similarity(np.random.default_rng(0), 0.3)
    camera = capture(POINTS, POSES).shots[3].camera
    moved = moved_camera(T, camera)
    local = moved_points(camera.T_camera_world, POINTS)
    there = moved_points(moved.T_camera_world, moved_points(T, POINTS))
    np.testing.assert_allclose(there, 0.3 * local, atol=1e-9)
    assert moved.near == pytest.approx(0.3 * camera.near)
    np.testing.assert_allclose(moved.T_world_camera[:3, :3].T @ moved.T_world_camera[:3, :3],
                               np.eye(3), atol=1e-12)  # fmt: skip


def test_a_mesh_and_gaussians_follow_the_points():
    T = similarity(np.random.default_rng(1))
    mesh = moved_mesh(T, POINTS[:3], np.array([[0, 1, 2]]))
    np.testing.assert_allclose(mesh.triangles[0], moved_points(T, POINTS[:3]))
    gaussians = Gaussians(
        means=POINTS[:3], log_scales=np.zeros((3, 3)), quats=np.eye(4)[[0, 0, 0]],
        opacity_logits=np.zeros(3), sh=np.zeros((3, 1, 3)),
    )  # fmt: skip
    moved = transformed(gaussians, T)
    np.testing.assert_allclose(moved.means, moved_points(T, POINTS[:3]), rtol=1e-5, atol=1e-5)
    scale = math.log(np.linalg.det(T[:3, :3])) / 3
    np.testing.assert_allclose(moved.log_scales, scale, rtol=1e-5)


def test_the_entry_of_a_scene_is_the_alignment_again():
    from nw_scenes.mesh import rotation_matrix

    T = HERE.T_metric_capture
    entry = similarity_entry(T)
    linear = entry["scale"] * rotation_matrix(entry["quat"])
    np.testing.assert_allclose(linear, T[:3, :3], atol=1e-9)
    assert entry["translation"] == T[:3, 3].tolist()
