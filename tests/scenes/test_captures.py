"""From where a place was photographed: the file, and which camera is the nearest."""

from __future__ import annotations

import json
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nw_base.errors import SceneError
from nw_scenes import limits
from nw_scenes.capture_file import read_captures, write_captures
from nw_scenes.folder import folder_files
from nw_scenes.scene import CaptureCameras
from nw_sim.catalogue import get_scene

SCENE = """\
nw-scene: 1
name: mine
task: hurdles
licence: MIT
trail: [[2, 0, 0]]
"""
ALONG_X = (0.5, -0.5, 0.5, -0.5)  # x right, y down, z ahead along the world's x

numbers = st.floats(-50.0, 50.0)
points = st.tuples(numbers, numbers, numbers)
quats = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: sum(x * x for x in q) > 0.01)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.yaml").write_text(SCENE + "captures: captures.json\n")
    (tmp_path / "collision.yaml").write_text('{"boxes": []}')
    write_captures(tmp_path / "captures.json", [((1.0, 0.0, 0.3), ALONG_X)])
    return tmp_path


def pose(position, axis):
    """A camera at a place that looks along an axis."""
    T = np.eye(4)
    T[:3, 2], T[:3, 3] = axis, position
    return T


def turned(axis, quat):
    """What a quaternion makes of an axis, by Rodrigues' formula and not by a matrix."""
    w, *v = np.array(quat) / np.linalg.norm(quat)
    axis, v = np.array(axis), np.array(v)
    return axis + 2 * w * np.cross(v, axis) + 2 * np.cross(v, np.cross(v, axis))


@settings(max_examples=30)
@given(cameras=st.lists(st.tuples(points, quats), min_size=1, max_size=5))
def test_what_is_written_is_read_again(tmp_path_factory, cameras):
    path = tmp_path_factory.mktemp("captures") / "captures.json"
    write_captures(path, cameras)
    found = read_captures(path)
    assert found.positions.tolist() == [list(position) for position, _ in cameras]
    axes = [turned((0.0, 0.0, 1.0), quat) for _, quat in cameras]
    np.testing.assert_allclose(found.axes, axes, atol=1e-9)


def test_a_camera_of_the_page_looks_along_x(folder):
    scene = get_scene(folder)
    np.testing.assert_allclose(scene.captures.axes, [[1.0, 0.0, 0.0]], atol=1e-12)
    assert scene.captures.positions.tolist() == [[1.0, 0.0, 0.3]]


def test_a_turn_of_30_degrees_is_as_far_as_a_metre():
    turn = np.radians(29.0)
    cameras = CaptureCameras(
        positions=np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        axes=np.array([[cos(turn), sin(turn), 0.0], [1.0, 0.0, 0.0]]),
    )
    here = cameras.nearest(pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    assert (here.distance, here.angle) == (0.0, pytest.approx(turn))
    aside = cameras.nearest(pose((0.0, 0.05, 0.0), (1.0, 0.0, 0.0)))
    assert (aside.distance, aside.angle) == (pytest.approx(0.95), pytest.approx(0.0))


@settings(max_examples=50)
@given(cameras=st.lists(st.tuples(points, quats), min_size=1, max_size=6), point=points)
def test_no_camera_is_nearer_than_the_nearest(cameras, point):
    positions = np.array([position for position, _ in cameras])
    axes = np.array([turned((0.0, 0.0, 1.0), quat) for _, quat in cameras])
    near = CaptureCameras(positions=positions, axes=axes).nearest(pose(point, (0.0, 1.0, 0.0)))
    sums = [
        float(np.linalg.norm(position - np.array(point)))
        + np.arctan2(np.linalg.norm(np.cross(axis, (0.0, 1.0, 0.0))), axis[1]) / (pi / 6)
        for position, axis in zip(positions, axes, strict=True)
    ]
    assert near.distance + near.angle / (pi / 6) == pytest.approx(min(sums), abs=1e-5)


def test_a_scene_without_them_is_what_it_was_and_with_others_another(folder):
    # Recorded with version 5 of the generator.
    known = "68bc975e7cd1cedd3779eecddbe40c23928e5543d072fcd56dd09299b5cf9c4a"
    assert get_scene("hurdles/one_low_carpet").captures is None
    assert get_scene("hurdles/one_low_carpet").digest == known
    first = get_scene(folder).digest
    write_captures(folder / "captures.json", [((1.0, 0.0, 0.31), ALONG_X)])
    second = get_scene(folder).digest
    (folder / "scene.yaml").write_text(SCENE)
    assert len({first, second, get_scene(folder).digest}) == 3


def test_they_are_part_of_what_the_scene_is_made_of(folder):
    assert set(folder_files(folder)) == {"scene.yaml", "collision.yaml", "captures.json"}


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ("", "Invalid JSON"),
        ("[1, 2]", "it: "),
        ('{"cameras": []}', "nw-captures: Field required"),
        ('{"nw-captures": 2, "cameras": []}', "nw-captures"),
        ('{"nw-captures": 1, "cameras": []}', "cameras: "),
        ({"position": [0, 0], "quat": ALONG_X}, "cameras.0.position.2"),
        ({"position": [0, 0, "NaN"], "quat": ALONG_X}, "cameras.0.position.2"),
        ({"position": [0, 0, 1e7], "quat": ALONG_X}, "cameras.0.position.2"),
        ({"position": [0, 0, 0], "quat": [0, 0, 0, 0]}, r"quat \[0.0, 0.0, 0.0, 0.0\] is zero"),
        ({"position": [0, 0, 0], "quat": ALONG_X, "look": 1}, "cameras.0.look"),
    ],
)
def test_what_is_no_such_file_is_refused_with_its_place(folder, content, fault):
    if not isinstance(content, str):
        content = json.dumps({"nw-captures": 1, "cameras": [content]})
    (folder / "captures.json").write_text(content)
    with pytest.raises(SceneError, match=fault) as caught:
        get_scene(folder)
    assert "captures.json" in str(caught.value)


def test_a_file_that_is_not_there_or_too_large_is_named(folder, monkeypatch):
    monkeypatch.setattr(limits, "CAPTURE_BYTES", 50)
    with pytest.raises(SceneError, match="larger than 50 bytes"):
        get_scene(folder)
    (folder / "captures.json").unlink()
    with pytest.raises(SceneError, match="there are no capture cameras"):
        get_scene(folder)


@pytest.mark.parametrize("name", ["../captures.json", "/etc/passwd"])
def test_nothing_outside_the_folder_is_read(folder, name):
    (folder / "scene.yaml").write_text(SCENE + f"captures: {name}\n")
    with pytest.raises(SceneError, match="leaves the scene's folder"):
        get_scene(folder)
