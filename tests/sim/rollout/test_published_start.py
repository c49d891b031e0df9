"""Under neverwhere-2026 a policy sees nothing before the first control step is done."""

import numpy as np
import pytest

from nw_sim.rollout.job import StageClock
from nw_sim.rollout.opening import open_trial
from nw_sim.rollout.replaying.takeover import replay
from nw_sim.rollout.trial import run_trial


def decisions(job, library, count):
    with open_trial(job, library, StageClock()) as trial:
        made = []
        for _ in range(count):
            made.append(trial.episode.decide())
            trial.episode.advance(made[-1])
        return made


def test_an_action_after_step_k_is_applied_in_step_k_plus_2(make_job, library):
    # Published: steps 0 and 1 apply zeros; the policy is first asked after step 0.
    made = decisions(make_job(protocol="neverwhere-2026"), library, 5)
    assert made[0].observation == {}
    for step in (0, 1):
        assert not made[step].applied.any()
    # Its answer after step k is the decision of step k + 1 here.
    for step in (2, 3, 4):
        np.testing.assert_array_equal(made[step].applied, made[step - 1].action)
        assert made[step].applied.any()


def test_the_strict_protocol_looks_at_once(make_job, library):
    made = decisions(make_job(), library, 2)
    assert made[0].observation
    assert made[1].applied.any()


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_a_published_trial_is_replayed_bit_for_bit(make_job, library, seeing, tmp_path, start):
    path = tmp_path / "trial.mcap"
    job = make_job(mcap=path, record="all", policy=seeing, duration=0.6, protocol="neverwhere-2026")
    result = run_trial(job, library=library)
    assert result.status == "ok", result.error_text
    assert replay(path, start=start, library=library).is_identical
