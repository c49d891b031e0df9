"""Policies that hang or answer nonsense cost their own trials and nothing else."""

import numpy as np
import onnx
import pytest

from nw_base.errors import PolicyError
from nw_eval import api


def by_status(outcome):
    groups = {"ok": [], "error": []}
    for row in outcome.rows:
        groups[row.status].append(row)
    return groups["ok"], groups["error"]


@pytest.mark.nightly
def test_a_policy_that_hangs_costs_the_trials_in_which_it_hangs(tiny_run):
    run = tiny_run("hangs", trials=4, time_limit=6.0)  # A busy machine takes 2 s for the others.
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


NEVER_A_NUMBER = """\
nw-eval: 1
name: never-a-number
robot: go1
policy: ./nan
trials: 8
seed: 1
episode: {duration: 0.4}
scenes: [hurdles/one_low_carpet]
gate: {success_rate: 0.75}
"""
CARD = """\
nw-policy: 1
name: nan
robot: go1
adapter: onnx
checkpoint: {file: policy.onnx}
control: {action: joint_position_offset, scale: 0.25}
observations: {body: {sensor: proprio, terms: [joint_pos]}}
"""


def test_a_checkpoint_of_nans_fails_its_trials_and_is_regressed_and_check_says_it_at_once(tmp_path):
    (tmp_path / "nan").mkdir()
    (tmp_path / "nan/policy.yaml").write_text(CARD)
    weights = onnx.numpy_helper.from_array(np.full((12, 12), np.nan, np.float32), "w")
    obs, out = (onnx.helper.make_tensor_value_info(name, 1, [1, 12]) for name in ("obs", "actions"))
    nodes = [onnx.helper.make_node("MatMul", ["obs", "w"], ["actions"])]
    graph = onnx.helper.make_graph(nodes, "g", [obs], [out], [weights])
    opset = [onnx.helper.make_opsetid("", 17)]
    model = onnx.helper.make_model(graph, opset_imports=opset, ir_version=8)
    onnx.save(model, tmp_path / "nan/policy.onnx")
    suite = tmp_path / "suite.yaml"
    suite.write_text(NEVER_A_NUMBER)
    ran = api.run(suite, out=tmp_path / "run", workers=1, cache=False)
    assert (ran.verdict.verdict, ran.exit_code) == ("REGRESSED", 1)
    assert {row.outcome for row in ran.rows} == {"policy_failed"}
    said = r"on an observation of zeros, .* returned nan for joint 0"
    with pytest.raises(PolicyError, match=said):
        api.check(suite)
    with pytest.raises(PolicyError, match=said):
        api.check_policy(str(tmp_path / "nan"))
