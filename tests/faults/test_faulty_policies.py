"""Policies that hang or answer nonsense cost their own trials and nothing else."""

import time

import pytest


def by_status(outcome):
    groups = {"ok": [], "error": []}
    for row in outcome.rows:
        groups[row.status].append(row)
    return groups["ok"], groups["error"]


@pytest.mark.nightly
def test_a_policy_that_hangs_costs_the_trials_in_which_it_hangs(tiny_run):
    run = tiny_run("hangs", trials=4, time_limit=6.0)  # A busy machine takes 2 s for the others.
    began = time.perf_counter()
    outcome = run.go(workers=2)
    ok, hung = by_status(outcome)
    assert len(ok) + len(hung) == 4
    assert ok, "no trial of the panel starts with the waypoint on the right"
    assert hung, "no trial of the panel starts with the waypoint on the left"
    assert {row.outcome for row in hung} == {"hung"}
    assert {row.success for row in hung} == {None}
    assert {row.attempt for row in hung} == {2}, "an error is tried once more"
    assert {row.attempt for row in ok} == {1}
    assert "6 s" in hung[0].error_text
    assert time.perf_counter() - began < 120.0


def test_a_nan_action_that_repeats_is_a_failure_of_the_policy_told_once(tiny_run):
    run = tiny_run("nan", trials=4)
    outcome = run.go(workers=1)
    wrong = [row for row in outcome.rows if row.outcome == "policy_failed"]
    assert wrong
    assert {row.status for row in outcome.rows} == {"ok"}
    assert {(row.end_reason, row.error_type) for row in wrong} == {("action", "policy_error")}
    assert all("nan" in row.error_text for row in wrong)
    assert all("\n" not in row.error_text for row in wrong)
    assert all(row.mcap_bytes > 0 for row in wrong), "the log of a failure is evidence"
    again = [text for text in run.ears.messages if "again in a fresh process" in text]
    assert len(again) == len(wrong)
    assert sorted(row.trial_id for row in run.ears.rows) == sorted(job.trial.id for job in run.jobs)
