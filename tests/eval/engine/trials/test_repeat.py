"""What a second attempt makes of the first."""

import pytest

from nw_base.trials import Trial
from nw_eval.engine.rounds import is_open, settled
from nw_eval.engine.rows import make_row
from nw_gate.results.run_folder import RunFolder
from nw_sim.rollout.job import TrialJob, TrialResult

RAISED = TrialResult(
    status="error",
    end_reason="exception",
    error_type="policy_error",
    error_text="no gait",
    waypoints_reached=1,
    waypoints_total=4,
    steps=100,
)
NAN = TrialResult(
    status="error", end_reason="action", error_type="policy_error", error_text="nan for joint 3"
)
GONE = TrialResult(
    status="error", end_reason="exit", error_type="crashed", error_text="the process exited with 7"
)
KILLED = TrialResult(status="error", error_type="crashed", error_text="SIGKILL")
HUNG = TrialResult(status="error", error_type="hung", error_text="no result within 6 s")
FINE = TrialResult(status="ok", outcome="fell", end_reason="roll", waypoints_total=4)


@pytest.fixture
def row(tmp_path):
    trial = Trial(
        suite="s", suite_digest="d", suite_seed=1, scene="x", scene_digest="e", task="t", index=0
    )
    job = TrialJob(
        trial=trial, robot="go1", duration=1.0, scene="x", policy="p", checkpoint_digest="c"
    )

    def make(result, attempt=1):
        folder = RunFolder(path=tmp_path)
        return make_row(job, result, attempt=attempt, policy="p", folder=folder)

    return make


def test_a_failure_that_repeats_is_a_result_with_what_was_reached(row):
    made = row(settled(RAISED, row(RAISED)), attempt=2)
    assert (made.status, made.outcome, made.end_reason) == ("ok", "policy_failed", "exception")
    assert (made.success, made.completed, made.error_text) == (0.25, False, "no gait")


def test_an_exit_that_repeats_is_a_result_that_reached_nothing_that_is_known(row):
    made = row(settled(GONE, row(GONE)), attempt=2)
    assert (made.status, made.outcome, made.end_reason) == ("ok", "policy_failed", "exit")
    assert (made.success, made.completed, made.waypoints_total) == (0.0, False, 0)
    assert (made.error_type, made.error_text) == ("crashed", "the process exited with 7")


@pytest.mark.parametrize("before", [RAISED, NAN, GONE, KILLED, HUNG])
@pytest.mark.parametrize("result", [RAISED, NAN, GONE, KILLED, HUNG])
def test_anything_else_stays_an_error_and_tells_both_texts(row, before, result):
    made = settled(result, row(before))
    if result is before:
        assert made.status == ("error" if result in {KILLED, HUNG} else "ok")
        assert made.error_text == result.error_text
    else:
        assert made.status == "error"
        assert result.error_text in made.error_text
        assert before.error_text in made.error_text
        third = settled(NAN, row(made, attempt=2)).error_text
        assert third.count("the attempt before") <= 1, "texts do not grow without end"


def test_a_result_stands_whatever_came_before(row):
    assert settled(FINE, row(RAISED)) == FINE
    assert settled(RAISED, None) == RAISED


def test_what_was_said_of_a_failure_is_no_part_of_the_digest_and_how_it_failed_is(row):
    def failed(result):
        return row(settled(result, row(result)), attempt=2)

    from dataclasses import replace

    other = replace(RAISED, error_text="no gait in process 4711")
    assert failed(other).digest == failed(RAISED).digest
    assert failed(replace(RAISED, waypoints_reached=2)).digest != failed(RAISED).digest
    assert failed(replace(RAISED, end_reason="action")).digest != failed(RAISED).digest
    assert row(replace(KILLED, error_text="SIGSEGV")).digest != row(KILLED).digest


def test_an_error_runs_again_once_and_once_more_where_a_machine_failed_before_the_policy(row):
    assert is_open(row(RAISED), None)
    assert is_open(row(KILLED), None)
    assert not is_open(row(FINE), None)
    assert is_open(row(RAISED), row(KILLED))
    assert not is_open(row(RAISED), row(NAN))
    assert not is_open(row(KILLED), row(KILLED))
    assert not is_open(row(KILLED), row(RAISED))
