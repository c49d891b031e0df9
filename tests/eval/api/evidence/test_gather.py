"""What logs of a real run show, whole and damaged, forged and missing."""

import random
import shutil
import subprocess
import sys
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from PIL import Image

from nw_eval import api
from nw_eval.api import evidence as evidence_module
from nw_eval.api.evidence import gather_evidence
from nw_eval.api.evidence_log import ReadLogs, read_logs
from nw_gate.results.run_folder import RunFolder
from nw_sim.rollout.mcap.messages import Event
from nw_sim.rollout.mcap.reader import LogReader


def gathered(run):
    folder, rows = run
    return gather_evidence(RunFolder(path=folder), rows)


def logs(run):
    folder, rows = run
    return {row.trial_id: folder / row.mcap_path for row in rows}


@pytest.fixture(scope="module")
def whole(recorded):
    """Return the run as it was recorded, and what is gathered of it."""
    run = (recorded.folder, recorded.rows)
    return run, gathered(run)


def test_a_walk_is_where_the_log_says_that_the_trunk_was(whole):
    run, evidence = whole
    found = {path.trial_id: path.points for path in evidence.paths}
    assert sorted(found) == sorted(logs(run))
    for trial, log in logs(run).items():
        poses = [m.pose.position for _, _, m in LogReader(log).messages("/robot/odom")]
        walked = np.array([(p.x, p.y) for p in poses])
        np.testing.assert_allclose(found[trial][[0, -1]], walked[[0, -1]], atol=2e-3)
        np.testing.assert_allclose(found[trial][1:-1], walked[5:-1:5], atol=2e-3)


def test_points_of_a_walk_are_a_tenth_of_a_second_apart(whole):
    _, evidence = whole
    assert {path.period for path in evidence.paths} == {0.1}


def test_a_place_has_the_mean_waypoints_of_its_trials_inside_its_picture(whole):
    run, evidence = whole
    (place,) = evidence.places
    trails = []
    for log in logs(run).values():
        _, _, first = next(LogReader(log).messages("/waypoints"))
        discs = [entity.cylinders[0].pose.position for entity in first.entities]
        trails.append([(disc.x, disc.y) for disc in discs])
    np.testing.assert_allclose(place.waypoints, np.mean(trails, axis=0), atol=1e-3)
    assert place.reach == pytest.approx(0.3)
    picture = place.picture
    assert (picture.west, picture.south) < tuple(place.waypoints.min(axis=0))
    assert (picture.east, picture.north) > tuple(place.waypoints.max(axis=0))
    with Image.open(BytesIO(picture.data)) as image:
        across, up = picture.east - picture.west, picture.north - picture.south
        assert image.width / image.height == pytest.approx(across / up, rel=0.02)
    # What is said of a scene's view stands beneath it, and not under the worst trials.
    assert place.note.startswith("Waypoints differ between trials: each is drawn at its mean")
    assert not any("aypoints" in remark for remark in evidence.remarks)


def test_a_clip_ends_with_the_last_picture_of_the_log_and_says_whose_eyes_they_are(whole):
    run, evidence = whole
    clips = {clip.trial_id: clip for clip in evidence.clips}
    for trial, log in logs(run).items():
        frames = list(LogReader(log).frames())
        clip = clips[trial]
        with Image.open(BytesIO(clip.data)) as moving:
            assert moving.n_frames == len(frames) > 3
            moving.seek(moving.n_frames - 1)
            shown = np.asarray(moving.convert("RGB"), np.float64)
        assert np.abs(shown - frames[-1][1]).mean() < 10.0
        assert np.abs(shown - 255.0 + frames[-1][1]).mean() > 40.0
        assert clip.seconds == pytest.approx(frames[-1][0] - frames[0][0], abs=1e-3)
        assert "this policy sees no pictures" in clip.caption
        assert "On its way to waypoint 1 of 2" in clip.caption


