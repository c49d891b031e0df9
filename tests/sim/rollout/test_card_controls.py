"""What cards can say about control, seen in trials: rates, torques, physics steps."""

import hashlib
from dataclasses import replace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from nw_policies import load_bundle
from nw_sim.probe.recording import record
from nw_sim.rollout.fault import PolicyFailedError
from nw_sim.rollout.job import StageClock
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial

SCENE = "flat/carpet_room"
CARD = """\
nw-policy: 1
name: counts
robot: go1
adapter: onnx
checkpoint: {file: policy.onnx, sha256: %s}
control: {%s}
observations: {body: {sensor: proprio, %s}}
"""


def counting_policy(folder, control, body="terms: [joint_vel], history: 2"):
    """A policy whose action is 0.1 times the number of times that it was asked."""
    one = numpy_helper.from_array(np.full((1, 12), 0.1, np.float32), "one")
    zero = numpy_helper.from_array(np.zeros((24, 12), np.float32), "zero")
    graph = helper.make_graph(
        [
            helper.make_node("MatMul", ["obs", "zero"], ["nothing"]),
            helper.make_node("Add", ["h_in", "one"], ["more"]),
            helper.make_node("Add", ["more", "nothing"], ["h_out"]),
            helper.make_node("Identity", ["h_out"], ["action"]),
        ],
        "counting",
        [
            helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 24]),
            helper.make_tensor_value_info("h_in", TensorProto.FLOAT, [1, 12]),
        ],
        [
            helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12]),
            helper.make_tensor_value_info("h_out", TensorProto.FLOAT, [1, 12]),
        ],
        [one, zero],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    data = model.SerializeToString()
    folder.mkdir(exist_ok=True)
    (folder / "policy.onnx").write_bytes(data)
    (folder / "policy.yaml").write_text(CARD % (hashlib.sha256(data).hexdigest(), control, body))
    return load_bundle(folder)


def test_a_policy_at_25_hz_is_asked_at_every_second_step_and_its_action_held(tmp_path):
    bundle = counting_policy(
        tmp_path, "action: joint_position_offset, scale: 0.01, rate: 25, delay_steps: 1"
    )
    made = record(bundle, scene=SCENE, seconds=0.2)
    np.testing.assert_allclose(made.actions[:6, 0], [0.1, 0.1, 0.2, 0.2, 0.3, 0.3], rtol=1e-6)
    # One period of 0.04 s late.
    offsets = (made.targets[:6, 0] - made.targets[0, 0]) / 0.01
    np.testing.assert_allclose(offsets, [0.0, 0.0, 0.1, 0.1, 0.2, 0.2], atol=1e-6)


def test_its_history_holds_frames_of_its_own_rate(tmp_path):
    bundle = counting_policy(tmp_path, "action: joint_position_offset, scale: 0.05, rate: 25")
    frames = record(bundle, scene=SCENE, seconds=0.2).observations["body"]
    np.testing.assert_array_equal(frames[4], frames[5])
    np.testing.assert_array_equal(frames[4][:12], frames[2][12:])
    assert not np.array_equal(frames[4][12:], frames[2][12:])


def test_torques_reach_the_joints_as_they_are(tmp_path):
    bundle = counting_policy(tmp_path, "action: joint_torque, scale: 100.0, torque_limits: 25.0")
    made = record(bundle, scene=SCENE, seconds=0.1)
    np.testing.assert_allclose(made.torques[:3, 0], [10.0, 20.0, 25.0], rtol=1e-6)
    free = record(
        counting_policy(tmp_path / "weak", "action: joint_torque, scale: 0.0"),
        scene=SCENE,
        seconds=0.1,
    )
    assert np.abs(free.torques).max() == 0.0
    assert made.positions[2, 0] > free.positions[2, 0]


def test_another_physics_rate_keeps_the_control_period(tmp_path):
    bundle = counting_policy(tmp_path, "action: joint_position_offset, physics_rate: 1000")
    made = record(bundle, scene=SCENE, seconds=0.2)
    assert len(made.actions) == 10
    assert made.seconds == 0.2
    usual = record(
        counting_policy(tmp_path / "b", "action: joint_position_offset"), scene=SCENE, seconds=0.2
    )
    assert not np.array_equal(made.positions, usual.positions)
    # The same motion but for the error of integration.
    np.testing.assert_allclose(made.positions, usual.positions, atol=0.15)


