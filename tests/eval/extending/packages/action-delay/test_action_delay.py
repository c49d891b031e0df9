from action_delay import AXIS

import nw_eval
from nw_eval.testing import FakePolicy, fake_card, trial_setup


def test_actions_come_later():
    assert AXIS.change(trial_setup(), 2.0).card.control.delay_steps == 2


def test_a_trial_with_it_runs(tmp_path):
    policy = FakePolicy(lambda step: [0.1 * step] * 12)
    run = nw_eval.evaluate(policy, suite="delayed.yaml", card=fake_card(), out=tmp_path / "run")
    assert sorted(dict(row.perturbation)["action_delay"] for row in run.rows) == [0.0, 1.0]