def test_the_eyes_are_the_policy_s_where_its_images_were_measured(run):
    folder, rows = run
    seeing = [replace(row, coverage_min=0.9, coverage_mean=0.95) for row in rows]
    captions = [clip.caption for clip in gathered((folder, seeing)).clips]
    assert len(captions) == 2
    assert all("what the policy saw (/camera/ego)" in caption for caption in captions)


def test_the_same_logs_show_the_same(whole):
    (folder, rows), one = whole
    two = gathered((folder, rows[::-1]))
    assert [clip.data for clip in one.clips] == [clip.data for clip in two.clips]
    assert [place.picture for place in one.places] == [place.picture for place in two.places]
    assert one.remarks == two.remarks


def chunk_bomb(path):
    """Write a log of 64 MiB of nothing in some kilobytes."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=2**27)
        writer.start()
        schema = writer.register_schema(name="x", encoding="", data=b"")
        channel = writer.register_channel(
            schema_id=schema, topic="/robot/path", message_encoding="protobuf"
        )
        writer.add_message(channel, 0, bytes(64 * 2**20), 0)
        writer.finish()


def elses(path):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()


DAMAGE = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-5000]),
    "empty": lambda path: path.write_bytes(b""),
    "noise": lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
    "bomb": chunk_bomb,
    "another program's": elses,
}


def test_a_damaged_log_costs_its_own_part_and_a_remark(run):
    folder, rows = run
    whole = folder / rows[0].mcap_path
    damaged = []
    for kind, damage in DAMAGE.items():
        path = whole.with_name(f"{kind}.mcap")
        shutil.copyfile(whole, path)
        damage(path)
        damaged.append(replace(rows[0], trial_id=kind, mcap_path=str(path.relative_to(folder))))
    evidence = gathered((folder, [*damaged, rows[1]]))
    assert [path.trial_id for path in evidence.paths] == [rows[1].trial_id]
    assert [clip.trial_id for clip in evidence.clips] == [rows[1].trial_id]
    assert evidence.places[0].picture is not None
    *faults, more = evidence.remarks
    assert evidence.of_paths.startswith("Paths of 1 of 6 trials are drawn")
    assert [fault.split(" shows nothing: ")[0] for fault in faults] == [
        f"The log of {kind}" for kind in sorted(DAMAGE)[:3]
    ]
    assert more == "The same is true of 2 more logs."


DEADLY = """\
import os
from pathlib import Path
from nw_eval.api.evidence_log import read_logs as read

def read_logs(wanted, clips, room):
    if any(Path(path).read_bytes() == b"deadly" for path, _ in wanted):
        os._exit(11)
    return read(wanted, clips, room)
