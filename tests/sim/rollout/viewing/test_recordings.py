"""`nw-eval replay LOG --rrd`: a log as Rerun's own, read back by Rerun."""

import resource
from collections import defaultdict

import numpy as np
import pytest

from nw_base.errors import StoreError
from nw_eval.cli import main
from nw_eval.viewing.recording import content
from nw_eval.viewing.recording.content import write_recording
from nw_sim.rollout.mcap.file import McapFile
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.trial import run_trial
from nw_splat.files import read_splat

chunk = pytest.importorskip("rerun.chunk", reason="needs the extra rerun")


def entities(path):
    """Return what a recording holds: by entity and component, (times in ns, values)."""
    found = defaultdict(lambda: defaultdict(lambda: ([], [])))
    for part in chunk.RrdReader(path).stream():
        batch = part.to_record_batch()
        assert set(part.timeline_names) <= {"sim_time"}, "no time of day"
        times = [None] * len(batch)
        if "sim_time" in batch.schema.names:
            times = batch.column("sim_time").cast("int64").to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                values = found[part.entity_path][name]
                values[0].extend(times)
                values[1].extend(batch.column(name).to_pylist())
    return found


@pytest.fixture(scope="module")
def recorded(walked_log, library, tmp_path_factory):
    """Return what was written of the log, and what is in it."""
    out = tmp_path_factory.mktemp("rerun") / "walked.rrd"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(content, "Library", lambda: library)
        written = write_recording(walked_log, out)
    return written, entities(out)


def test_the_place_is_meshes_that_cover_what_rays_meet(recorded, library):
    _, found = recorded
    mesh = library.only.mesh()
    meshes = {path for path in found if path.startswith("/world/place/")}
    corners = []
    for path in meshes:
        (_, [positions]) = found[path]["Mesh3D:vertex_positions"]
        (_, [normals]) = found[path]["Mesh3D:vertex_normals"]
        assert len(positions) == len(normals)
        corners.append(np.array(positions))
    corners = np.concatenate(corners)
    assert len(corners) == 3 * len(mesh.faces)
    np.testing.assert_allclose(corners.min(axis=0), mesh.triangles.min(axis=(0, 1)), atol=1e-5)
    np.testing.assert_allclose(corners.max(axis=0), mesh.triangles.max(axis=(0, 1)), atol=1e-5)


def test_the_robot_is_shapes_under_bodies_that_move_as_in_the_log(recorded, messages):
    _, found = recorded
    times, positions = found["/world/robot/trunk"]["Transform3D:translation"]
    _, turns = found["/world/robot/trunk"]["Transform3D:quaternion"]
    expected = [
        (time, pose)
        for time, message in messages["/tf"]
        for pose in message.transforms
        if pose.child_frame_id == "trunk"
    ]
    assert times == [time for time, _ in expected]
    for [position], [turn], (_, pose) in zip(positions, turns, expected, strict=True):
        t, q = pose.translation, pose.rotation
        assert position == pytest.approx([t.x, t.y, t.z], abs=1e-6)
        assert turn == pytest.approx([q.x, q.y, q.z, q.w], abs=1e-6)
    shapes = {path for path in found if path.startswith("/world/robot/trunk/")}
    assert shapes, "the trunk has something to see"
    drawn = {kind.split("/")[-1] for path in found for kind in [path] if "/robot/" in path}
    assert drawn & {"boxes", "cylinders", "ellipsoids"}


def test_trail_waypoints_and_path_are_lines_and_discs(recorded, messages):
    _, found = recorded
    _, [[trail]] = found["/world/trail/line"]["LineStrips3D:strips"]
    assert len(trail) == 3, "the start and two waypoints"
    times, colours = found["/world/waypoints"]["Cylinders3D:colors"]
    assert times == [time for time, _ in messages["/waypoints"]]
    assert len(colours[0]) == 2
    times, paths = found["/world/path"]["LineStrips3D:strips"]
    assert times == [time for time, _ in messages["/robot/path"]]
    assert len(paths[-1][0]) > len(paths[0][0])


