"""Against a baseline, a trial that left the captured volume says nothing about its start."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.suite import Gate
from nw_gate.baseline.combine import judge_run
from nw_gate.baseline.judge import compare
from nw_gate.settings import Validity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_gate.results.row import Row


BARE = Gate(max_drop=0.1)
GATE = BARE.model_copy(update={"validity": Validity(distance=0.5, at_most=0.2)})


def gone(rows: Sequence[Row], places: Sequence[int]) -> list[Row]:
    """The rows, of which those at some places went 2 m away for a second."""
    far = {"capture_distance": (2.0,) * 10, "capture_angle": (0.0,) * 10}
    return [
        replace(row, **far, capture_alpha=(1.0,) * 10) if place in places else row
        for place, row in enumerate(rows)
    ]


@pytest.fixture
def meet(make_run, make_baseline, drawn_rows, make_against):
    """A candidate's rows in two scenes, by their trials' successes, beside a perfect baseline."""

    def make(
        a: Sequence[float | None] | float, b: Sequence[float | None] | float, first: int = 40
    ) -> Any:
        run = make_run(["a", "b"], 20, drawn_from=60)
        baseline = make_baseline(run, {"a": [1.0] * 60, "b": [1.0] * 60})
        return drawn_rows(run, {"a": a, "b": b}, first), run, make_against(baseline)

    return make


@pytest.mark.parametrize("success", [1.0, 0.0])
def test_it_counts_as_a_trial_without_result_does_whatever_it_scored(meet, success):
    crashed, run, against = meet([1.0, None, *[1.0] * 58], 1.0)
    known, _, _ = meet([1.0, success, *[1.0] * 58], 1.0)
    place = next(place for place, row in enumerate(crashed) if row.status == "error")
    lost, left = (
        compare(rows, run, against, gate, power_forecast=True)
        for rows, gate in ((crashed, BARE), (gone(known, [place]), GATE))
    )
    assert left.trials == 40
    assert (left.word, left.trials, left.interval) == (lost.word, lost.trials, lost.interval)
    assert left.drop == lost.drop == 0.0
    assert [item.evidence for item in left.scenes] == [item.evidence for item in lost.scenes]
    assert [item.trials for item in left.scenes] == [item.trials for item in lost.scenes]
    assert [item.ends for item in left.scenes] == [item.ends for item in lost.scenes]


def test_no_candidate_passes_or_falls_by_what_left(meet):
    rows, run, against = meet(1.0, 1.0)
    assert compare(rows, run, against, GATE).word == "PASS"
    assert compare(gone(rows, range(0, 40, 6)), run, against, GATE).word == "INCONCLUSIVE"
    worse = [*meet(0.0, 0.0, 3)[0], *rows[3:]]
    assert compare(worse, run, against, GATE).word == "REGRESSED"
    assert compare(gone(worse, range(3)), run, against, GATE).word == "INCONCLUSIVE"


def test_over_the_cap_not_even_a_policy_that_always_falls_is_convicted(meet):
    rows, run, against = meet(0.0, 0.0)
    assert compare(rows, run, against, GATE).word == "REGRESSED"
    far = gone(rows, range(9))
    found = compare(far, run, against, GATE)
    assert found.word == "INCONCLUSIVE"
    assert found.reasons[0].startswith("9 of 40 trials left the captured volume, over")
    verdict = judge_run(far, run, GATE, against)
    assert (verdict.verdict, verdict.exit_code) == ("INCONCLUSIVE", 3)
    assert sum("over gate.validity.at_most" in reason for reason in verdict.reasons) == 1


def test_without_the_key_the_baseline_is_met_as_ever(meet):
    rows, run, against = meet([1.0, 0.5] * 30, 1.0)
    assert compare(gone(rows, range(15)), run, against, BARE) == compare(rows, run, against, BARE)
