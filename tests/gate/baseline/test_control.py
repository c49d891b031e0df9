"""Where a machine has other bits the baseline's policy runs beside the candidate: the control."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_base.errors import IncomparableError, StoreError
from nw_eval.reporting.tables.scenes import scenes_table
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.baseline.judge import compare, setup_of
from nw_gate.baseline.match import contradictions
from nw_gate.results.baseline import trajectory
from nw_gate.settings import Validity

if TYPE_CHECKING:
    from nw_gate.results.baseline import LoadedBaseline


SCENES = ("a", "b", "c", "d")
GATE = Gate(max_drop=0.2)
PERFECT = dict.fromkeys(SCENES, 1.0)
LOW = dict.fromkeys(SCENES, [1.0, 0.5] * 30)


@pytest.fixture
def baseline(make_run, make_baseline):
    """A baseline that was perfect on the machine that it was saved on."""
    return make_baseline(make_run(SCENES, 20, drawn_from=60), dict.fromkeys(SCENES, [1.0] * 60))


@pytest.fixture
def run(make_run, baseline, make_against):
    """A run on another class of machine, on which the baseline's policy has shown other bits."""
    here = make_run(SCENES, 20, drawn_from=60)
    info = make_against(baseline).info.model_copy(update={"checked": "control"})
    elsewhere = {**here.engine, "cpu": "haswell"}
    return here.model_copy(update={"engine": elsewhere, "baseline": info})


@pytest.fixture
def beside(run, baseline, make_against, make_control):
    """The baseline as the run is compared with it, by what its policy scores there."""

    def make(scores: Any, first: int | None = None) -> LoadedBaseline:
        return make_against(baseline, make_control(run, baseline, scores, first))

    return make


def test_an_equal_policy_where_both_drifted_is_not_regressed_though_the_baseline_would_convict_it(
    run, baseline, beside, drawn_rows, make_against
):
    rows = drawn_rows(run, LOW)
    info = make_against(baseline).info.model_copy(update={"checked": "bits"})
    by_baseline = compare(
        rows, run.model_copy(update={"baseline": info}), make_against(baseline), GATE
    )
    assert (by_baseline.basis, by_baseline.word) == ("panel", "REGRESSED")
    found = compare(rows, run, beside(LOW), GATE, power_forecast=True)
    assert (found.basis, found.claim, found.word) == ("control", "fresh", "PASS")
    assert (found.drop, found.control) == (0.0, 80)
    assert not any(item.named for item in found.scenes)
    # What the baseline says of its own machine is in no number: the control's trials are.
    for item in found.scenes:
        assert item.baseline == item.candidate
    assert found.baseline == pytest.approx(0.75, abs=0.1)
    assert found.interval is not None
    assert found.interval.low < 0.0 < found.interval.high < GATE.most_drop


def test_a_policy_that_is_worse_than_the_control_is_regressed(run, beside, drawn_rows):
    found = compare(drawn_rows(run, dict.fromkeys(SCENES, 0.25)), run, beside(PERFECT), GATE)
    assert (found.basis, found.word, found.mean_regressed) == ("control", "REGRESSED", True)
    assert (found.drop, found.baseline) == (0.75, 1.0)
    # Better than a control that drifted is no drop, however far it is from the baseline.
    low = beside(dict.fromkeys(SCENES, 0.25))
    assert compare(drawn_rows(run, dict.fromkeys(SCENES, 0.5)), run, low, GATE).word == "PASS"


def test_a_scene_that_met_no_trial_has_no_score_of_the_control_and_means_are_of_the_pairs(
    run, beside, drawn_rows
):
    scores = {name: 0.25 * (k + 1) for k, name in enumerate(SCENES)}
    rows = drawn_rows(run, dict.fromkeys(SCENES, 0.25))[:2]
    found = compare(rows, run, beside(scores), GATE, power_forecast=True)
    met = [item for item in found.scenes if item.trials]
    assert 0 < len(met) < len(SCENES)
    for item in found.scenes:
        assert item.baseline == (scores[item.scene] if item.trials else None)
    pairs = [scores[row.scene] for row in rows]
    assert found.baseline == sum(pairs) / 2
    assert found.drop == pytest.approx(found.baseline - 0.25)


