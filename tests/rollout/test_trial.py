"""What one trial comes to, whatever happens in it."""

import subprocess
import sys

import numpy as np
import pytest

from nw_eval.errors import TrialError
from nw_eval.rollout.trial import run_trial
from nw_eval.sim import World


def test_a_trial_is_the_same_bits_whatever_ran_before_it(make_job, library):
    alone = run_trial(make_job(index=3), library=library)
    run_trial(make_job(index=4), library=library)
    again = run_trial(make_job(index=3), library=library)
    assert alone.status == "ok"
    assert (again.state_digest, again.action_digest) == (alone.state_digest, alone.action_digest)


def test_two_trials_of_a_scene_start_differently(make_job, library):
    digests = {
        run_trial(make_job(index=k, duration=0.1), library=library).state_digest for k in range(3)
    }
    assert len(digests) == 3


def test_the_shipped_policy_walks_the_flat_trail_and_its_stages_take_time(make_job, library):
    result = run_trial(make_job(duration=12.0), library=library)
    assert (result.outcome, result.end_reason) == ("completed", "all waypoints")
    assert (result.waypoints_reached, result.success) == (2, 1.0)
    first, second = result.waypoint_times
    # 0.5 m and 2.2 m from the spawn to the edge of the waypoints' reach, at 0.8 m/s or so.
    assert 0.3 < first < 1.8
    assert 2.0 < second < 5.0
    assert result.sim_seconds == pytest.approx(second)
    for seconds in (result.wall.setup, result.wall.physics, result.wall.sense, result.wall.policy):
        assert 0.0 < seconds < result.wall_seconds
    assert result.coverage_mean is None


def test_physics_that_fails_is_an_error_with_what_was_reached_so_far(
    make_job, library, monkeypatch
):
    step = World.step

    def failing(self, targets):
        if self.steps == 30:
            raise TrialError("physics failed at 0.600 s: an acceleration is NaN")
        step(self, targets)

    monkeypatch.setattr(World, "step", failing)
    result = run_trial(make_job(), library=library)
    assert (result.status, result.outcome, result.error_type) == ("error", None, "physics_error")
    assert result.steps == 30
    assert "0.600 s" in result.error_text


@pytest.mark.parametrize(
    ("action", "said"),
    [
        (lambda: np.full(12, np.nan), "not 12 finite numbers"),
        (lambda: np.zeros(11), "not 12 finite numbers"),
        (lambda: 1 / 0, "ZeroDivisionError"),
    ],
    ids=["nan", "eleven numbers", "raises"],
)
def test_a_policy_that_misbehaves_is_a_policy_error(make_job, library, monkeypatch, action, said):
    from nw_eval.policies.opening import ZeroPolicy

    monkeypatch.setattr(ZeroPolicy, "act", lambda _self, _observation: action())
    result = run_trial(make_job(policy="stand"), library=library)
    assert (result.status, result.error_type) == ("error", "policy_error")
    assert said in result.error_text
    assert "\n" not in result.error_text


@pytest.mark.parametrize("method", ["reset", "state"])
def test_a_policy_that_fails_beside_its_actions_is_a_policy_error_too(
    make_job, library, monkeypatch, tmp_path, method
):
    from nw_eval.policies.opening import ZeroPolicy

    def broken(*_):
        raise RuntimeError("no connection")

    monkeypatch.setattr(ZeroPolicy, method, broken)
    job = make_job(policy="stand", mcap=tmp_path / "trial.mcap")
    result = run_trial(job, library=library)
    assert (result.status, result.error_type) == ("error", "policy_error")
    assert "RuntimeError: no connection" in result.error_text


def test_a_fault_after_the_outcome_costs_the_log_alone(make_job, library, monkeypatch, tmp_path):
    from nw_eval.policies.opening import ZeroPolicy

    calls = []

    def broken_at_last(_self):
        calls.append(1)
        if len(calls) == 3:  # States are written at steps 0 and 10, and at the end.
            raise RuntimeError("no connection")
        return b""

    monkeypatch.setattr(ZeroPolicy, "state", broken_at_last)
    path = tmp_path / "trial.mcap"
    result = run_trial(make_job(policy="stand", duration=0.3, mcap=path), library=library)
    assert (result.status, result.outcome) == ("ok", "timeout")
    assert "no connection" in result.mcap_error
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_our_own_is_a_crash_that_says_where(make_job, library, monkeypatch):
    def broken(_self):
        raise KeyError("camera")

    monkeypatch.setattr(World, "monitored_force", broken)
    result = run_trial(make_job(), library=library)
    assert (result.status, result.error_type) == ("error", "crashed")
    assert result.error_text.startswith("KeyError: 'camera' at test_trial.py:")


def test_an_error_leaves_a_log_that_says_so(make_job, library, monkeypatch, tmp_path):
    from nw_eval.rollout.mcap.reader import LogReader

    def broken(_self):
        raise KeyError("camera")

    monkeypatch.setattr(World, "monitored_force", broken)
    path = tmp_path / "error.mcap"
    result = run_trial(make_job(mcap=path), library=library)
    assert result.mcap_bytes == path.stat().st_size > 0
    events = [message for _, _, message in LogReader(path).messages("/nw/event")]
    assert events[-1].kind == "error"
    assert "KeyError" in events[-1].text
    assert LogReader(path).metadata()["nw.verdict"]["error_type"] == "crashed"


def test_a_trial_imports_neither_torch_nor_tables_nor_plots():
    code = (
        "import sys, nw_eval.engine, nw_eval.rollout.trial, nw_eval.rollout.mcap.trial_log;"
        "print([m for m in ('torch', 'pandas', 'pyarrow', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
