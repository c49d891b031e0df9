"""What a stranger's scene may say: names, files of its folder, numbers of a place."""

from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest

from nw_base.errors import SceneError
from nw_eval.api import check_scenes
from nw_eval.cli.verbs.scenes import findings_text
from nw_scenes.limits import checked_name
from nw_sim.catalogue import get_scene, names

SCENE = {
    "nw-scene": 1,
    "name": "mine/kerb",
    "task": "hurdles",
    "licence": "MIT",
    "trail": [[1.5, 0, 0.2]],
    "collision": "boxes.json",
}
BOX = {"center": [1.5, 0, 0.1], "half_size": [0.2, 1.0, 0.1]}
MESH = "v -9 -9 0\nv 9 -9 0\nv 9 9 0\nv -9 9 0\nf 1 2 3 4\n"


@pytest.fixture
def place(tmp_path):
    folder = tmp_path / "place"
    folder.mkdir()
    (tmp_path / "secret.json").write_text(json.dumps({"boxes": []}))
    (folder / "mesh.obj").write_text(MESH)

    def write(box=(), boxes=1, **said):
        text = "\n".join(f"{key}: {json.dumps(value)}" for key, value in {**SCENE, **said}.items())
        (folder / "scene.yaml").write_text(text)
        (folder / "boxes.json").write_text(json.dumps({"boxes": boxes * [{**BOX, **dict(box)}]}))
        return folder

    return write


@pytest.mark.parametrize(
    "name",
    ["../../x", "/abs", "a//b", "a/../b", ".", "a/", "", "-x", "a b", "a\nb", "ä", "x" * 300,
     "a/b/c/d/e", "a\\b"],
)  # fmt: skip
def test_a_name_that_could_be_a_path_is_refused_with_its_place(place, name):
    with pytest.raises(SceneError, match=r"scene\.yaml:2:1: name: .* is not a valid scene name"):
        get_scene(place(name=name))


def test_every_built_in_scene_has_a_name_of_that_form():
    assert all(checked_name(name) == name for name in names())


@pytest.mark.parametrize("key", ["collision", "splat"])
@pytest.mark.parametrize("name", ["../secret.json", "/etc/passwd", "a/../../secret.json", "link"])
def test_a_scene_names_no_file_outside_its_folder(place, tmp_path, key, name):
    folder = place(**{key: name})
    (folder / "link").symlink_to(tmp_path / "secret.json")
    with pytest.raises(SceneError, match=rf"scene\.yaml:\d+:1: {key}: .* leaves the scene's"):
        get_scene(folder)


@pytest.mark.parametrize(
    ("said", "where"),
    [
        ({"trail": [[1e7, 0, 0]]}, "trail.0.0"),
        ({"trail": [[1e12, 0, 0]]}, "trail.0.0"),
        ({"trail": 201 * [[1, 0, 0]]}, "trail: has 201 values, at most 200"),
        ({"ground": -1e5}, "ground"),
        ({"spawn": {"position": [0, 0, 1e30]}}, "spawn.position.2"),
        ({"spawn": {"yaw": 90}}, "spawn.yaw"),
        ({"spawn": {"x_jitter": -0.1}}, "spawn.x_jitter"),
        ({"spawn": {"yaw_jitter": -0.1}}, "spawn.yaw_jitter"),
        ({"waypoint_noise": [0, 1e9]}, "waypoint_noise.1"),
        ({"T_world_splat": {"quat": [0, 0, 0, 0]}}, r"T_world_splat.quat: .* is zero"),
        ({"T_world_splat": {"scale": 1e-300}}, "T_world_splat.scale"),
        ({"T_world_splat": {"translation": [0, 1e300, 0]}}, "T_world_splat.translation.1"),
        ({"box": {"friction": [-1, 0.3, 0.3]}}, "boxes.0.friction.0"),
        ({"box": {"friction": [1, 1e9, 0.3]}}, "boxes.0.friction.1"),
        ({"box": {"half_size": [1e300, 1, 1]}}, "boxes.0.half_size.0"),
        ({"box": {"half_size": [1e-300, 1, 1]}}, "half_size must be positive"),
        ({"box": {"center": [1e300, 0, 0]}}, "boxes.0.center.0"),
        ({"box": {"quat": [1e-200, 0, 0, 0]}}, r"boxes.0.quat: .* is zero"),
        ({"boxes": 2001}, "boxes: has 2001 values, at most 2000"),
    ],
)
def test_a_number_of_no_place_is_refused_with_its_place_in_the_file(place, said, where):
    collision = "boxes.json" if said.keys() & {"box", "boxes"} else "mesh.obj"
    with pytest.raises(SceneError, match=rf"(scene\.yaml|boxes\.json):\d+:\d+: .*({where})"):
        get_scene(place(collision=collision, **said))


def test_check_tells_all_faults_of_a_file_in_a_line_each(place):
    told = check_scenes([str(place(name="../x", ground=1e9, waypoint_noise=[-1, 0]))])
    assert [scene.has_errors for scene in told] == [True]
    lines = findings_text(told).splitlines()
    assert all(" error unreadable: " in line for line in lines)
    assert [line.split("scene.yaml:")[1].split(": ")[1] for line in lines] == [
        "name",
        "ground",
        "waypoint_noise.0",
    ]


def test_words_for_people_are_one_clean_line(place):
    scene = get_scene(place(title="a\n::error::b \x1b[2J", licence="MIT\nand more"))
    assert scene.title == "a ::error::b \\x1b[2J"
    assert scene.licence == "MIT and more"


def test_a_key_that_cannot_be_printed_is_refused(place):
    folder = place()
    (folder / "scene.yaml").write_text('nw-scene: 1\n"a\\n::error::b": 1\n')
    with pytest.raises(SceneError) as caught:
        get_scene(folder)
    assert ":2:1: 'a\\n::error::b'... is not a key" in str(caught.value)


def test_a_reference_longer_than_a_file_name_is_no_scene():
    for reference in ("x" * 300, "neverwhere:" + "x" * 300, "a\0b"):
        with pytest.raises(SceneError):
            get_scene(reference)


def test_a_long_trail_is_compared_with_the_legs_near_a_point_only_and_all_the_same():
    from nw_scenes.grid import _nearest_heights, trail_heights

    random = np.random.default_rng(4)
    trail = np.cumsum(random.normal(size=(120, 3)), axis=0)
    points = random.uniform(-15, 15, (4000, 2))
    every = list(pairwise(trail))
    np.testing.assert_allclose(
        trail_heights(trail, points), _nearest_heights(every, points), rtol=0, atol=1e-12
    )
    assert trail_heights(trail, points[:0]).shape == (0,)