def test_pictures_are_those_of_the_log_at_their_camera(recorded, messages):
    _, found = recorded
    camera = found["/world/camera/ego"]
    times, blobs = camera["EncodedImage:blob"]
    assert dict(zip(times, [bytes(blob) for [blob] in blobs], strict=True)) == {
        time: message.data for time, message in messages["/camera/ego"]
    }
    assert camera["Pinhole:resolution"][1] == [[[160.0, 90.0]]]
    assert not [name for name in camera if name.startswith("Distortion")]
    assert len(camera["Transform3D:translation"][1]) == len(messages["/tf"])


def test_numbers_are_scalars_with_names_on_the_simulated_time(recorded, walked_log, messages):
    _, found = recorded
    times, rows = found["/joints/position"]["Scalars:scalars"]
    assert times == [time for time, _ in messages["/robot/joints"]]
    last = [joint.position for joint in messages["/robot/joints"][-1][1].joints]
    assert rows[-1] == last
    assert found["/joints/position"]["SeriesLines:names"][1][0][0] == "FR_hip_joint"
    _, actions = found["/policy/action"]["Scalars:scalars"]
    assert actions == [list(message.action) for _, message in messages["/nw/policy"]]
    log = LogReader(walked_log)
    [angles] = [path for path in found if path.startswith("/observation/proprio/06")]
    assert "joint_pos" in angles
    _, values = found[angles]["Scalars:scalars"]
    first = log.elements()["/observation/proprio"].index("joint_pos FR_hip")
    seen = [row[first : first + 12].tolist() for _, row in log.observations("proprio")]
    assert values == seen
    assert found[angles]["SeriesLines:names"][1][0][3] == "joint_pos FL_hip"


def test_the_splat_is_rerun_s_own_gaussians_in_the_world(recorded, library):
    written, found = recorded
    gaussians = read_splat(library.only.splat_store())
    assert (written.gaussians, written.no_splat) == (len(gaussians), "")
    _, [centres] = found["/world/splat"]["GaussianSplats3D:centers"]
    np.testing.assert_allclose(centres, gaussians.means, atol=1e-6)
    _, [scales] = found["/world/splat"]["GaussianSplats3D:scales"]
    np.testing.assert_allclose(scales, np.exp(gaussians.log_scales), rtol=1e-5)


def test_a_recording_has_a_layout_and_an_identity_that_stay_the_same(
    recorded, walked_log, library, tmp_path, monkeypatch
):
    written, found = recorded
    monkeypatch.setattr(content, "Library", lambda: library)
    again = write_recording(walked_log, tmp_path / "again.rrd")
    first, second = chunk.RrdReader(written.file), chunk.RrdReader(again.file)
    [one], [other] = first.recordings(), second.recordings()
    assert (one.application_id, one.recording_id) == ("nw-eval", other.recording_id)
    assert one.recording_id.startswith("flat-carpet_room-000-")
    assert len(first.blueprints()) == 1
    assert entities(again.file) == found


def test_a_place_that_is_another_now_costs_the_splat_only(walked_log, tmp_path, capsys):
    # The log's room has a splat of blobs, which nobody else has.
    out = tmp_path / "there" / "walked.rrd"
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(walked_log), "--rrd", str(out)])
    assert ended.value.code == 0
    assert "no splat (scene flat/carpet_room has changed since)" in capsys.readouterr().out
    assert "/world/splat" not in entities(out)


def test_depth_and_numbers_of_an_image_are_pictures_too(make_job, library, tmp_path):
    (tmp_path / "policy.yaml").write_text(DEPTH_CARD)
    path = tmp_path / "depth.mcap"
    run_trial(
        make_job(policy=str(tmp_path), mcap=path, record="all", duration=0.3), library=library
    )
    written = write_recording(path, tmp_path / "depth.rrd")
    found = entities(written.file)
    assert found["/world/camera/ego\\ metres"]["DepthImage:meter"][1][0] == [1000.0]
    assert "Image:buffer" in found["/world/camera/ego\\ near"]


