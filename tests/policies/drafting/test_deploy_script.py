"""Scripts that write an observation slice by slice say its terms; they are read, never run."""

import pytest
from tests.policies.drafting.test_beside import LEFT_FIRST, words

SCRIPT = """
import numpy as np
open("RAN", "w").write("the code was run")
class Config:
    path = "./policies/policy.onnx"
    class sim:
        dt = 0.002
        decimation = 10
    class robot:
        base = 33
        kps = np.array([base, base, base, base, base, base, base, base, base, base, base, base])
        kds = np.array([0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8])
        hip = 0.1
        default_angles = np.array([hip, 0.8, -1.5, -hip, 0.8, -1.5,
                                   hip, 1.0, -1.5, -hip, 1.0, -1.5])
    class env:
        num_actions = 12
        num_single_obs = 45
    class control:
        action_scale = 0.3
    class scales:
        ang_vel = 0.25
        dof_vel = 0.05
def run(cfg):
    q = data.qpos[7:]
    dq = data.qvel[6:]
    omega = data.qvel[3:6]
    command = keyboard.get_velocities()
    off = q - cfg.robot.default_angles
    obs[:3] = command * np.array([2.0, 2.0, 0.25])
    obs[3:6] = omega * cfg.scales.ang_vel
    obs[6:9] = get_gravity_orientation(data.qpos[3:7])
    obs[9:9+cfg.env.num_actions] = off
    obs[9+cfg.env.num_actions:33] = dq * cfg.scales.dof_vel
    obs[33:45] = action
    hist = hist[45:]
    hist = np.concatenate((hist, obs), axis=-1)
"""
CHECKPOINT = "repo/policies/policy.onnx"


def beside(script=SCRIPT):
    return {"../setup.py": "", "../scripts/walk.py": script}


def test_slices_give_terms_scales_and_frames(card_of):
    text, card = card_of(270, beside(), name=CHECKPOINT)
    assert words(card) == ["command", "ang_vel", "gravity", "joint_pos", "joint_vel", "last_output"]
    terms = card.observations["obs"].frame_terms
    assert (terms[0].scale, terms[1].scale, terms[4].scale) == ([2, 2, 0.25], 0.25, 0.05)
    assert terms[3].relative
    history = card.observations["obs"].history
    assert (history.steps, history.order, history.by) == (6, "oldest_first", "step")
    assert "which was read, not run" in text


def test_a_script_may_begin_with_a_mark_of_its_encoding(card_of):
    text, _ = card_of(270, beside("\ufeff" + SCRIPT), name=CHECKPOINT)
    assert "which was read, not run" in text


def test_its_settings_are_those_of_the_card(card_of):
    _, card = card_of(270, beside(), name=CHECKPOINT)
    control = card.control
    assert (control.rate, control.scale) == (50, 0.3)
    assert (control.joints, control.kp, control.kd) == (LEFT_FIRST, 33, 0.8)
    assert control.default_pose == [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1, -1.5, -0.1, 1, -1.5]


def test_the_newest_frame_comes_first_where_the_script_joins_it_so(card_of):
    newest = SCRIPT.replace("(hist, obs)", "(obs, hist[:-45])")
    _, card = card_of(270, beside(newest), name=CHECKPOINT)
    assert card.observations["obs"].history.order == "newest_first"


@pytest.mark.parametrize(
    "script",
    [
        pytest.param(SCRIPT.replace("policy.onnx", "other.onnx"), id="of another checkpoint"),
        pytest.param(SCRIPT.replace("obs[6:9] = get", "obs[6:8] = get"), id="with a gap"),
        pytest.param(SCRIPT.replace("obs[33:45] = action", "obs[33:45] = mystery"), id="unknown"),
        pytest.param(SCRIPT.replace("obs[33:45] = action", "pass"), id="of another size"),
        pytest.param("obs = policy.onnx (", id="no Python"),
    ],
)
def test_a_script_that_is_not_understood_whole_says_nothing(script, card_of):
    text, _ = card_of(270, beside(script), name=CHECKPOINT)
    assert "terms are guessed from the size" in text
    assert "walk.py" not in text


def test_nothing_of_a_script_is_run(card_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    card_of(270, beside(), name=CHECKPOINT)
    assert not list(tmp_path.rglob("RAN"))
