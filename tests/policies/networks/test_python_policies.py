"""`python:module:Class` policies: only when allowed, and checked like all others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nw_base.errors import PolicyError, TrialError
from nw_policies import load_bundle, open_policy

CARD = """\
nw-policy: 1
name: scripted
robot: go1
adapter: python:{module}:{cls}
control: {{action: joint_position_offset, scale: 0.25}}
observations:
  obs: {{sensor: proprio, layout: parkour53}}
"""
CODE = """\
import numpy as np
from pathlib import Path

Path(__file__).with_name("imported").touch()

class Counter:
    def __init__(self, bundle):
        self.robot = bundle.card.robot
        self.count = 0
    def reset(self, seed):
        self.count = seed
    def act(self, observation):
        self.count += 1
        return np.full(12, self.count + float(observation["obs"][0]))
    def state(self):
        return str(self.count).encode()
    def restore(self, state):
        self.count = int(state)

class Bare:
    def __init__(self, bundle): pass
    def act(self, observation): return [0.5] * 12

class Short(Bare):
    def act(self, observation): return [0.5] * 11

class Broken(Bare):
    def act(self, observation): raise KeyError("velocity")

class Forgetful(Bare):
    def state(self): return b""

class Idle:
    def __init__(self, bundle): pass
"""


def bundle_for(folder: Path, cls: str, module: str):
    (folder / f"{module}.py").write_text(CODE)
    (folder / "policy.yaml").write_text(CARD.format(module=module, cls=cls))
    return load_bundle(folder)


def test_code_is_not_imported_unless_allowed(tmp_path):
    bundle = bundle_for(tmp_path, "Counter", "scripted_denied")
    with pytest.raises(PolicyError, match="imports and runs Python code; add --allow-code"):
        open_policy(bundle)
    assert not (tmp_path / "imported").exists()


def test_a_class_beside_the_card_is_used_with_its_state(tmp_path):
    policy = open_policy(bundle_for(tmp_path, "Counter", "scripted_counter"), allow_code=True)
    policy.reset(10)
    assert policy.act({"obs": np.full(53, 0.25)}).tolist() == [11.25] * 12
    state = policy.state()
    policy.act({"obs": np.zeros(53)})
    policy.restore(state)
    assert policy.act({"obs": np.zeros(53)}).tolist() == [12.0] * 12
    policy.close()
    policy.close()
    with pytest.raises(TrialError, match="closed"):
        policy.act({"obs": np.zeros(53)})


def test_only_act_is_needed(tmp_path):
    policy = open_policy(bundle_for(tmp_path, "Bare", "scripted_bare"), allow_code=True)
    policy.reset(0)
    assert policy.act({}).tolist() == [0.5] * 12
    assert policy.state() == b""


def test_what_the_class_does_wrong_is_the_policys_error(tmp_path):
    short = open_policy(bundle_for(tmp_path, "Short", "scripted_faults"), allow_code=True)
    with pytest.raises(TrialError, match=r"an action of shape \(11,\)"):
        short.act({})
    broken = open_policy(bundle_for(tmp_path, "Broken", "scripted_faults"), allow_code=True)
    with pytest.raises(TrialError, match="act raised KeyError: 'velocity'"):
        broken.act({})
    for cls, reason in (
        ("Forgetful", "has only one of `state` and `restore`"),
        ("Idle", "has no method `act`"),
        ("Absent", "has no attribute 'Absent'"),
    ):
        bundle = bundle_for(tmp_path, cls, "scripted_faults")
        with pytest.raises(PolicyError, match=reason):
            open_policy(bundle, allow_code=True)
