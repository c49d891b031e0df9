"""A trial restored from the middle of its log reaches the same end, bit for bit."""

from dataclasses import replace

import pytest

from nw_base.errors import PolicyError, StoreError, UsageError
from nw_eval.cli.verbs.replay import replay_line
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.replaying.logged import read_logged_trial
from nw_sim.rollout.replaying.takeover import replay, run_on
from nw_sim.rollout.trial import run_trial


@pytest.fixture(params=["walks", "sees"])
def recorded(request, make_job, library, seeing, tmp_path):
    settings = {
        "walks": {"duration": 3.0},
        "sees": {"policy": seeing, "duration": 1.0},
    }[request.param]
    path = tmp_path / "trial.mcap"
    result = run_trial(make_job(mcap=path, record="all", **settings), library=library)
    assert result.status == "ok", result.error_text
    return path, result


def test_a_state_of_the_middle_leads_to_the_same_last_state(recorded, library):
    path, result = recorded
    states = LogReader(path).states()
    middle, end = states[len(states) // 2], states[-1]
    assert 0 < middle.step < end.step == result.steps
    job = read_logged_trial(path).job
    with open_trial(job, library, StageClock()) as trial:
        trial.episode.restore(middle)
        assert trial.episode.step == middle.step
        again = run_on(trial)
        last = trial.episode.state()
    last.timestamp.CopyFrom(end.timestamp)
    assert last.SerializeToString(deterministic=True) == end.SerializeToString(deterministic=True)
    assert (again.state_digest, again.action_digest) == (result.state_digest, result.action_digest)
    assert again.waypoint_times == result.waypoint_times


def test_every_recorded_state_is_left_as_it_was_found(recorded, library):
    path, _ = recorded
    job = read_logged_trial(path).job
    with open_trial(job, library, StageClock()) as trial:
        for state in LogReader(path).states()[::4]:
            trial.episode.restore(state)
            found = trial.episode.state()
            found.timestamp.CopyFrom(state.timestamp)
            assert found == state


def test_a_replay_is_identical_from_the_start_and_from_the_middle(recorded, library):
    path, result = recorded
    whole = replay(path, library=library)
    half = replay(path, start=0.6, library=library)
    assert whole.is_identical
    assert half.is_identical
    assert (whole.start_step, half.start_step) == (0, 30)
    assert half.result.steps == result.steps
    assert "identical bit for bit" in replay_line(half.report)


@pytest.mark.parametrize("past", [0.0, 0.5, 1e9])
def test_a_start_at_the_end_or_later_is_refused_with_the_log_s_length(recorded, library, past):
    path, result = recorded
    with pytest.raises(UsageError, match=rf"ends at {result.sim_seconds:g} s; give less"):
        replay(path, start=result.sim_seconds + past, library=library)


def test_a_start_between_two_states_takes_the_earlier_one_and_not_the_end(recorded, library):
    path, result = recorded
    late = replay(path, start=result.sim_seconds - 0.001, library=library)
    assert late.is_identical
    assert 0 < late.start_step < result.steps


def test_a_replay_says_what_differs(recorded, library, monkeypatch):
    path, _ = recorded
    monkeypatch.setattr(
        "nw_sim.rollout.replaying.takeover.open_trial",
        lambda job, *rest: open_trial(
            replace(job, trial=replace(job.trial, index=job.trial.index + 1)), *rest
        ),
    )
    replayed = replay(path, library=library)
    assert not replayed.is_identical
    assert "state_digest was" in replay_line(replayed.report)


def test_another_checkpoint_or_scene_is_refused(recorded, library):
    path, _ = recorded
    job = read_logged_trial(path).job
    with pytest.raises(PolicyError, match="was planned with"):
        open_trial(replace(job, checkpoint_digest="f" * 64), library, StageClock())
    changed = replace(job, trial=replace(job.trial, scene_digest="f" * 64))
    with pytest.raises(UsageError, match="the scene has changed"):
        open_trial(changed, library, StageClock())


def test_a_file_that_is_no_log_is_refused_in_one_line(tmp_path):
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"not an mcap file at all" * 10)
    with pytest.raises(StoreError, match="damaged, or not a log") as caught:
        replay(bad)
    assert "\n" not in str(caught.value)
    with pytest.raises(StoreError, match="cannot read"):
        replay(tmp_path / "absent.mcap")
