"""Only rows of planned trials count, and only if they are what they say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from nw_base.errors import StoreError
from nw_base.trials import Trial
from nw_gate.results.ended import of_plan

if TYPE_CHECKING:
    from nw_gate.results.row import Row

TRIALS = [
    Trial(
        suite="hurdles",
        suite_digest="aa" * 32,
        suite_seed=3,
        scene="hurdles/one",
        scene_digest="dd" * 32,
        task="hurdles",
        index=index,
    )
    for index in range(2)
]


@pytest.fixture
def row_of(make_row):
    def make(trial: Trial, **changes: Any) -> Row:
        columns = {"trial_id": trial.id, "seed_index": trial.index, "seed": trial.seed}
        return make_row(**{**columns, **changes})

    return make


def test_rows_of_other_trials_are_set_apart(row_of):
    rows = [row_of(trial) for trial in TRIALS]
    mine, others = of_plan(rows, TRIALS[:1], checkpoint="cc" * 32)
    assert mine == rows[:1]
    assert others == rows[1:]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seed": 5}, "its seed is 5, planned was"),
        ({"scene": "hurdles/two"}, "its scene is 'hurdles/two', planned was 'hurdles/one'"),
        ({"seed_index": 1}, "its index is 1, planned was 0"),
        ({"task": "gaps"}, "its task"),
        ({"scene_digest": "ee" * 32}, "its scene digest"),
        ({"checkpoint_digest": "ee" * 32}, "its checkpoint digest"),
        ({"perturbation": (("friction", 0.5),)}, "its perturbation"),
    ],
)
def test_a_row_that_only_bears_the_name_of_a_planned_trial_is_refused(row_of, change, words):
    rows = [row_of(TRIALS[0], **change)]
    with pytest.raises(StoreError, match=f"hurdles-one-000 is not of this run: {words}"):
        of_plan(rows, TRIALS, checkpoint="cc" * 32)
