"""Whose fault it is that a trial ended: told by where an exception comes from."""

import os
import signal
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from nw_base.errors import PolicyError, ServerError, UsageError
from nw_base.trials import Trial
from nw_eval.testing import FakePolicy, GlidingWorld
from nw_gate.scores.own import OwnScore, own_text
from nw_policies.opening import ZeroPolicy
from nw_sim.rollout.job import TrialJob, TrialResult, policy_fault
from nw_sim.rollout.library import Library
from nw_sim.rollout.record import verdict_metadata
from nw_sim.rollout.trial import _whole_seconds, run_trial
from nw_sim.tasks.course import Course

ASSETS = Path(os.environ.get("NW_EVAL_ASSETS", Path(__file__).parents[4] / "shared" / "assets"))
RUNAWAY = ASSETS / "policies" / "chenci-go2"


class OddError(BaseException):
    """What no `except Exception` catches."""


class MuteError(Exception):
    """What cannot even be printed."""

    def __str__(self):
        raise SystemExit(3)


def deep():
    return deep()


def throw(error):
    raise error


@pytest.fixture
def acting(run_faked):
    """Return a runner of trials whose policy does this at its fifth step."""

    def run(act, **settings):
        policy = FakePolicy(lambda step: act() if step == 4 else np.zeros(12))
        return run_faked(policy, duration=0.3, **settings)

    return run


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda: throw(SystemExit(0)), "SystemExit: 0"),
        (lambda: throw(GeneratorExit()), "GeneratorExit"),
        (lambda: throw(OddError("odd")), "OddError: odd"),
        (lambda: throw(StopIteration()), "StopIteration"),
        (lambda: throw(MemoryError()), "MemoryError"),
        (deep, "RecursionError: maximum recursion depth exceeded"),
        (
            lambda: throw(MuteError()),
            "MuteError: its own message cannot be read, because of SystemExit",
        ),
        (lambda: throw(ValueError("\x1b[2J\n::error::x" * 10**5)), "more characters"),
    ],
    ids=["exit", "generator", "odd", "stop", "memory", "deep", "mute", "long"],
)
def test_whatever_a_policy_raises_ends_its_trial_as_its_own_failure(acting, act, said):
    result = acting(act)
    assert (result.status, result.error_type) == ("error", "policy_error")
    assert policy_fault(result) == "exception"
    assert said in result.error_text
    assert result.error_text.isprintable()
    assert len(result.error_text) < 1300
    assert (result.steps, result.waypoints_total) == (4, 2)


def test_an_interrupt_is_the_policys_own_where_ctrl_c_is_not_heard_and_goes_on_where_it_is(acting):
    with pytest.raises(KeyboardInterrupt):
        acting(lambda: throw(KeyboardInterrupt()))
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)  # As in a worker.
    try:
        result = acting(lambda: throw(KeyboardInterrupt()))
    finally:
        signal.signal(signal.SIGINT, heard)
    assert policy_fault(result) == "exception"


@pytest.mark.parametrize(
    ("action", "kind"),
    [(1e30, "action"), (-4.1e6, "action"), (3.9e6, None), (np.inf, "action"), (np.nan, "action")],
)
def test_a_target_beyond_a_million_radians_is_no_action(acting, action, kind):
    """The card says 0.25 rad for each unit of action."""
    assert policy_fault(acting(lambda: np.full(12, action))) == kind


def test_a_silent_server_or_an_error_of_ours_is_no_failure_of_the_policy(
    make_job, library, monkeypatch
):
    for error in (ServerError("no answer"), UsageError("the server serves another")):
        # Not by code of a policy, of which every error is the policy's own.
        monkeypatch.setattr(ZeroPolicy, "act", lambda *_, error=error: throw(error))
        result = run_trial(make_job(policy="stand", duration=0.1), library=library)
        assert (result.status, policy_fault(result)) == ("error", None)
        assert result.error_text == str(error)


def test_a_fault_of_ours_is_none_of_the_policy(run_faked):
    result = run_faked(world=partial(GlidingWorld, raises={5: MemoryError()}), duration=0.2)
    assert (result.error_type, policy_fault(result)) == ("crashed", None)


def test_what_a_policy_raises_as_it_is_closed_changes_nothing(run_faked):
    result = run_faked(FakePolicy(fails={"close": SystemExit(0)}), duration=0.1)
    assert (result.status, result.outcome) == ("ok", "timeout")


def test_code_that_fails_as_it_is_made_is_the_policys_and_a_lost_file_is_not(
    make_job, library, tmp_path
):
    card = (
        "nw-policy: 1\nname: made\nrobot: go1\nadapter: python:made_{0}:Made\n"
        "control: {{action: joint_position_offset, scale: 0.25}}\n"
        "observations: {{proprio: {{sensor: proprio, layout: parkour53}}}}\n"
    )
    failing = {
        "raises": "class Made:\n    def __init__(self, bundle): raise OSError('no such gait')\n",
        "leaves": "raise SystemExit(0)\n",
    }
    for name, code in failing.items():
        folder = tmp_path / name
        folder.mkdir()
        (folder / "policy.yaml").write_text(card.format(name))
        (folder / f"made_{name}.py").write_text(code)
        result = run_trial(make_job(policy=str(folder), allow_code=True), library=library)
        assert (result.error_type, policy_fault(result)) == ("policy_error", "exception")
        assert (result.waypoints_total, result.success) == (0, 0.0)
    lost = make_job(policy=str(folder), allow_code=True)
    for path in sorted(folder.rglob("*.*")):
        path.unlink()
    result = run_trial(lost)
    assert (result.status, result.error_type, policy_fault(result)) == (
        "error",
        "policy_error",
        None,
    )