def test_a_camera_with_distortion_says_what_its_pinhole_lacks(make_job, library, tmp_path):
    (tmp_path / "policy.yaml").write_text(DEPTH_CARD + DISTORTED)
    path = tmp_path / "bent.mcap"
    run_trial(
        make_job(policy=str(tmp_path), mcap=path, record="all", duration=0.1), library=library
    )
    camera = entities(write_recording(path, tmp_path / "bent.rrd").file)[
        "/world/camera/ego\\ metres"
    ]
    assert camera["Pinhole:resolution"][1] == [[[40.0, 24.0]]]
    assert camera["Distortion:coefficients"][1] == [[-0.1, 0.01, 0.0, 0.0, 0.0]]
    assert camera["Distortion:model"][1] == [["plumb_bob"]]
    assert "Rerun knows no distortion" in camera["Distortion:note"][1][0][0]


DISTORTED = """\
cameras:
  ego:
    intrinsics:
      {width: 40, height: 24, fx: 40.0, fy: 40.0, cx: 20.0, cy: 12.0,
       distortion: {model: radial_tangential, coefficients: [-0.1, 0.01, 0.0, 0.0]}}
"""

DEPTH_CARD = """\
nw-policy: 1
name: depth
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25, delay_steps: 1}
observations:
  metres: {sensor: depth, width: 40, height: 24, rate: 10}
  near: {sensor: depth, width: 40, height: 24, rate: 10, mode: linear}
"""


@pytest.mark.parametrize("fault", ["picture", "joints", "empty"])
def test_a_damaged_log_is_an_error_of_one_line_and_leaves_no_file(
    walked_log, tmp_path, fault, capsys
):
    broken = tmp_path / "broken.mcap"
    source = LogReader(walked_log)
    file = McapFile(broken, images="keep")
    for name, values in source.metadata().items():
        file.add_metadata(name, values)
    for topic, time, message in source.messages():
        if fault == "picture" and topic == "/camera/ego":
            message.data = b"no picture"
        if fault == "joints" and topic == "/robot/joints" and time > 0:
            del message.joints[3:]
        if fault != "empty":
            file.add(topic, time, message)
    file.close()
    out = tmp_path / "broken.rrd"
    with pytest.raises(StoreError, match=r"broken\.mcap"):
        write_recording(broken, out)
    assert not out.exists()
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(broken), "--rrd", str(out)])
    assert ended.value.code == 4
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_disk_that_takes_no_more_is_an_error_of_storage_and_leaves_no_file(walked_log, tmp_path):
    out = tmp_path / "large.rrd"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(StoreError, match=r"large\.rrd.*Rerun could not write all of it"):
            write_recording(walked_log, out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_a_stranger_s_words_are_one_part_of_an_entity_and_no_more(walked_log, tmp_path):
    wicked = "a/b\x1b[31m\n\u202e**c**"
    source = LogReader(walked_log)
    path = tmp_path / "wicked.mcap"
    file = McapFile(path, images="drop")
    for name, values in source.metadata().items():
        file.add_metadata(name, values)
    for topic, time, message in source.messages():
        if topic == "/observation/proprio":
            message.terms[0].name = wicked
        if not topic.startswith("/camera/"):
            file.add(topic, time, message)
    file.close()
    found = entities(write_recording(path, tmp_path / "wicked.rrd").file)
    named = [entity for entity in found if entity.startswith("/observation/proprio/00")]
    assert len(named) == 1
    assert not {"\x1b", "\n", "\u202e"} & set(named[0])
    assert not [entity for entity in found if entity.startswith("/world/camera")]
