"""What walk-these-ways sees, by a card alone, against a plain re-writing of its own code.

Formulas: Improbable-AI/walk-these-ways, `LeggedRobot.compute_observations`,
`_step_contact_targets`, `_init_buffers` (scales) and `HistoryWrapper`; sizes of `scripts/train.py`.
"""

import hashlib
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from ruamel.yaml import YAML

from nw_base.trials import Trial
from nw_policies import load_bundle
from nw_sim.probe.recording import ThisBundle
from nw_sim.rollout.confined.vetting import check_bundle
from nw_sim.rollout.job import StageClock, TrialJob
from nw_sim.rollout.library import Library
from nw_sim.rollout.opening import open_trial

EXAMPLE = Path(__file__).resolve().parents[3] / "policies/examples/walk-these-ways-go1/policy.yaml"
SCENE = "flat/carpet_room"
# x, y, yaw; body height; frequency, phase, offset, bound, duration; footswing height, pitch, roll,
# stance width, stance length, auxiliary reward. A gait of no name, so that no number is another's.
COMMANDS = np.array(
    [0.8, 0.1, -0.2, -0.05, 2.7, 0.4, 0.15, 0.22, 0.6, 0.09, 0.12, -0.07, 0.28, 0.41, 0.003]
)
SCALES = np.array([2.0, 2.0, 0.25, 2.0, 1, 1, 1, 1, 1, 0.15, 0.3, 0.3, 1.0, 1.0, 1.0])
POSE = np.array([0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5])
DT, FRAMES = 0.02, 30


class WalkTheseWays:
    """Its environment, as far as it makes observations; joints FL FR RL RR, quaternions x y z w."""

    def __init__(self):
        self.gait = 0.0
        self.actions = self.last_actions = np.zeros(12)
        self.history = np.zeros(FRAMES * 70)

    def observe(self, quaternion, dof_pos, dof_vel):
        feet = self.step_contact_targets()
        frame = np.concatenate(
            [
                self.quat_rotate_inverse(quaternion, np.array([0.0, 0.0, -1.0])),
                COMMANDS * SCALES,
                (dof_pos - POSE) * 1.0,
                dof_vel * 0.05,
                self.actions,
                self.last_actions,
                np.sin(2 * np.pi * feet),
            ]
        )
        self.history = np.concatenate([self.history[70:], np.clip(frame, -100, 100)])
        return self.history

    def step(self, actions):
        self.last_actions = self.actions
        self.actions = np.clip(actions, -10.0, 10.0)
        self.gait = np.remainder(self.gait + DT * COMMANDS[4], 1.0)

    def step_contact_targets(self):
        phase, offset, bound, duration = COMMANDS[5:9]
        feet = [self.gait + phase + offset + bound, self.gait + offset, self.gait + bound]
        feet = np.array([*feet, self.gait + phase])
        stance = np.remainder(feet, 1) < duration
        swing = np.remainder(feet, 1) > duration
        feet[stance] = np.remainder(feet[stance], 1) * (0.5 / duration)
        feet[swing] = 0.5 + (np.remainder(feet[swing], 1) - duration) * (0.5 / (1 - duration))
        return feet

    @staticmethod
    def quat_rotate_inverse(q, v):
        w, xyz = q[3], q[:3]
        return v * (2.0 * w**2 - 1.0) - np.cross(xyz, v) * w * 2.0 + xyz * (xyz @ v) * 2.0


def random_network(path):
    weight = np.random.default_rng(5).normal(0.0, 0.2, (FRAMES * 70, 12)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weight"], ["action"])],
        "random",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, FRAMES * 70])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 12])],
        [numpy_helper.from_array(weight, "weight")],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(path))


def bundle_with(folder, commands):
    """The example's card with other commands, and random weights."""
    random_network(folder / "policy.onnx")
    card = YAML(typ="safe", pure=True).load(EXAMPLE.read_text())
    digest = hashlib.sha256((folder / "policy.onnx").read_bytes()).hexdigest()
    card |= {"adapter": "onnx", "checkpoint": {"file": "policy.onnx", "sha256": digest}}
    del card["networks"], card["inputs"]  # What they see is all that is asked here.
    card["command"] = {"source": "constant", "velocity": commands[:3].tolist()}
    terms = card["observations"]["history"]["terms"]
    (constants,) = (t for t in terms if "values" in t and t["term"] == "constant")
    constants["values"] = commands[3:].tolist()
    frequency, phase, offset, bound, duration = commands[4:9].tolist()
    terms[-1] |= {
        "frequency": frequency,
        "offsets": [phase + offset + bound, offset, bound, phase],
        "stance": duration,
    }
    with (folder / "policy.yaml").open("w") as file:
        YAML(typ="safe", pure=True).dump(card, file)
    return load_bundle(folder)


def job_of(bundle):
    scene = Library().scene(SCENE)
    trial = Trial(
        suite="test",
        suite_digest="0" * 64,
        suite_seed=11,
        scene=scene.name,
        scene_digest=scene.digest,
        task=scene.task,
        index=0,
    )
    return TrialJob(
        trial=trial,
        policy=str(bundle.card_path),
        checkpoint_digest=bundle.checkpoint_sha256,
        robot="go1",
        duration=5.0,
        scene=SCENE,
        record="none",
    )


def test_a_card_alone_shows_what_walk_these_ways_sees(tmp_path):
    bundle = bundle_with(tmp_path, COMMANDS)
    (spec,) = check_bundle(bundle)
    assert spec.reckoning == "`history` 2100 = 30 x (3 + 3 + 12 + 12 + 12 + 12 + 12 + 4)"
    theirs, clipped = WalkTheseWays(), 0
    with open_trial(job_of(bundle), ThisBundle(bundle), StageClock()) as trial:
        # Robot FR FL RR RL to FL FR RL RR, which is its own inverse.
        order = np.arange(12).reshape(4, 3)[[1, 0, 3, 2]].ravel()
        data = trial.episode.world._data
        for _ in range(45):
            decision = trial.episode.decide()
            expected = theirs.observe(
                data.qpos[[4, 5, 6, 3]], data.qpos[7:][order], data.qvel[6:][order]
            )
            np.testing.assert_allclose(decision.observation["history"], expected, atol=2e-6)
            theirs.step(decision.action)
            trial.episode.advance(decision)
            clipped += bool((np.abs(decision.action) > 10.0).any())
    assert clipped > 5  # The limits of actions did something.
    assert (theirs.history[:70] != 0.0).sum() > 50  # And the history is full.


def test_its_actions_become_the_targets_that_it_sends_to_its_motors(tmp_path):
    # LCMAgent.publish_action: actions * 0.25, hips once more * 0.5, plus the default pose.
    bundle = bundle_with(tmp_path, COMMANDS)
    with open_trial(job_of(bundle), ThisBundle(bundle), StageClock()) as trial:
        order = np.arange(12).reshape(4, 3)[[1, 0, 3, 2]].ravel()
        before = np.zeros(12)
        for _ in range(5):
            decision = trial.episode.decide()
            expected = np.clip(before, -10, 10) * 0.25
            expected[[0, 3, 6, 9]] *= 0.5
            np.testing.assert_allclose(decision.targets[order], expected + POSE, atol=1e-9)
            trial.episode.advance(decision)
            before = decision.action  # Applied one step later: the card's `delay_steps`.