@pytest.mark.parametrize(
    ("act", "said"),
    [(lambda: throw(SystemExit(0)), "SystemExit: 0"), (lambda: np.full(12, np.nan), "nan")],
    ids=["exit", "nan"],
)
def test_a_check_of_a_policy_that_fails_is_a_card_error_of_one_line(act, said):
    from nw_sim.probe.report import probe_here

    policy = FakePolicy(lambda step: act() if step > 4 else np.zeros(12))
    with pytest.raises(PolicyError, match=r"card 'fake': ") as caught:
        probe_here(policy.bundle())
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_log_says_that_the_policy_failed(acting, tmp_path):
    from nw_sim.rollout.mcap.reader import LogReader

    path = tmp_path / "trial.mcap"
    result = acting(lambda: throw(ValueError("no gait")), mcap=path)
    verdict = LogReader(path).metadata()["nw.verdict"]
    assert (verdict["status"], verdict["outcome"], verdict["end_reason"]) == (
        "ok",
        "policy_failed",
        "exception",
    )
    events = [message for _, _, message in LogReader(path).messages("/nw/event")]
    assert events[-1].kind == "error"
    assert events[-1].text.startswith("policy_failed (exception): policy 'fake': act raised Val")
    assert verdict_metadata(result) == verdict


def test_only_an_error_that_says_how_is_a_failure_of_the_policy():
    lost = TrialResult(status="error", error_type="crashed", error_text="SIGKILL")
    assert policy_fault(lost) is None
    gone = TrialResult(status="error", error_type="crashed", end_reason="exit")
    assert policy_fault(gone) == "exit"
    assert policy_fault(TrialResult(status="ok", outcome="fell", end_reason="exit")) is None


@pytest.mark.assets
@pytest.mark.skipif(not RUNAWAY.exists(), reason="the checkpoint is not there")
def test_a_walking_policy_that_runs_away_under_a_carpet_fails_in_the_same_step_every_time():
    """It is fed its own unclipped output, which grows without end once the head is caught."""
    library = Library()
    scene = library.scene("hurdles/one_low_carpet")
    trial = Trial(
        suite="s",
        suite_digest="0" * 64,
        suite_seed=1,
        scene=scene.name,
        scene_digest=scene.digest,
        task=scene.task,
        index=0,
    )
    job = TrialJob(
        trial=trial,
        robot="go2",
        duration=12.0,
        contact_termination=False,
        scene=scene.name,
        policy=str(RUNAWAY),
        checkpoint_digest=library.bundle(str(RUNAWAY), None).checkpoint_sha256,
    )
    one, two = (run_trial(job, library=library) for _ in range(2))
    assert (one.status, policy_fault(one), one.success) == ("error", "action", 0.5)
    assert "the policy's action makes a target of" in one.error_text
    assert (one.steps, one.action_digest, one.error_text) == (
        two.steps,
        two.action_digest,
        two.error_text,
    )


@pytest.mark.parametrize(
    "line",
    [
        "raise KeyboardInterrupt",
        "raise SystemExit(3)",
        "raise GeneratorExit",
        "raise BaseException('odd')",
        "raise __import__('asyncio').CancelledError",
        "raise __import__('nw_base.errors').errors.CodeError('mine')",
        "raise __import__('nw_sim.rollout.fault').rollout.fault.PolicyFailedError('its')",
    ],
)
@pytest.mark.parametrize("place", ["def odd(torques):\n    {}\n", "{}\ndef odd(torques): pass\n"])
def test_whatever_a_score_raises_is_no_failure_of_the_policy(run_faked, tmp_path, line, place):
    (tmp_path / "odd.py").write_text(place.format(line))
    own = OwnScore(python="odd.py:odd", better="lower", range=(0.0, 1.0))
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)  # As in a worker.
    try:
        result = run_faked(
            FakePolicy(), duration=0.1, scores=(own_text(own, tmp_path),), allow_code=True
        )
    finally:
        signal.signal(signal.SIGINT, heard)
    assert (result.status, result.error_type, policy_fault(result)) == ("error", "crashed", None)


def test_whatever_a_task_raises_is_no_failure_of_the_policy(run_faked, monkeypatch):
    for method in ("reset", "update", "end", "scores"):
        with monkeypatch.context() as patch:
            patch.setattr(Course, method, lambda *_: throw(OddError("odd")))
            result = run_faked(FakePolicy(), duration=0.1)
        assert (result.error_type, policy_fault(result)) == ("crashed", None), method
        assert "a score, task or perturbation raised OddError: odd" in result.error_text


@pytest.mark.parametrize(
    ("step", "now", "seconds"),
    [(0, 0.02, 0.0), (1, 0.04, 0.02), (1, 0.025, 0.02), (3, 0.0600000000001, 0.0600000000001)],
)
def test_a_trial_that_diverges_lasted_as_long_as_its_whole_control_steps(step, now, seconds):
    world = SimpleNamespace(control_rate=50.0, time=now)
    assert _whole_seconds(SimpleNamespace(step=step, world=world)) == seconds