def test_what_was_compared_with_what_is_said(run, beside, drawn_rows):
    found = compare(drawn_rows(run, PERFECT), run, beside(PERFECT), GATE)
    assert found.reasons[-1] == (
        "this machine computes slightly different results from the one that saved the baseline, so "
        "the candidate is compared with 80 trials of go1-act-rgb that ran here from the same "
        "initial states; `nw-eval baseline save` on this machine saves that time"
    )
    assert (
        "80 trials that ran beside the candidate"
        in scenes_table(replace(judge([], Gate(), {}), against=found)).note
    )


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_trials_of_the_control_that_are_missing_hold_the_ruling_back(run, beside, drawn_rows, data):
    score = st.lists(st.sampled_from([0.0, 0.5, 1.0, 1.0]), min_size=60, max_size=60)
    rows = drawn_rows(run, {name: data.draw(score) for name in SCENES})
    scores = {name: data.draw(score) for name in SCENES}
    count = data.draw(st.integers(0, 80))
    short = compare(rows, run, beside(scores, first=count), GATE)
    both = compare(rows[:count], run, beside(scores, first=count), GATE)
    assert replace(short, control=0) == replace(both, control=0)
    assert short.trials <= count or short.settled
    # It does not matter which of the two is ahead of the other.
    ahead = compare(rows[:count], run, beside(scores), GATE)
    assert replace(ahead, control=0, reasons=()) == replace(both, control=0, reasons=())
    settled = compare(rows, run, beside(scores), GATE)
    if both.settled:
        assert (settled.word, settled.trials) == (both.word, both.trials)


def test_without_a_control_s_trials_nothing_is_ruled(
    run, baseline, drawn_rows, make_against, beside
):
    rows = drawn_rows(run, dict.fromkeys(SCENES, 0.0))
    for against in (make_against(baseline), beside(PERFECT, first=0)):
        found = compare(rows, run, against, GATE)
        assert (found.word, found.trials, found.drop) == ("INCONCLUSIVE", 0, None)
        assert (found.basis, found.control) == ("control", 0)


def test_an_error_of_either_arm_counts_worst_for_each_side(run, beside, drawn_rows):
    rows = drawn_rows(run, PERFECT)
    scene = rows[0].scene

    def first_is(score: float | None) -> dict[str, Any]:
        return {**PERFECT, scene: [score, *[1.0] * 60]}

    def of(candidate: float | None, control: float | None) -> Any:
        mine = drawn_rows(run, first_is(candidate))
        return compare(mine, run, beside(first_is(control)), GATE, power_forecast=True)

    whole, lost, both = of(1.0, 1.0), of(None, 1.0), of(None, None)
    assert whole.word == lost.word == both.word == "PASS"
    assert whole.trials < lost.trials <= both.trials
    # As if the candidate had failed and the control had not: for PASS only.
    assert both.trials == of(0.0, 1.0).trials
    assert both.interval.low < of(0.0, 1.0).interval.low
    assert lost.drop == both.drop == 0.0
    # A pair without a result of the candidate is no pair, and in no mean.
    assert sum(item.trials for item in lost.scenes) == lost.trials - 1


FOG = {
    "capture_distance": (2.0,) * 10,
    "capture_angle": (0.0,) * 10,
    "capture_alpha": (1.0,) * 10,
}
IN_VIEW = GATE.model_copy(update={"validity": Validity(distance=0.5, at_most=0.2)})


def test_a_trial_that_left_the_captured_volume_is_not_a_pair(run, beside, drawn_rows):
    gate = IN_VIEW
    rows = drawn_rows(run, PERFECT)
    gone = [replace(rows[0], **FOG), *rows[1:]]
    left, whole = (compare(x, run, beside(PERFECT), gate) for x in (gone, rows))
    assert (left.word, left.drop) == ("PASS", 0.0)
    assert left.trials > whole.trials
    assert compare(gone, run, beside(PERFECT), GATE).trials == whole.trials


