"""Saved labels are scenes like any other, with what people wrote in scene.yaml left alone."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from label_places import (
    SCENE,
    UNSCALED,
    WALK,
    block,
    floor,
    opened,
    photographed,
    without_waypoints,
    written_place,
)

from nw_base.errors import SceneError, StoreError, UsageError
from nw_scenes.folder import load_folder
from nw_scenes.neverwhere import load_published
from nw_twin.label import files, published
from nw_twin.label.labelling import open_labelling
from nw_twin.label.state import CropBox


@pytest.fixture
def labelling(tmp_path):
    return opened(tmp_path)


def files_of(folder):
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@settings(max_examples=6)
@given(
    points=st.lists(
        st.tuples(st.floats(-1.9, 6.9), st.floats(-2.4, 2.4), st.floats(0, 0.1)),
        min_size=1,
        max_size=12,
    ),
    yaw=st.floats(-10, 10),
    task=st.sampled_from(["hurdles", "gaps", "ramps", "stairs"]),
)
def test_what_is_saved_is_what_is_opened_again(tmp_path_factory, points, yaw, task):
    labelling = opened(tmp_path_factory.mktemp("any"))
    without_waypoints(labelling)
    for point in points:
        labelling.add_waypoint(point)
    labelling.set_start(points[0], yaw)
    labelling.set_task(task)
    folder = labelling.save()
    again = open_labelling(folder)
    assert again.state.task == task
    np.testing.assert_allclose(again.course.trail, points, atol=5.1e-5)
    np.testing.assert_allclose(again.start.position, points[0], atol=5.1e-5)
    assert math.remainder(again.start.yaw - yaw, 2 * math.pi) == pytest.approx(0, abs=1e-4)
    np.testing.assert_allclose(load_folder(folder).trail, again.course.trail)


def test_comments_other_keys_and_spelling_stay(labelling):
    labelling.nudge_waypoint(1, 0.5, 0.0)
    labelling.set_task("ramps")
    text = (labelling.save() / "scene.yaml").read_text()
    for kept in (
        "# A corridor, scanned in spring.",
        "task: ramps   # for now",
        'title: "A corridor"',
        "# the top of the step\n  - [2.5, 0.0, 0.1]",
        "  - [5.0, 0.0, 0.0]",
        "# By how much a trial moves waypoints.\nwaypoint_noise: [0.0, 0.2]",
        "collision: collision.ply",
    ):
        assert kept in text


def test_a_save_without_a_change_leaves_all_but_the_start_as_it_was(labelling):
    text = (labelling.save() / "scene.yaml").read_text()
    assert text.startswith(SCENE)
    assert text.removeprefix(SCENE).split() == [
        "spawn:",
        "position:",
        "[0.0,",
        "0.0,",
        "0.0]",
        "yaw:",
        "0.0",
    ]


def test_the_place_that_was_moved_and_cropped_is_the_place_that_loads(labelling):
    labelling.mark((2.0, 0.0, 0.1))
    labelling.mark((3.0, 0.0, 0.1))
    labelling.scale_to(1.2)
    labelling.turn("z", 0.3)
    labelling.shift(0.5, -0.2, 0.0)
    labelling.crop_to(CropBox(low=(-1.0, -9.0, -1.0), high=(8.0, 9.0, 1.0)))
    folder = labelling.save()
    scene = load_folder(folder)
    np.testing.assert_allclose(
        scene.static_mesh.triangles.reshape(-1, 9).max(axis=0),
        labelling.mesh.triangles.reshape(-1, 9).max(axis=0),
        atol=1e-5,
    )
    assert scene.static_mesh.vertices[:, 0].max() == pytest.approx(8.0, abs=1e-5)
    np.testing.assert_allclose(scene.T_world_splat, labelling.T_world_splat, atol=1e-9)
    # A splat's point and a mesh's point that were one still are.
    corner = labelling.T_world_splat @ [2.0, 1.5, 0.1, 1.0]
    near = np.linalg.norm(scene.static_mesh.vertices - corner[:3], axis=1).min()
    assert near < 1e-5


def test_a_crop_that_was_saved_can_be_taken_back(labelling):
    before = files_of(labelling.place.folder)
    labelling.crop_to(CropBox(low=(-1.0, -1.0, -1.0), high=(5.0, 1.0, 1.0)))
    labelling.save()
    labelling.crop_to(CropBox(low=(-1.0, -1.0, -1.0), high=(5.5, 1.0, 1.0)))
    folder = labelling.save()
    written = set(files_of(folder)) - set(before)
    assert len(written) == 1  # The first crop's mesh is not left behind.
    assert re.fullmatch(r"collision-[0-9a-f]{12}\.ply", written.pop())
    labelling.undo()
    labelling.undo()
    labelling.save()
    assert set(files_of(folder)) == set(before)
    assert files_of(folder)["collision.ply"] == before["collision.ply"]


def test_the_cameras_of_the_capture_move_with_the_place(tmp_path):
    labelling = photographed(tmp_path)
    labelling.mark((0.0, 0.0, 0.0))
    labelling.mark((1.0, 0.0, 0.0))
    labelling.scale_to(1.5)
    labelling.turn("z", math.pi / 2)
    scene = load_folder(labelling.save())
    corner = labelling.state.placement.matrix @ [*WALK[3], 1.0]
    np.testing.assert_allclose(scene.captures.positions[3], corner[:3], atol=1e-9)
    np.testing.assert_allclose(scene.captures.axes, [[0.0, 1.0, 0.0]] * len(WALK), atol=1e-9)
    # As far apart as the splat says.
    step = np.linalg.norm(np.diff(scene.captures.positions, axis=0), axis=1)
    np.testing.assert_allclose(step, 0.5 * 1.5)
    again = open_labelling(labelling.place.folder)
    np.testing.assert_allclose(again.walk, scene.captures.positions)


def test_cameras_that_a_build_wrote_stay_and_are_named_again_after_an_undo(tmp_path):
    labelling = photographed(tmp_path)
    folder = labelling.place.folder
    before = files_of(folder)
    labelling.nudge_waypoint(0, 0.1, 0.0)
    labelling.save()
    assert set(files_of(folder)) == set(before)
    labelling.shift(1.0, 0.0, 0.0)
    labelling.save()
    written = set(files_of(folder)) - set(before)
    assert sorted(name.split("-")[0] for name in written) == ["captures", "collision"]
    labelling.undo()
    labelling.save()
    assert set(files_of(folder)) == set(before)
    assert files_of(folder)["captures.json"] == before["captures.json"]
    assert "captures: captures.json" in (folder / "scene.yaml").read_text()


def test_a_save_that_cannot_be_loaded_changes_nothing(labelling):
    before = files_of(labelling.place.folder)
    (labelling.place.folder / "collision.ply").write_bytes(b"ply\nno mesh\n")
    labelling.nudge_waypoint(0, 0.1, 0.0)
    with pytest.raises(SceneError):
        labelling.save()
    after = files_of(labelling.place.folder)
    assert after["scene.yaml"] == before["scene.yaml"]
    assert set(after) == set(before)


def test_a_disk_that_fails_at_the_end_changes_nothing(labelling, monkeypatch):
    before = files_of(labelling.place.folder)
    labelling.shift(0.5, 0.0, 0.0)

    def full(path):
        raise StoreError(f"cannot write {path}: no space", fix="free disk space")

    monkeypatch.setattr(files, "atomic_path", full)
    with pytest.raises(StoreError):
        labelling.save()
    assert files_of(labelling.place.folder) == before


def test_without_a_waypoint_nothing_is_saved(tmp_path, labelling):
    without_waypoints(labelling)
    with pytest.raises(UsageError, match="waypoint"):
        labelling.save()
    with pytest.raises(UsageError, match="waypoint"):
        labelling.publish(tmp_path / "out")


def test_a_scene_yaml_that_is_wrong_is_not_opened(tmp_path):
    folder = written_place(tmp_path / "place", scene=SCENE.replace("stairs", "stares"))
    with pytest.raises(SceneError, match="stares"):
        open_labelling(folder)


@pytest.mark.parametrize("task", ["stairs", "ramps"])
def test_the_published_pair_reads_back_to_the_same_course_seen_from_its_start(tmp_path, task):
    labelling = opened(tmp_path, floor(), block(2.0, 1.0, 0.1))
    labelling.turn("x", 0.05)
    labelling.turn("z", 0.7)
    labelling.set_task(task)
    for i in range(10):  # More than ten: their names are sorted as text.
        labelling.add_waypoint((0.1 * i, 0.0, 0.0), index=1)
    labelling.set_start((0.5, -0.3, 0.02), 0.4)
    folder = labelling.publish(tmp_path / "out")
    assert folder.name == ("stairs_corridor" if task == "stairs" else "ramp_corridor")
    T_start_world = np.eye(4)
    c, s = math.cos(0.4), math.sin(0.4)
    T_start_world[:3, :3] = [[c, s, 0], [-s, c, 0], [0, 0, 1]]
    T_start_world[:3, 3] = -T_start_world[:3, :3] @ [0.5, -0.3, 0.02]
    trail = labelling.course.trail @ T_start_world[:3, :3].T + T_start_world[:3, 3]
    vertices = labelling.mesh.vertices @ T_start_world[:3, :3].T + T_start_world[:3, 3]
    for robot in ("go1", "go2"):
        scene = load_published(folder, robot=robot)
        assert scene.task == task
        np.testing.assert_allclose(scene.trail, trail, atol=1e-6)
        np.testing.assert_allclose(
            scene.T_world_splat, T_start_world @ labelling.T_world_splat, atol=1e-6
        )
        np.testing.assert_allclose(scene.static_mesh.vertices, vertices, atol=1e-5)
        assert scene.splat.path.name == "model.pt"


def test_publishing_again_replaces_its_own_folder_and_no_other(tmp_path, labelling):
    folder = labelling.publish(tmp_path / "out")
    labelling.nudge_waypoint(1, 0.5, 0.0)
    assert labelling.publish(tmp_path / "out") == folder
    assert load_published(folder).trail[1, 0] == pytest.approx(5.0)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(StoreError, match=r"notes\.txt"):
        labelling.publish(tmp_path / "out")
    assert (folder / "notes.txt").read_text() == "mine"
    assert [path.name for path in (tmp_path / "out").iterdir()] == [folder.name]


@settings(max_examples=50)
@given(angles=st.tuples(*[st.floats(-3.1, 3.1)] * 3))
def test_euler_angles_are_mujoco_s(angles):
    import mujoco

    matrix, quat, again = np.zeros(9), np.zeros(4), np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.array(angles), "xyz")
    mujoco.mju_quat2Mat(matrix, quat)
    found = published.euler_angles(matrix.reshape(3, 3))
    mujoco.mju_euler2Quat(again, np.array(found), "xyz")
    assert abs(quat @ again) == pytest.approx(1.0, abs=1e-9)


def test_a_place_that_is_not_to_scale_is_saved_in_metres_once_two_points_say_so(tmp_path):
    folder = written_place(tmp_path / "place", scene=UNSCALED)
    with pytest.raises(SceneError, match=r"is not to scale: .*nw-eval twin label"):
        load_folder(folder)
    labelling = open_labelling(folder)
    labelling.nudge_waypoint(0, 0.1, 0.0)
    labelling.save()
    assert "units: unknown" in (folder / "scene.yaml").read_text()
    assert labelling.words.endswith("not to scale")
    with pytest.raises(UsageError, match="not to scale; put two markers"):
        labelling.publish(tmp_path / "published")

    again = open_labelling(folder)
    again.mark((2.0, 0.0, 0.1))
    again.mark((3.0, 0.0, 0.1))
    assert again.distance_words == "1.000 units"
    again.scale_to(0.25)
    again.save()
    assert "units: m\n" in (folder / "scene.yaml").read_text()
    scene = load_folder(folder)
    assert np.ptp(scene.static_mesh.vertices[:, 0]) == pytest.approx(9.0 / 4)
    assert scene.trail[0] == pytest.approx((2.6 / 4, 0.0, 0.1 / 4), abs=1e-4)
    assert np.linalg.det(scene.T_world_splat[:3, :3]) == pytest.approx(1 / 64)


def test_a_save_clears_away_what_one_that_was_killed_has_left(labelling):
    folder = labelling.save()
    before = {path.name for path in folder.iterdir()}
    (folder / ".label-killed").mkdir()
    (folder / ".label-killed" / "collision.ply").write_bytes(b"half")
    labelling.save()
    assert {path.name for path in folder.iterdir()} == before