def doubling_policy(folder, term):
    """A policy whose action is twice the last one that it sees, and 1 more."""
    weight = np.vstack([2.0 * np.eye(12), np.ones((1, 12))]).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weight"], ["action"])],
        "doubling",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 13])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(weight, "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    data = model.SerializeToString()
    folder.mkdir()
    (folder / "policy.onnx").write_bytes(data)
    control = "action: joint_position_offset, scale: 0.0001, clip: 100"
    terms = f"terms: [{term}, {{term: constant, values: [1]}}]"
    card = CARD % (hashlib.sha256(data).hexdigest(), control, terms)
    (folder / "policy.yaml").write_text(card)
    return load_bundle(folder)


def test_a_policy_that_meets_its_clipped_action_again_cannot_run_away(tmp_path):
    kept = doubling_policy(tmp_path / "kept", "{term: last_output, clipped: true}")
    made = record(kept, scene=SCENE, seconds=3.0)
    assert made.actions[:9, 0].tolist() == [1, 3, 7, 15, 31, 63, 127, 201, 201]
    assert made.actions.max() == 201
    free = doubling_policy(tmp_path / "free", "last_output")
    with pytest.raises(PolicyFailedError, match="inf"):
        record(free, scene=SCENE, seconds=3.0)


def test_held_actions_and_recurrent_state_survive_a_restore(tmp_path, make_job):
    bundle = counting_policy(tmp_path, "action: joint_position_offset, scale: 0.05, rate: 25")
    job = make_job_for(bundle, make_job)
    with open_trial(job, Library(), StageClock()) as trial:
        episode = trial.episode
        for _ in range(5):
            episode.advance(episode.decide())
        saved = episode.state()
        for _ in range(6):
            episode.advance(episode.decide())
        end = episode.state_digest.hex, episode.action_digest.hex
        episode.restore(saved)
        for _ in range(6):
            episode.advance(episode.decide())
        assert (episode.state_digest.hex, episode.action_digest.hex) == end


def test_a_filter_at_25_hz_takes_each_action_once_and_holds_what_it_made(tmp_path):
    bundle = counting_policy(
        tmp_path,
        "action: joint_position_offset, scale: 0.01, rate: 25, delay_steps: 1, clip: 0.25, "
        "filter: {kind: exponential, alpha: 0.5}",
    )
    made = record(bundle, scene=SCENE, seconds=0.2)
    offsets = (made.targets[:8, 0] - made.targets[0, 0]) / 0.01
    # Applied: 0, 0.1, 0.2, 0.25 of 0.3; each new one counts half.
    expected = np.repeat([0.0, 0.05, 0.125, 0.1875], 2)
    np.testing.assert_allclose(offsets, expected, atol=1e-6)


def test_outputs_before_the_last_one_are_those_of_the_policys_own_rate(tmp_path):
    bundle = counting_policy(
        tmp_path,
        "action: joint_position_offset, scale: 0.01, rate: 25",
        "terms: [last_output, {term: last_output, ago: 1}]",
    )
    body = record(bundle, scene=SCENE, seconds=0.2).observations["body"][:, [0, 12]]
    expected = np.repeat([[0.0, 0.0], [0.1, 0.0], [0.2, 0.1], [0.3, 0.2]], 2, axis=0)
    np.testing.assert_allclose(body[:8], expected, atol=1e-6)


REMEMBERS = """terms: [gravity, acceleration, {term: yaw, relative_to: start, values: sine_cosine},
    {term: last_output, ago: 1}, {term: clock, frequency: 2.3, offsets: [0, 0.2, 0.5, 0.7],
    stance: 0.6, values: [sine]}]"""


@pytest.mark.parametrize("protocol", ["strict", "neverwhere-2026"])
def test_all_that_a_card_can_ask_for_is_the_same_after_a_restore(tmp_path, make_job, protocol):
    bundle = counting_policy(
        tmp_path,
        "action: joint_position_offset, scale: 0.05, rate: 25, "
        "filter: {kind: butterworth, cutoff: 4.0, order: 3}",
        REMEMBERS,
    )
    job = replace(make_job_for(bundle, make_job), protocol=protocol)

    def go_on(episode):
        decisions = []
        for _ in range(9):
            decisions.append(episode.decide())
            episode.advance(decisions[-1])
        return decisions

    with open_trial(job, Library(), StageClock()) as trial:
        episode = trial.episode
        go_on(episode)
        saved = episode.state()
        first = go_on(episode)
        episode.restore(saved)
        again = go_on(episode)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(other.observation["body"], one.observation["body"])
        np.testing.assert_array_equal(other.targets, one.targets)
    assert np.ptp([one.observation["body"] for one in first], axis=0).min() > 0.0


def make_job_for(bundle, make_job):
    place = Library().scene(SCENE)
    job = make_job()
    return replace(
        job,
        policy=str(bundle.card_path),
        checkpoint_digest=bundle.checkpoint_sha256,
        trial=replace(job.trial, scene_digest=place.digest),
    )