@pytest.mark.parametrize("arm", ["candidate", "control", "both"])
def test_where_one_arm_left_the_captured_volume_the_pair_is_in_no_mean_and_the_other_arm_is_known(
    arm, run, baseline, beside, drawn_rows, make_against
):
    rows, control = drawn_rows(run, {**PERFECT, "b": [0.5] * 60}), beside(PERFECT).control
    scene = rows[0].scene
    assert scene != "b"
    # The start where either is lost is the one at which both failed.
    failed = {"success": 0.0, "completed": False, "outcome": "fell", "waypoints_reached": 0}
    mine = [replace(rows[0], **failed, **(FOG if arm != "control" else {})), *rows[1:]]
    theirs = [
        replace(row, **failed, **(FOG if arm != "candidate" else {}))
        if row.trial_id == rows[0].trial_id
        else row
        for row in control.rows
    ]
    against = make_against(baseline, replace(control, rows=tuple(theirs)))
    found = compare(mine, run, against, IN_VIEW)
    assert {item.scene: (item.baseline, item.candidate) for item in found.scenes} == {
        name: (1.0, 0.5 if name == "b" else 1.0) for name in SCENES
    }, "the start that one of them left is in neither mean"
    assert found.drop == pytest.approx(sum(row.scene == "b" for row in rows[1 : found.trials]) / (
        2 * (found.trials - 1)
    ))  # fmt: skip

    # Of the pair that says least all is unknown: what the other arm did bounds it.
    setup = setup_of(run, against, IN_VIEW)
    trials = setup.met(mine).trials(setup.judged, setup.panel)
    differences = [
        float(counted.candidate[0] - counted.baseline[0])
        for counted in (trials.counted(missing) for missing in (0.0, 1.0))
    ]
    assert (
        differences == {"candidate": [0.0, 1.0], "control": [-1.0, 0.0], "both": [-1.0, 1.0]}[arm]
    )


def test_a_scene_that_regressed_is_named_by_the_trials_beside_it(run, beside, drawn_rows):
    gate = Gate(max_drop=0.24, tolerate=0.2)
    rows = drawn_rows(run, {**PERFECT, "b": 0.25})
    found = compare(rows, run, beside(PERFECT), gate, power_forecast=True)
    fell = {item.scene: item for item in found.scenes}["b"]
    assert (fell.named, fell.waypoint) == (True, 2), "of four waypoints one was reached"
    assert fell.ends is not None
    known, met = fell.ends
    assert sum(known) == sum(met) == fell.trials, "its pairs, not the 60 starts of the baseline"
    # Where the control fails there too nothing regressed.
    alike = compare(rows, run, beside({**PERFECT, "b": 0.25}), gate)
    assert [item.scene for item in alike.scenes if item.named] == []
    assert {item.scene: item.waypoint for item in alike.scenes}["b"] is None


def test_a_claim_about_the_panel_alone_has_no_control(run, beside, drawn_rows):
    with pytest.raises(IncomparableError, match=r"gate\.claim is panel"):
        compare(
            drawn_rows(run, PERFECT), run, beside(PERFECT),
            GATE.model_copy(update={"claim": "panel"}),
        )  # fmt: skip


def test_rows_of_a_candidate_are_no_control(run, baseline, beside, make_against):
    control = beside(PERFECT).control
    assert control is not None
    for wrong in (
        tuple(replace(row, arm="candidate") for row in control.rows),
        tuple(replace(row, checkpoint_digest="cc" * 32) for row in control.rows),
    ):
        with pytest.raises(StoreError, match="is not of this run"):
            compare([], run, make_against(baseline, replace(control, rows=wrong)), GATE)


def test_the_same_bits_with_another_result_contradict_a_baseline_and_other_bits_do_not(
    baseline, beside
):
    control = beside(dict.fromkeys(SCENES, 0.5), first=4).control
    assert control is not None
    assert contradictions(control.rows, baseline, baseline.panels[0]) == ()
    first = control.rows[0]
    starts = tuple(
        replace(start, trajectory=trajectory(first))
        if (start.scene, start.seed_index) == (first.scene, first.seed_index)
        else start
        for start in baseline.panels[0].starts
    )
    told = contradictions(control.rows, baseline, replace(baseline.panels[0], starts=starts))
    assert told[0] == (
        "the baseline is not what its own policy go1-act-rgb does: the same actions, other results"
    )
    assert told[1].startswith(f"scene {first.scene} start {first.seed_index}: success 0.5, ")
    assert len(told) == 2
