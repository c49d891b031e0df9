"""A policy that is an object is evaluated without a file, and its rows say what it is."""

import json
from pathlib import Path

import numpy as np
import pytest

import nw_eval
from nw_base.errors import PolicyError, UsageError
from nw_gate.results.row import rows_digest

SUITE = """\
nw-eval: 1
name: tiny
robot: go2
policy: stand
trials: 2
seed: 7
episode: {duration: 0.2}
scenes: [flat/carpet_room]
record: none
"""
CARD = {
    "control": {"action": "joint_position_offset"},
    "observations": {"body": {"sensor": "proprio", "terms": ["gravity", "joint_pos"]}},
}


class Counting:
    """Moves more from step to step, and forgets that at the start of a trial."""

    def __init__(self):
        self.seeds = []

    def reset(self, seed):
        self.seeds.append(seed)
        self.step = 0

    def act(self, observation):
        assert observation["body"].shape == (15,)
        self.step += 1
        return np.full(12, 0.01 * self.step)


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "suite.yaml"
    path.write_text(SUITE)
    return path


def test_an_object_without_a_file_runs_one_trial_after_another_each_begun_anew(suite, tmp_path):
    policy = Counting()
    ran = nw_eval.evaluate(policy, suite=suite, card=CARD, version="epoch 3", out=tmp_path / "run")
    assert [row.steps for row in ran.rows] == [10, 10]
    # A seed for zeros, on which the card is tried before; then one for each trial, all different.
    assert len(policy.seeds) == len(set(policy.seeds)) == 3
    again = nw_eval.evaluate(policy, suite=suite, card=CARD, version="epoch 3")
    assert rows_digest(again.rows) == rows_digest(ran.rows)


def test_rows_and_run_say_what_the_caller_calls_it(suite, tmp_path):
    named = nw_eval.evaluate(
        Counting(), suite=suite, card=CARD, version="epoch 3", out=tmp_path / "named"
    )
    assert {row.checkpoint_digest for row in named.rows} == {"epoch 3"}
    assert {row.policy for row in named.rows} == {"counting"}
    nameless = nw_eval.evaluate(
        lambda _: np.zeros(12), suite=suite, card=CARD | {"name": "zeros"}, out=tmp_path / "zeros"
    )
    assert {row.checkpoint_digest for row in nameless.rows} == {"unnamed"}
    info = json.loads((tmp_path / "zeros" / "run.json").read_text())
    assert info["policy"]["origin"].startswith("an object in the calling process")
    assert info["policy"]["card"] == ""
    assert info["fence"] == "off: in the calling process"


def test_a_log_of_an_object_says_why_it_cannot_be_replayed(suite, tmp_path):
    ran = nw_eval.evaluate(Counting(), suite=suite, card=CARD, out=tmp_path / "run")
    with pytest.raises(PolicyError, match="'counting' was an object of the process that ran it"):
        nw_eval.replay(ran.folder / ran.rows[0].mcap_path)


def test_all_that_is_wrong_with_a_mapping_is_said_as_of_a_file(suite):
    card = {"control": {"acton": "joint_torque"}, "observation": {}, "name": "mine"}
    with pytest.raises(PolicyError) as caught:
        nw_eval.evaluate(Counting(), suite=suite, card=card)
    lines = str(caught.value).splitlines()
    assert all(line.startswith("card 'mine': ") for line in lines)
    assert "did you mean 'action'?" in str(caught.value)
    assert "did you mean 'observations'?" in str(caught.value)


def test_an_object_needs_a_card_and_a_policy_by_name_has_one(suite):
    with pytest.raises(UsageError, match=r"an object \(Counting\) needs a card"):
        nw_eval.evaluate(Counting(), suite=suite)
    with pytest.raises(UsageError, match="'stand' has a card and a digest of its own"):
        nw_eval.evaluate("stand", suite=suite, card=CARD)


@pytest.mark.parametrize("limit", [{"time_limit": 9.0}, {"memory_limit": "2GB"}])
def test_a_limit_is_refused_where_nobody_could_hold_an_object_to_it(suite, limit):
    with pytest.raises(UsageError, match="cannot be enforced with a policy that is an object"):
        nw_eval.evaluate(Counting(), suite=suite, card=CARD, **limit)


def test_a_policy_by_name_is_evaluated_as_run_does_it(suite, tmp_path):
    one = nw_eval.evaluate("stand", suite=suite, robot="go1", workers=1, out=tmp_path / "a")
    two = nw_eval.run(suite, robot="go1", workers=1, out=tmp_path / "b")
    assert rows_digest(one.rows) == rows_digest(two.rows)


def test_rows_are_a_table_of_what_counts_also_without_any(suite, tmp_path):
    ran = nw_eval.evaluate(Counting(), suite=suite, card=CARD, out=tmp_path / "run")
    table = nw_eval.read_rows(str(ran.folder))
    assert list(table["trial_id"]) == sorted(row.trial_id for row in ran.rows)
    assert list(table["success"]) == [0.0, 0.0]
    assert set(table.columns) == set(nw_eval.Row.__dataclass_fields__)
    with pytest.raises(UsageError, match="is not the folder of a run"):
        nw_eval.read_rows(Path(tmp_path / "nothing"))
