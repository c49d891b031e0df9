"""Which of many trials a page shows."""

from collections import Counter
from dataclasses import replace

import pytest

from nw_eval.api.evidence import clipped_trials, composed, drawn_trials
from nw_eval.api.evidence_log import ReadLog


@pytest.fixture
def trials(recorded):
    """Return a maker of results: by scene, how many trials reached how many of two waypoints."""
    like = recorded.rows[0]

    def make(scenes):
        return [
            replace(
                like,
                trial_id=f"{scene}-{reached}-{index:03d}",
                scene=scene,
                outcome="completed" if reached == 2 else "fell",
                completed=reached == 2,
                success=reached / 2,
                waypoints_reached=reached,
                waypoint_times=(1.0,) * reached,
            )
            for scene, counts in scenes.items()
            for reached, count in counts.items()
            for index in range(count)
        ]

    return make


def test_all_failures_are_drawn_and_then_every_scene_by_turns(trials):
    rows = trials({"a": {0: 30, 2: 70}, "b": {2: 100}, "c": {1: 10, 2: 3}})
    drawn = drawn_trials(rows, most=100)
    counts = Counter((row.scene, row.completed) for row in drawn)
    assert len(drawn) == 100
    assert (counts["a", False], counts["c", False]) == (30, 10)
    assert counts["c", True] == 3
    assert abs(counts["a", True] - counts["b", True]) <= 1
    assert drawn == drawn_trials(rows[::-1], most=100)


def test_too_many_failures_are_shared_among_the_scenes(trials):
    rows = trials({"a": {0: 300}, "b": {0: 300, 2: 5}})
    counts = Counter(row.scene for row in drawn_trials(rows, most=100))
    assert counts == {"a": 50, "b": 50}


def test_what_ended_without_a_result_is_no_failure(trials):
    rows = trials({"a": {0: 1}})
    fault = replace(
        rows[0], trial_id="x", status="error", outcome="crashed", success=None, completed=False
    )
    assert drawn_trials([*rows, fault]) == rows
    assert clipped_trials([*rows, fault]) == rows


def test_clips_are_of_the_worst_trials_and_one_of_every_other_scene(trials):
    rows = trials({"a": {0: 20}, "b": {1: 5, 2: 5}, "c": {1: 1}, "d": {2: 9}})
    chosen = clipped_trials(rows)
    assert [row.scene for row in chosen] == ["a"] * 8 + ["b", "c"]
    assert [row.success for row in chosen] == [0.0] * 8 + [0.5] * 2


def test_a_page_says_how_many_walks_it_draws_of_how_many(trials):
    rows = trials({"a": {0: 3, 2: 5}})
    whole = ReadLog(walked=((0.0, 0.0), (1.0, 0.0)), waypoints=((1.0, 0.0),))
    evidence = composed(rows, {row.trial_id: whole for row in rows[1:5]})
    assert evidence.of_paths == (
        "Paths of 4 of 8 trials are drawn: of 2 of the 3 that did not complete, and of 2 of the "
        "5 that did."
    )
    assert not composed(rows[3:], {row.trial_id: whole for row in rows[3:]}).remarks


def test_many_logs_that_cannot_be_read_are_counted_and_a_few_named(trials):
    rows = trials({"a": {0: 9}})
    evidence = composed(rows, {row.trial_id: ReadLog(fault="torn") for row in rows})
    named = [remark for remark in evidence.remarks if "torn" in remark]
    assert len(named) == 3
    assert "The same is true of 6 more logs." in evidence.remarks
