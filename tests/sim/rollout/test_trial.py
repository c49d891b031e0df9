"""What one trial comes to, whatever happens in it."""

import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from nw_base.errors import TrialError
from nw_eval.testing import FakePolicy, GlidingWorld
from nw_sim.rollout.trial import run_trial


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


def test_physics_that_fails_is_an_error_with_what_was_reached_so_far(run_faked):
    error = TrialError("physics failed at 0.600 s: an acceleration is NaN")
    result = run_faked(world=partial(GlidingWorld, raises={30: error}))
    assert (result.status, result.outcome, result.error_type) == ("error", None, "physics_error")
    assert result.steps == 30
    assert "0.600 s" in result.error_text


@pytest.mark.parametrize(
    ("action", "said"),
    [
        (lambda _: np.full(12, np.nan), "returned nan for joint 0 of its action"),
        (lambda _: np.zeros(11), "returned an action of shape (11,)"),
        (lambda _: 1 / 0, "ZeroDivisionError"),
    ],
    ids=["nan", "eleven numbers", "raises"],
)
def test_a_policy_that_misbehaves_is_a_policy_error(run_faked, action, said):
    result = run_faked(FakePolicy(action))
    assert (result.status, result.error_type) == ("error", "policy_error")
    assert said in result.error_text
    assert "\n" not in result.error_text


@pytest.mark.parametrize("method", ["reset", "state"])
def test_a_policy_that_fails_beside_its_actions_is_a_policy_error_too(run_faked, tmp_path, method):
    policy = FakePolicy(fails={method: RuntimeError("no connection")})
    result = run_faked(policy, mcap=tmp_path / "trial.mcap")
    assert (result.status, result.error_type) == ("error", "policy_error")
    assert "RuntimeError: no connection" in result.error_text


def test_a_fault_after_the_outcome_costs_the_log_alone(run_faked, tmp_path):
    calls = []

    def at_last():
        calls.append(1)
        if len(calls) == 3:  # States are written at steps 0 and 10, and at the end.
            raise RuntimeError("no connection")

    path = tmp_path / "trial.mcap"
    result = run_faked(FakePolicy(fails={"state": at_last}), duration=0.3, mcap=path)
    assert (result.status, result.outcome) == ("ok", "timeout")
    assert "no connection" in result.mcap_error
    assert list(tmp_path.iterdir()) == []


BROKEN = partial(GlidingWorld, raises={5: KeyError("camera")})
"""A world with a fault of our own."""


def test_a_fault_of_our_own_is_a_crash_that_says_where(run_faked):
    result = run_faked(world=BROKEN)
    assert (result.status, result.error_type) == ("error", "crashed")
    assert result.error_text.startswith("KeyError: 'camera' at fakes.py:")


def test_an_error_leaves_a_log_that_says_so(run_faked, tmp_path):
    from nw_sim.rollout.mcap.reader import LogReader

    path = tmp_path / "error.mcap"
    result = run_faked(world=BROKEN, mcap=path)
    assert result.mcap_bytes == path.stat().st_size > 0
    events = [message for _, _, message in LogReader(path).messages("/nw/event")]
    assert events[-1].kind == "error"
    assert "KeyError" in events[-1].text
    assert LogReader(path).metadata()["nw.verdict"]["error_type"] == "crashed"


def test_a_trial_imports_neither_torch_nor_tables_nor_plots():
    code = (
        "import sys, nw_eval.engine, nw_sim.rollout.trial, nw_sim.rollout.mcap.trial_log;"
        "print([m for m in ('torch', 'pandas', 'pyarrow', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
