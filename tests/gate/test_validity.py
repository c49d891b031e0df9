"""Trials that left the captured volume count for neither side, and too many of them for nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.settings import Validity
from nw_gate.stats.betting import lower_bound, upper_bound
from nw_gate.validity import has_left, seconds_outside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_gate.results.row import Row

LIMITS = Validity(distance=0.5, angle=0.6, alpha=0.9, at_most=0.2)
GATE = Gate(success_rate=0.6, validity=LIMITS)
BARE = Gate(success_rate=0.6)


def seen(row: Row, far: Sequence[float]) -> Row:
    """The row with a camera that was so far from the nearest capture camera, tenth by tenth."""
    n = len(far)
    return replace(
        row, capture_distance=tuple(far), capture_angle=(0.1,) * n, capture_alpha=(1.0,) * n
    )


@pytest.fixture
def rows(run_scene):
    """Rows of a scene, of which some trials, by their numbers, left for a second."""

    def make(scene: str, reached: Sequence[int | None], left: Sequence[int] = ()) -> list[Row]:
        made = run_scene(scene, reached)
        return [
            seen(row, [0.1] * 5 + [0.9 if row.seed_index in left else 0.2] * 10) for row in made
        ]

    return make


@pytest.mark.parametrize(
    ("change", "seconds"),
    [
        ({}, 0.0),
        ({"capture_distance": (0.1, 0.6, 0.6, 0.5, 0.6, 0.1)}, 0.2),
        ({"capture_angle": (0.7, 0.7, 0.7, 0.1, 0.1, 0.7)}, 0.3),
        ({"capture_alpha": (0.8, 0.1, 0.9, 1.0, 1.0, 1.0)}, 0.2),
        # One after the other, by different limits: it is beyond some all the time.
        ({"capture_distance": (0.6, 0.6, 0, 0, 0, 0), "capture_angle": (0, 0, 1, 1, 0, 0)}, 0.4),
    ],
)
def test_the_longest_time_in_a_row_beyond_any_limit_counts(run_scene, change, seconds):
    (row,) = run_scene("a", [4])
    row = replace(seen(row, [0.1] * 6), **change)
    assert seconds_outside(row, Validity(distance=0.5, angle=0.6, alpha=0.85)) == seconds


def test_half_a_second_may_be_and_not_a_tenth_more(run_scene):
    (row,) = run_scene("a", [4])
    assert not has_left(seen(row, [1.0] * 5 + [0.1]), GATE)
    assert has_left(seen(row, [1.0] * 6 + [0.1]), GATE)
    assert not has_left(seen(row, [1.0] * 6), BARE)
    assert not has_left(row, GATE), "nobody knows from where it was photographed"


@given(
    far=st.lists(st.floats(0.0, 2.0, width=32), max_size=40),
    limit=st.floats(0.1, 1.9),
    wider=st.floats(0.0, 1.0),
)
def test_wider_limits_never_make_a_trial_leave(far, limit, wider):
    from nw_gate.results.row import Row

    row = Row(
        trial_id="a-000", suite="s", scene="a", task="gaps", robot="go1", seed_index=0, seed=0,
        policy="p", status="ok", outcome="fell", end_reason="", completed=False, success=0.5,
        waypoints_reached=1, waypoints_total=2, steps=1, sim_s=1.0, physics_s=0.0, render_s=0.0,
        policy_s=0.0, log_s=0.0, wall_s=0.0, checkpoint_digest="", scene_digest="",
    )  # fmt: skip
    row = seen(row, far)
    narrow = seconds_outside(row, Validity(distance=limit))
    assert seconds_outside(row, Validity(distance=limit + wider)) <= narrow <= len(far) / 10


def test_a_policy_that_fails_by_itself_has_failed_wherever_it_was(rows):
    (row,) = rows("a", [2], left=[0])
    assert has_left(row, GATE)
    assert not has_left(replace(row, outcome="policy_failed", end_reason="action"), GATE)


def test_a_trial_that_left_counts_against_each_bound_and_in_no_mean(rows):
    # The first is a success, the second none: nobody looks which.
    verdict = judge(rows("a", [4, 1, 4, 4, 4, 4, 4, 4, 4, 4], left=[0, 1]), GATE, {"a": 10})
    assert verdict.success == 1.0
    assert (verdict.n, verdict.completed) == (8, 8)
    (score,) = verdict.per_scene
    assert (score.n, score.outside, score.missing, score.unseen) == (8, 2, 0, False)
    assert verdict.interval.low == lower_bound([np.array([0.0, 0.0, *[1.0] * 8])])
    assert verdict.interval.high == upper_bound([np.ones(10)])
    assert verdict.left == {"a-000", "a-001"}
    assert any(reason.startswith("2 trials left the captured volume") for reason in verdict.reasons)


def test_who_leaves_where_it_would_fail_does_not_pass_by_it(rows):
    # Truth: 4 of 5 fail at 0.5; of 50 trials the 10 that fail worst walk into the fog.
    reached = [4] * 40 + [0] * 10
    gate = Gate(success_rate=0.85, validity=LIMITS)
    kept = judge(rows("a", reached, left=range(40, 50)), gate, {"a": 50})
    assert kept.success == 1.0
    assert kept.verdict == "INCONCLUSIVE"
    assert judge(rows("a", reached[:40]), gate, {"a": 40}).verdict == "PASS"


def test_who_leaves_where_it_would_succeed_is_not_convicted_by_it(rows):
    reached = [4] * 10 + [2] * 40
    gate = Gate(success_rate=0.6, validity=LIMITS)
    assert judge(rows("a", reached[10:]), gate, {"a": 40}).verdict == "REGRESSED"
    kept = judge(rows("a", reached, left=range(10)), gate, {"a": 50})
    assert kept.verdict == "INCONCLUSIVE"


@pytest.mark.parametrize(("left", "word"), [(12, "PASS"), (13, "INCONCLUSIVE")])
def test_over_the_cap_nothing_passes(rows, left, word):
    verdict = judge(rows("a", [4] * 60, left=range(left)), GATE, {"a": 60})
    assert verdict.verdict == word
    over = f"{left} of 60 trials left the captured volume, over gate.validity.at_most 0.2"
    assert verdict.reasons[0].startswith(over) is (word == "INCONCLUSIVE")


def test_over_the_cap_nothing_convicts_and_nothing_merely_ran(rows):
    worst = rows("a", [0] * 60, left=range(20))
    assert judge(worst, GATE, {"a": 60}).verdict == "INCONCLUSIVE"
    assert judge(worst, Gate(validity=LIMITS), {"a": 60}).verdict == "INCONCLUSIVE"
    # Errors are told first: they may be why.
    assert judge(worst + rows("b", [None]), GATE, {"a": 60, "b": 1}).verdict == "INFRASTRUCTURE"


def test_informational_scenes_may_be_left_as_one_likes(rows):
    found = rows("a", [4] * 60) + rows("toy", [4] * 60, left=range(60))
    gate = Gate(success_rate=0.6, validity=LIMITS, tiers={"toy": "informational"})
    verdict = judge(found, gate, {"a": 60, "toy": 60})
    assert verdict.verdict == "PASS"
    assert verdict.per_scene[1].outside == 60


def test_a_critical_scene_that_was_left_keeps_a_run_from_passing(rows):
    found = rows("a", [4] * 90) + rows("b", [4] * 10, left=range(10))
    tiers = {"b": "critical"}
    supporting = judge(found, GATE, {"a": 90, "b": 10})
    critical = judge(
        found, Gate(success_rate=0.25, validity=LIMITS, tiers=tiers), {"a": 90, "b": 10}
    )
    assert supporting.per_scene[1].unseen
    assert critical.verdict == "INCONCLUSIVE"
    assert critical.reasons[0].startswith("10 of 10 trials of critical scene b left")
    # Without a bar a baseline alone would decide, and must not pass it either.
    barless = judge(found, Gate(validity=LIMITS, tiers=tiers), {"a": 90, "b": 10})
    assert barless.verdict == "INCONCLUSIVE"


@pytest.mark.parametrize("left", [(), range(30)])
def test_without_the_key_nothing_changes(rows, run_scene, left):
    reached = [4, 3, 2, 4] * 15
    verdict = judge(rows("a", reached, left=left), BARE, {"a": 60})
    assert verdict == judge(run_scene("a", reached), BARE, {"a": 60})


def test_scenes_in_which_nobody_can_look_are_counted(run_scene, rows):
    blind = [replace(row, coverage_min=0.5, coverage_mean=0.9) for row in run_scene("b", [4] * 5)]
    verdict = judge(rows("a", [4] * 5) + blind, GATE, {"a": 5, "b": 5})
    assert any("was not looked at in 1 scene" in reason for reason in verdict.reasons)


def test_a_limit_must_be_there_and_within_bounds():
    with pytest.raises(ValidationError, match="set distance, angle or alpha"):
        Validity(longer_than=1.0)
    for wrong in ({"distance": 0.0}, {"alpha": 1.0}, {"angle": 7.0}, {"at_most": 1.0}):
        with pytest.raises(ValidationError):
            Validity(**{"distance": 1.0, **wrong})
