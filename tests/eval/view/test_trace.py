"""What a page shows of a log is what the log says."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import nw_eval
from nw_base.errors import StoreError, UsageError
from nw_eval.view.drawing import aim_along
from nw_eval.view.sources import open_shelf
from nw_eval.view.trace import APART, parting, read_trace
from nw_gate.results.moment_link import PORT, MomentLink, read_link
from nw_sim.rollout.mcap.reader import LogReader

SUITE = """\
nw-eval: 1
name: looked-at
robot: go1
policy: go1-parkour
trials: 2
seed: 7
episode: {duration: 1.6}
scenes: [hurdles/one_low_carpet]
record: all
"""
FIRST, SECOND = "hurdles-one_low_carpet-000", "hurdles-one_low_carpet-001"


@pytest.fixture(scope="module")
def trace(log):
    return read_trace(log)


@pytest.mark.nightly
def test_poses_are_those_of_the_log(trace, log):
    for place, (time, poses) in enumerate(LogReader(log).poses()):
        assert trace.times[place] == pytest.approx(time)
        for name in ("trunk", "FL_foot"):
            if name in poses:
                np.testing.assert_array_equal(trace.bodies[name][0][place], poses[name][0])
    assert trace.end == pytest.approx(1.6)
    np.testing.assert_array_equal(trace.trunk, trace.bodies["trunk"][0])


def test_a_moment_is_shown_as_the_newest_pose_before_it(trace):
    assert trace.at(0.5) == trace.at(0.519) == trace.at(0.52) - 1
    assert trace.at(-1.0) == 0
    assert trace.at(99.0) == len(trace.times) - 1


def test_plots_have_a_value_for_each_joint_and_step(trace):
    titles = {series.title: series for series in trace.series}
    joints = titles["Joint angles, rad"]
    assert joints.values.shape == (len(joints.times), 12)
    assert joints.names[0] == "FR_hip"
    assert np.ptp(joints.values) > 0.5
    assert titles["Command, m/s and rad"].names == ("forward", "heading error")


def test_events_are_told_with_their_times_and_the_first_line_is_none(trace):
    assert trace.events
    assert all(0.0 < time <= trace.end for time, _ in trace.events)
    assert any(words.startswith("timeout") for _, words in trace.events)


def test_trials_part_where_their_trunks_are_first_apart(trace, runs):
    standing = read_trace(next(runs[1].rglob(f"{FIRST}.mcap")))
    apart = parting(trace, standing)
    assert 0.0 < apart < 1.6
    place = trace.at(apart)
    distance = np.linalg.norm(trace.trunk - standing.trunk, axis=1)
    assert distance[place] > APART
    assert (distance[:place] <= APART).all()
    assert parting(trace, trace) is None


def test_a_shelf_has_a_runs_trials_and_their_rivals(runs):
    shelf = open_shelf(runs[0], runs[1])
    assert list(shelf.logs) == [FIRST, SECOND]
    traces, splat = shelf.load(FIRST)
    assert [each.logged.job.policy_name for each in traces] == ["go1-parkour", "stand"]
    assert len(splat.centers) > 100_000
    (_, _, other), _ = shelf.load(FIRST, others=1)
    assert other.name == SECOND
    assert shelf.beside(SECOND) == [FIRST]


def test_two_logs_go_together_whatever_they_are_called(log, runs, tmp_path):
    renamed = shutil.copy(next(runs[1].rglob(f"{SECOND}.mcap")), tmp_path / "b.mcap")
    traces, _ = open_shelf(log, renamed).load(log.stem)
    assert [each.name for each in traces] == [FIRST, SECOND]


def test_a_ghost_of_another_place_is_left_out(log, monkeypatch):
    shelf = open_shelf(log, log)
    elsewhere = read_trace(log)
    job = elsewhere.logged.job
    job = replace(job, trial=replace(job.trial, scene_digest="0" * 64))
    elsewhere = replace(elsewhere, logged=replace(elsewhere.logged, job=job))
    found = iter([read_trace(log), elsewhere])
    monkeypatch.setattr("nw_eval.view.sources.read_trace", lambda _: next(found))
    assert len(shelf.load(log.stem)[0]) == 1


def test_what_cannot_be_shown_is_said(runs, log, tmp_path):
    with pytest.raises(UsageError, match="nothing at"):
        open_shelf(tmp_path / "nowhere")
    with pytest.raises(UsageError, match=r"no run\.json"):
        open_shelf(tmp_path)
    renamed = shutil.copy(log, tmp_path / "other.mcap")
    with pytest.raises(UsageError, match="no trial of the same name"):
        open_shelf(runs[0], renamed)
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(log.read_bytes()[:5000])
    with pytest.raises(StoreError):
        read_trace(torn)


@given(
    run=st.text(st.characters(codec="utf-8"), max_size=20),
    trial=st.text(st.characters(codec="utf-8"), min_size=1, max_size=20),
    time=st.integers(0, 100_000).map(lambda number: number / 100),
)
def test_a_link_is_read_as_it_was_written(run, trial, time):
    link = MomentLink(run=run, trial=trial, time=time)
    assert link.url.startswith(f"http://localhost:{PORT}/?")
    assert read_link(link.url.removeprefix(f"http://localhost:{PORT}")) == link


@pytest.mark.parametrize("path", ["/", "/?", "/assets/x.js", "/?websocket=ws://x", "/?run=a"])
def test_a_request_without_a_moment_is_no_link(path):
    assert read_link(path) is None


@pytest.mark.parametrize("time", ["nan", "inf", "soon", "", "1e999"])
def test_a_time_that_is_none_is_the_beginning(time):
    assert read_link(f"/?trial=a&t={time}").time == 0.0


SEES = """\
nw-policy: 1
name: sees
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25}
observations:
  rgb: {sensor: splat_rgb, camera: ego, width: 16, height: 9, rate: 10}
