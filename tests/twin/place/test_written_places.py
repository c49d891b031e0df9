"""A built place is a scene folder like any other: it loads, its splat lies where its mesh is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from nw_base.errors import SceneError
from nw_eval.suite import load_suite
from nw_scenes.folder import load_folder
from nw_scenes.mesh import rotation_matrix
from nw_twin.place import Route, write_place

STEP = 0.1


def place(step=STEP):
    """A floor and a step across it, m."""
    floor = trimesh.creation.box((9.0, 5.0, 0.2))
    floor.apply_translation((2.5, 0.0, -0.1))
    block = trimesh.creation.box((1.0, 3.0, step))
    block.apply_translation((2.5, 0.0, step / 2))
    return trimesh.util.concatenate([floor, block])


def similarity(scale, quat, translation):
    T = np.eye(4)
    T[:3, :3] = scale * rotation_matrix(quat)
    T[:3, 3] = translation
    return T


def written(folder, T, **changes):
    """Write a place whose capture's frame T maps to metres; return what T maps back."""
    mesh = place()
    mesh.apply_transform(np.linalg.inv(T))
    (folder / "build").mkdir()
    mesh.export(folder / "build" / "mesh.ply")
    (folder / "build" / "splat.ply").write_bytes(b"ply")
    course = Route(task="stairs", trail=np.array([[2.5, 0.0, STEP], [4.5, 0.0, 0.0]]))
    words = {"name": "my/corridor", "licence": "CC0-1.0", "course": course} | changes
    write_place(
        folder / "place",
        mesh=folder / "build" / "mesh.ply",
        splat=folder / "build" / "splat.ply",
        T_world_capture=T,
        **words,
    )
    return load_folder(folder / "place")


@settings(max_examples=5, deadline=None)
@given(
    scale=st.floats(0.2, 5.0),
    quat=st.tuples(*[st.floats(-1, 1)] * 3).map(lambda v: (1.0, *v)),
    translation=st.tuples(*[st.floats(-20, 20)] * 3),
)
def test_whatever_frame_a_capture_is_in_the_place_is_in_metres(
    tmp_path_factory, scale, quat, translation
):
    T = similarity(scale, quat, translation)
    scene = written(tmp_path_factory.mktemp("any"), T)
    np.testing.assert_allclose(scene.static_mesh.vertices.max(0), [7.0, 2.5, STEP], atol=2e-5)
    np.testing.assert_allclose(scene.T_world_splat, T, atol=1e-6 * scale)
    np.testing.assert_allclose(scene.trail[0], [2.5, 0.0, STEP])


def test_its_suite_names_it_and_loads(tmp_path):
    written(tmp_path, np.eye(4))
    suite = load_suite(tmp_path / "place" / "suite.yaml")
    assert suite.name == "my-corridor"
    assert suite.policy == "go1-parkour"


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"name": "../away"}, "away"),
        ({"course": Route(task="stairs", trail=np.zeros((0, 3)))}, "trail"),
    ],
)
def test_what_no_scene_can_be_is_refused_by_name(tmp_path, wrong, match):
    with pytest.raises(SceneError, match=match):
        written(tmp_path, np.eye(4), **wrong)


def test_a_matrix_that_mirrors_is_refused(tmp_path):
    with pytest.raises(SceneError):
        written(tmp_path, np.diag([1.0, 1.0, -1.0, 1.0]))
