"""Each image that a policy is given is compared with from where the place was photographed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from nw_scenes.scene import CaptureCameras, Nearness
from nw_sim.rollout.episode import CapturedViews
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.replaying.logged import read_logged_trial
from nw_sim.rollout.replaying.policy_switch import run_on
from nw_sim.rollout.trial import run_trial


def views(*images):
    found = CapturedViews()
    for step, distance, angle, alpha in images:
        found.add(step, Nearness(distance, angle), alpha)
    return found


def test_each_tenth_of_a_second_has_the_worst_of_its_images():
    found = views((0, 0.1, 0.2, 0.9), (4, 0.3, 0.1, 1.0), (5, 0.2, 0.5, 0.7))
    assert found.distance == [0.3, 0.2]
    assert found.angle == [0.2, 0.5]
    assert found.alpha == [0.9, 0.7]


def test_what_is_restored_goes_on_as_if_nothing_had_been():
    first, again = views((0, 0.1, 0.2, 0.9), (6, 0.3, 0.1, 0.8)), CapturedViews()
    again.restore(first.state())
    for each in (first, again):
        each.add(7, Nearness(0.2, 0.4), 0.85)
    assert again.state() == first.state()
    empty = CapturedViews()
    empty.restore(empty.state())
    assert empty.alpha == []


def frames(path):
    """The compressed images of the policy's camera in a log."""
    with path.open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/camera/ego"])
        return [message.data for _, _, message in messages]


@pytest.fixture
def photographed(library, monkeypatch):
    """The blob room with a camera 1 m aside of where the robot stands, that looks its way."""
    cameras = CaptureCameras(
        positions=np.array([[0.0, 1.0, 0.3]]), axes=np.array([[1.0, 0.0, 0.0]])
    )
    monkeypatch.setattr(library, "only", replace(library.only, captures=cameras))
    return cameras


@pytest.mark.usefixtures("photographed")
def test_a_trial_says_how_far_its_images_are_from_the_nearest_camera(make_job, library, seeing):
    result = run_trial(make_job(policy=seeing, duration=1.0), library=library)
    assert result.status == "ok", result.error_text
    numbers = result.capture_distance, result.capture_angle, result.capture_alpha
    assert [len(each) for each in numbers] == [10, 10, 10]
    # It stands about the origin, within the jitter of its start; the eye is 0.27 m ahead.
    assert 0.8 < min(result.capture_distance) <= max(result.capture_distance) < 1.3
    assert max(result.capture_angle) < 0.5
    assert min(result.capture_alpha) == pytest.approx(result.coverage_min)


@pytest.mark.usefixtures("photographed")
def test_not_one_bit_of_the_images_changes_by_it(make_job, library, seeing, tmp_path):
    bare = replace(library.only, captures=None)
    vars(library.only)["_digest"] = bare.digest  # Else it would be another scene, of other starts.
    found = []
    for name, scene in (("with", library.only), ("bare", bare)):
        library.only = scene
        path = tmp_path / f"{name}.mcap"
        job = make_job(policy=seeing, duration=0.5, mcap=path, record="all")
        result = run_trial(job, library=library)
        found.append((result.state_digest, result.coverage_mean, frames(path)))
    assert found[0] == found[1]
    assert len(found[0][2]) == 5
    assert result.capture_distance == result.capture_angle == result.capture_alpha == ()


@pytest.mark.usefixtures("photographed")
def test_a_policy_without_eyes_has_no_such_numbers(make_job, library):
    result = run_trial(make_job(duration=0.2), library=library)
    assert (result.capture_distance, result.capture_alpha) == ((), ())


@pytest.mark.usefixtures("photographed")
def test_from_the_middle_of_its_log_a_trial_comes_to_the_same_numbers(
    make_job, library, seeing, tmp_path
):
    path = tmp_path / "trial.mcap"
    result = run_trial(make_job(policy=seeing, mcap=path, duration=1.0), library=library)
    states = LogReader(path).states()
    with open_trial(read_logged_trial(path).job, library, StageClock()) as trial:
        trial.episode.restore(states[len(states) // 2])
        again = run_on(trial)
    for name in ("capture_distance", "capture_angle", "capture_alpha"):
        whole, rest = (np.float32(getattr(each, name)) for each in (result, again))
        assert whole.tolist() == rest.tolist()