"""


def test_pictures_of_the_head_are_said_to_be_seen_only_where_the_policy_was_given_some(
    trace, tmp_path
):
    assert len(trace.frames[0])
    assert not trace.is_seen  # go1-parkour is told heights, and given no picture.
    (tmp_path / "sees").mkdir()
    (tmp_path / "sees/policy.yaml").write_text(SEES)
    suite = tmp_path / "suite.yaml"
    suite.write_text(SUITE.replace("trials: 2", "trials: 1").replace("1.6", "0.2"))
    out = tmp_path / "run"
    nw_eval.run(suite, policy=str(tmp_path / "sees"), out=out, in_process=True)
    seen = read_trace(next(out.rglob("*.mcap")))
    assert seen.is_seen
    assert len(seen.frames[0])


def test_a_task_without_waypoints_is_looked_at_along_its_walk_and_else_ahead():
    walked, stood, along = SimpleNamespace(), SimpleNamespace(), np.array([[0.0, 0.0, 0.3]] * 2)
    aim_along(stood, along)
    assert np.linalg.norm((stood.position - stood.look_at)[:2]) > 0.5
    aim_along(walked, np.array([[0.0, 0.0, 0.3], [0.0, 4.0, 0.3]]))
    assert (walked.look_at - walked.position)[1] > 1.0


def test_the_log_of_a_task_without_waypoints_has_none(tmp_path):
    suite = SUITE.replace("go1-parkour", "stand").replace("record: all", "task: stand")
    (tmp_path / "still.yaml").write_text(
        suite.replace("1.6", "0.4").replace("trials: 2", "trials: 1")
    )
    run = nw_eval.run(str(tmp_path / "still.yaml"), out=tmp_path / "run", in_process=True)
    trace = read_trace(tmp_path / "run" / run.rows[0].mcap_path)
    assert trace.waypoints.shape == (0, 3)
    assert len(trace.trunk) == 21
