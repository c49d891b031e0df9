"""`nw-eval replay LOG --layout`, and what it says where it cannot."""

import json
import sys
from types import SimpleNamespace

import pytest

from nw_base.errors import PrerequisiteError, StoreError, UsageError
from nw_base.lens import Distortion, Intrinsics
from nw_eval.cli import main
from nw_eval.viewing.recording.content import picture_view, write_layout, write_recording
from nw_sim.rollout.mcap.file import McapFile
from nw_sim.rollout.mcap.images import calibration_message
from nw_sim.rollout.mcap.reader import LogReader


def ends(*arguments):
    """Run `nw-eval replay` and return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(["replay", *map(str, arguments)])
    return ended.value.code


def test_foxglove_s_layout_is_printed_or_written_and_names_what_the_log_has(
    walked_log, tmp_path, capsys
):
    assert ends(walked_log, "--layout", "foxglove") == 0
    printed = capsys.readouterr().out
    panels = json.loads(printed)["configById"]
    assert panels["Image!0"] == {"imageMode": {"imageTopic": "/camera/ego"}}
    assert [path["label"] for path in panels["Plot!2"]["paths"][:2]] == ["ang_vel x", "ang_vel y"]
    out = tmp_path / "layout.json"
    assert ends(walked_log, "--layout", "foxglove", "--out", out) == 0
    assert out.read_text() == printed


def test_a_log_without_pictures_or_names_is_laid_out_without_them(walked_log, tmp_path, capsys):
    old = tmp_path / "old.mcap"
    file = McapFile(old, images="drop")
    for topic, time, message in LogReader(walked_log).messages():
        if not topic.startswith(("/camera/", "/points/waypoints")):
            file.add(topic, time, message)
    file.close()
    assert ends(old, "--layout", "foxglove") == 0
    panels = json.loads(capsys.readouterr().out)["configById"]
    assert not [name for name in panels if name.startswith("Image")]
    assert len([name for name in panels if name.startswith("Plot")]) == 2
    assert panels["RawMessages!observation"]["topicPath"] == "/observation/proprio"


def test_the_view_of_a_camera_with_distortion_is_called_so():
    lens = Intrinsics(width=40, height=24, fx=40.0, fy=40.0, cx=20.0, cy=12.0)
    bent = lens.model_copy(
        update={"distortion": Distortion(model="fisheye", coefficients=(0.01, 0.0, 0.0, 0.0))}
    )
    track = SimpleNamespace(entity=lambda *parts: "/" + "/".join(parts))
    for seen, name in ((lens, "/world/camera/ego"), (bent, "/world/camera/ego, distorted")):
        messages = {"/camera/ego/calib": [(0, calibration_message(0, "ego", seen))]}
        assert picture_view(track, messages, "/camera/ego") == ("/world/camera/ego", name)


@pytest.mark.parametrize("write", [write_layout, write_recording])
@pytest.mark.parametrize("installed", [None, type(sys)("rerun")])
def test_without_rerun_the_error_names_the_extra(
    walked_log, tmp_path, monkeypatch, write, installed
):
    monkeypatch.setitem(sys.modules, "rerun", installed)
    with pytest.raises(PrerequisiteError, match=r"pip install 'nw-eval\[rerun\]'"):
        write(walked_log, tmp_path / "x.rrd")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--rrd", "x.rrd", "--start", "1"), "--start is for running the trial again"),
        (("--layout", "foxglove", "--picture", "x.png"), "--picture is for running"),
        (("--out", "x.json"), "--out is where --layout writes"),
        (("--layout", "rviz"), "rviz"),
    ],
)
def test_options_that_do_not_go_together_are_usage_errors(walked_log, arguments, words, capsys):
    assert ends(walked_log, *arguments) == 2
    assert words in capsys.readouterr().err


def test_no_log_is_a_usage_error_and_a_folder_that_cannot_be_written_one_of_storage(
    walked_log, tmp_path, capsys
):
    assert ends(tmp_path / "none.mcap", "--layout", "foxglove") == 2
    taken = tmp_path / "file"
    taken.write_text("")
    assert ends(walked_log, "--layout", "foxglove", "--out", taken / "x.json") == 4
    assert len(capsys.readouterr().err.splitlines()) == 2


def test_rerun_s_layout_is_a_blueprint_and_the_commands_that_use_it(walked_log, tmp_path, capsys):
    chunk = pytest.importorskip("rerun.chunk", reason="needs the extra rerun")
    out = tmp_path / "a layout.rbl"
    assert ends(walked_log, "--layout", "rerun", "--out", out) == 0
    path, convert, show = capsys.readouterr().out.splitlines()
    assert path == str(out)
    assert convert.startswith("rerun mcap convert --application-id nw-eval ")
    assert show == f"rerun '{out}' '{tmp_path}/a layout.rrd'"
    [blueprint] = chunk.RrdReader(out).blueprints()
    assert blueprint.application_id == "nw-eval"
    for name in ("x.txt", "x.rrd"):
        with pytest.raises(UsageError, match=r"by \.rbl"):
            write_layout(walked_log, tmp_path / name)
    with pytest.raises(UsageError, match=r"by \.rrd"):
        write_recording(walked_log, tmp_path / "x.rbl")


def test_a_file_that_is_no_log_is_an_error_of_storage(tmp_path):
    pytest.importorskip("rerun", reason="needs the extra rerun")
    (tmp_path / "x.mcap").write_bytes(b"no log")
    with pytest.raises(StoreError):
        write_recording(tmp_path / "x.mcap", tmp_path / "x.rrd")
    with pytest.raises(StoreError):
        write_layout(tmp_path / "x.mcap", tmp_path / "x.rbl")