"""


def test_a_log_that_ends_its_reader_costs_only_itself(run, tmp_path, monkeypatch):
    (tmp_path / "deadly_reader.py").write_text(DEADLY)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(evidence_module, "read_logs", __import__("deadly_reader").read_logs)
    first, second = sorted(logs(run))
    logs(run)[first].write_bytes(b"deadly")
    evidence = gathered(run)
    assert [path.trial_id for path in evidence.paths] == [second]
    assert f"The log of {first} shows nothing: the process that read it ended." in evidence.remarks


def test_what_lies_outside_of_the_folder_is_not_read(run, tmp_path):
    folder, rows = run
    outside = tmp_path / "outside.mcap"
    logs(run)[rows[0].trial_id].rename(outside)
    named = replace(rows[0], mcap_path="../outside.mcap")
    assert [path.trial_id for path in gathered((folder, [named, rows[1]])).paths] == [
        rows[1].trial_id
    ]
    logs(run)[rows[0].trial_id].symlink_to(outside)
    assert [path.trial_id for path in gathered(run).paths] == [rows[1].trial_id]


def test_without_logs_there_is_a_sentence_and_nothing_to_read(run):
    for log in logs(run).values():
        log.unlink()
    evidence = gathered(run)
    assert not evidence.paths + evidence.places + evidence.clips
    assert evidence.of_paths.startswith("Paths of 0 of 2 trials are drawn")


def rewritten(path, topic, change):
    """Write a log again with the messages of a topic changed."""
    data = path.read_bytes()
    with path.open("wb") as stream:
        writer, known = Writer(stream), {}
        writer.start()
        for schema, channel, message in make_reader(BytesIO(data)).iter_messages():
            if channel.topic not in known:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.topic] = writer.register_channel(
                    topic=channel.topic, message_encoding="protobuf", schema_id=number
                )
            changed = change(message.data) if channel.topic == topic else message.data
            writer.add_message(known[channel.topic], message.log_time, changed, message.log_time)
        writer.finish()


def read(log):
    """Return what a log shows, read by this very process."""
    answer = read_logs([(str(log), "a")], [str(log)], {"picture": 20_000, "clip": 100_000})
    return ReadLogs.model_validate_json(answer).logs[0]


def test_a_robot_that_was_flung_away_does_not_stretch_the_map(run):
    def flung(data):
        cloud = PointCloud.FromString(data)
        rows = np.frombuffer(cloud.data, "<f4").reshape(-1, 4).copy()
        rows[3:, 0] = 3e8
        cloud.data = rows.tobytes()
        return cloud.SerializeToString()

    log = min(logs(run).values())
    whole = read(log)
    rewritten(log, "/robot/path", flung)
    assert read(log).walked == whole.walked[:3]
    assert len(whole.walked) > 3


def test_a_contact_is_shown_at_its_time(run):
    def touching(data):
        event = Event.FromString(data)
        event.kind = "contact" if event.kind == "end" else event.kind
        return event.SerializeToString()

    log = min(logs(run).values())
    end = max(t for _, t, _ in LogReader(log).messages("/nw/event")) * 1e-9
    assert read(log).contacts == ()
    rewritten(log, "/nw/event", touching)
    assert read(log).contacts == (pytest.approx(end, abs=1e-3),)


def test_pictures_that_are_damaged_cost_their_clip_and_not_the_walk(run):
    log = min(logs(run).values())
    whole = read(log)
    damaged = CompressedImage(format="jpeg", data=b"\xff\xd8 no").SerializeToString()
    rewritten(log, "/camera/ego", lambda _: damaged)
    found = read(log)
    assert whole.clip is not None
    assert not whole.unseen
    assert found.clip is None
    assert "cannot identify image" in found.unseen
    assert found.walked == whole.walked


def test_no_damage_is_more_than_a_fault(run):
    folder, rows = run
    log, rng = folder / rows[0].mcap_path, random.Random(3)
    data, faults = log.read_bytes(), 0
    for _ in range(60):
        changed = bytearray(data)
        at = rng.randrange(len(changed))
        changed[at : at + 8] = rng.choice([rng.randbytes(8), b"", b"\xff" * 8, bytes(8)])
        log.write_bytes(changed)
        faults += bool(read(log).fault)
    assert faults > 30


def test_reading_logs_loads_no_simulation(whole):
    (folder, rows), _ = whole
    log = str(folder / rows[0].mcap_path)
    code = (
        "import sys\n"
        "import nw_eval.api.evidence\n"
        "from nw_eval.api.evidence_log import read_logs\n"
        f"answer = read_logs([({log!r}, 'a')], [{log!r}], {{'picture': 20000, 'clip': 100000}})\n"
        "heavy = {'mujoco', 'torch', 'numba', 'onnxruntime', 'trimesh', 'matplotlib'}\n"
        "print(len(answer) > 5000, sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True []\n"


def test_a_report_shows_what_is_left_and_judges_as_before(run, recorded):
    folder, rows = run
    log = folder / rows[0].mcap_path
    log.write_bytes(log.read_bytes()[:-5000])
    judged = api.report(folder)
    page = judged.html.read_text(encoding="utf-8")
    assert judged.verdict == recorded.verdict
    assert f"The log of {rows[0].trial_id} shows nothing: " in page
    # A place; the trial as the robot saw it and from outside, moving and standing.
    assert page.count("data:image/webp") == 5
    assert 'alt="candidate"' in page
    assert page.count(f"<title>{rows[1].trial_id}: ") == 2  # A walk and its end.
