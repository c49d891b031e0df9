"""Scores that a suite gates: by a bar and against a baseline, each in its own unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from nw_gate.baseline.combine import judge_run
from nw_gate.results.baseline import BaselineResults, LoadedBaseline
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.scores import specs_of
from nw_gate.settings import Gate

WAYS = {"drawn_from": 60}
COT = {"cost_of_transport": {"bar": 1.6, "max_drop": 0.3, "range": (0.0, 2.0)}}


def with_scores(
    rows: Sequence[Row], values: Mapping[str, Callable[[Row], float | None]]
) -> list[Row]:
    return [
        replace(
            row,
            scores=tuple((n, v) for n, of in values.items() if (v := of(row)) is not None),
        )
        for row in rows
    ]


def baseline_with(baseline: BaselineResults, **values: float) -> BaselineResults:
    panels = tuple(
        replace(
            panel,
            starts=tuple(replace(start, scores=tuple(values.items())) for start in panel.starts),
        )
        for panel in baseline.panels
    )
    manifest = baseline.manifest.model_copy(update={"scores": tuple(values)})
    return BaselineResults(manifest=manifest, panels=panels)


@pytest.fixture
def judged(make_run, make_baseline, drawn_rows, make_against):
    """Judge a run whose every trial completed, by the values of its scores and the baseline's."""

    def judge(
        gate: dict[str, Any],
        now: Mapping[str, Any],
        before: Mapping[str, float] | None = None,
        *,
        trials: int = 20,
        success: float = 1.0,
        scenes: str = "ab",
    ) -> Any:
        ways = {} if before is None else WAYS
        settings = Gate(**gate)
        suite = {"gate": gate}
        run: RunInfo = make_run(scenes, trials, suite=suite, **ways)
        run = run.model_copy(update={"scores": specs_of(now)})
        against: LoadedBaseline | None = None
        if before is not None:
            baseline = make_baseline(run, dict.fromkeys(scenes, [1.0] * 60))
            against = make_against(baseline_with(baseline, **before))
            rows = drawn_rows(run, dict.fromkeys(scenes, success))
        else:
            rows = drawn_rows(
                run.model_copy(update={"drawn_from": 60}), dict.fromkeys(scenes, success)
            )
            planned = {s: sum(row.scene == s for row in rows) for s in scenes}
            infos = {
                name: info.model_copy(update={"trials": planned[name]})
                for name, info in run.scenes.items()
            }
            run = run.model_copy(update={"scenes": infos})
        values = {n: v if callable(v) else (lambda _, v=v: v) for n, v in now.items()}
        return judge_run(with_scores(rows, values), run, settings, against)

    return judge


def test_a_policy_that_gets_as_far_at_a_higher_cost_is_regressed_and_the_score_is_named(judged):
    found = judged(
        {"success_rate": 0.5, "scores": COT},
        {"cost_of_transport": 1.5},
        {"cost_of_transport": 0.92},
    )
    assert (found.verdict, found.success, found.exit_code) == ("REGRESSED", 1.0, 1)
    assert found.reasons[0].startswith(
        "cost_of_transport 0.92 -> 1.5 in 40 trials, max_drop 0.3: at least "
    ), "what decided comes before a bar that was reached"
    (item,) = found.scores
    assert item.drop == pytest.approx(0.58)
    assert item.drops.low > 0.06, "a fifth of max_drop"


def test_a_bar_of_a_score_alone_is_not_called_no_bar(judged):
    found = judged({"scores": COT}, {"cost_of_transport": 0.9}, {"cost_of_transport": 0.92})
    assert found.verdict == "PASS"
    assert any("the bar is 1.6" in reason for reason in found.reasons)
    assert not any("no bar was judged" in reason for reason in found.reasons)


def test_without_the_scores_the_same_trials_pass(judged):
    assert judged({"success_rate": 0.5}, {"cost_of_transport": 1.5}, {}).verdict == "PASS"


def test_the_same_cost_passes_bar_and_baseline(judged):
    found = judged(
        {"success_rate": 0.5, "scores": COT},
        {"cost_of_transport": 0.92},
        {"cost_of_transport": 0.92},
        trials=40,
    )
    assert found.verdict == "PASS"
    (item,) = found.scores
    assert item.word == "PASS"
    assert item.drop == pytest.approx(0.0)
    assert item.interval.low <= 0.92 <= item.interval.high


def test_a_lower_value_is_a_drop_of_a_score_that_should_be_high(judged):
    gate = {"scores": {"distance_before_fall": {"max_drop": 4.0}}}
    assert judged(gate, {"distance_before_fall": 9.0}, {"distance_before_fall": 18.0}).verdict == (
        "REGRESSED"
    )
    assert judged(
        gate, {"distance_before_fall": 18.0}, {"distance_before_fall": 9.0}, trials=40
    ).verdict == ("PASS")


def test_a_bar_alone_makes_a_verdict_where_success_has_none(judged):
    gate = {"scores": {"mean_power": {"bar": 300.0}}}
    assert judged(gate, {"mean_power": 120.0}).verdict == "PASS"
    found = judged(gate, {"mean_power": 500.0})
    assert found.verdict == "REGRESSED"
    assert found.reasons[0].startswith("mean_power is at least ")
    assert found.reasons[0].endswith("W (97.5 % confidence), the bar is 300")
    assert judged(gate, {"mean_power": 290.0}).verdict == "INCONCLUSIVE"


def test_a_trial_without_a_value_counts_as_the_declaration_says(judged):
    gate = {"scores": {"time_to_finish": {"bar": 30.0}}}
    rows = {"time_to_finish": lambda row: None if row.seed_index % 2 else 4.0}
    found = judged(gate, rows)
    (item,) = found.scores
    undefined, trials = item.undefined, item.trials
    assert 0 < undefined < trials
    by_scene = list(item.per_scene.values())
    assert item.mean == pytest.approx(np.mean(by_scene))
    assert 4.0 < item.mean < 60.0
    assert judged(gate, {"time_to_finish": lambda _: None}).verdict == "REGRESSED"


def test_success_still_convicts_beside_scores(judged):
    found = judged(
        {"success_rate": 0.9, "scores": COT},
        {"cost_of_transport": 0.9},
        {"cost_of_transport": 0.9},
        success=0.25,
    )
    assert found.verdict == "REGRESSED"
    assert "success is at most" in " ".join(found.reasons)


def test_a_score_that_no_trial_was_measured_by_is_invalid(judged):
    found = judged({"scores": {"mean_power": {"bar": 300.0}}}, {})
    assert found.verdict == "INVALID"
    assert found.reasons[0] == (
        "mean_power was not measured in this run: run again with this suite"
    )


def test_a_baseline_without_the_score_is_invalid(judged):
    found = judged({"scores": COT}, {"cost_of_transport": 0.9}, {})
    assert found.verdict == "INVALID"
    (told,) = [reason for reason in found.reasons if "has no cost_of_transport" in reason]
    assert told.startswith("the baseline shipped has no cost_of_transport: save it again with `")
    assert "nw-eval baseline save" in told
    assert "--renew" in told


def test_a_baseline_at_the_end_of_the_range_is_invalid(judged):
    found = judged({"scores": COT}, {"cost_of_transport": 1.9}, {"cost_of_transport": 1.9})
    assert found.verdict == "INVALID"
    assert "so near is the end of its range: lower max_drop" in " ".join(found.reasons)


def test_a_run_with_holes_stays_infrastructure(judged):
    found = judged({"scores": {"mean_power": {"bar": 300.0}}}, {"mean_power": 900.0}, success=None)
    assert found.verdict == "INFRASTRUCTURE"


def test_what_is_measured_and_not_gated_is_reported_and_judges_nothing(judged):
    found = judged({}, {"mean_power": 120.0, "foot_slip": 0.1})
    assert found.verdict == "RAN"
    assert [(item.spec.name, item.mean, item.word) for item in found.scores] == [
        ("mean_power", pytest.approx(120.0), None),
        ("foot_slip", pytest.approx(0.1), None),
    ]


def test_errors_of_regressed_are_split_over_all_that_is_gated():
    assert Gate().shared == 1
    assert Gate(scores=COT).shared == 2


@pytest.mark.parametrize(
    ("scores", "said"),
    [
        ({"cost": {"bar": 1.0}}, "'cost' is not a score; known: action_acceleration"),
        ({"success": {"bar": 0.5}}, "success is judged by success_rate and max_drop"),
        ({"mean_power": {}}, "neither bar nor max_drop is set"),
        ({"mean_power": {"bar": 5000.0}}, "mean_power: bar 5000 is not between 0 and 1000"),
        ({"foot_slip": {"max_drop": 1.0}}, "foot_slip: max_drop 1 is as wide as its range"),
        (
            {"foot_slip": {"max_drop": 0.1, "range": (0.0, 2.0)}},
            "foot_slip: range 0 to 2 is not within 0 to 1",
        ),
        ({"foot_slip": {"max_drop": 0.1, "tolerate": 0.2}}, "tolerate 0.2 is over max_drop"),
    ],
)
def test_what_cannot_be_gated_is_reported(scores, said):
    with pytest.raises(ValidationError, match=said):
        Gate(scores=scores)


CRITICAL = {"success_rate": 0.5, "tiers": {"a": "critical"}}


@pytest.mark.parametrize("tier", ["critical", "supporting"])
def test_a_critical_scene_convicts_by_a_score_that_is_worse_there_alone(judged, tier):
    """Worse by 1 in scene a, and better by 0.9 in b: the mean has hardly changed."""
    found = judged(
        {
            **CRITICAL,
            "tiers": {"a": tier},
            "scores": COT | {"cost_of_transport": {"max_drop": 0.3, "range": (0.0, 2.0)}},
        },
        {"cost_of_transport": lambda row: 1.92 if row.scene == "a" else 0.02},
        {"cost_of_transport": 0.92},
        trials=40,
    )
    alone = [reason for reason in found.reasons if reason.startswith("critical scene a alone: ")]
    assert (found.verdict == "REGRESSED") == (tier == "critical") == bool(alone)
    if alone:
        (item,) = found.scores
        assert item.drop < item.max_drop, "the mean alone would not convict"
        assert "cost_of_transport 0.92 -> 1.92 in " in alone[0]
        assert alone[0].index(", at least ") < alone[0].index(" worse (99.75 % confidence)")
        assert "critical scene b" not in alone[0]


def test_the_bar_of_a_score_is_in_the_sum_of_what_convicts_wrongly(judged):
    now, before = {"cost_of_transport": 0.9}, {"cost_of_transport": 0.92}
    asked = {"cost_of_transport": {"max_drop": 0.3, "range": (0.0, 2.0)}}
    alone = judged({"scores": asked}, now, before)
    asked["cost_of_transport"]["bar"] = 1.6
    barred = judged({"scores": asked}, now, before)
    assert alone.against.false_alarm == pytest.approx(0.01)
    assert barred.against.false_alarm == pytest.approx(0.06), "1 - confidence more, as by success"


@pytest.mark.parametrize("tier", ["critical", "supporting"])
def test_a_critical_scene_convicts_by_the_bar_of_a_score_alone(judged, tier):
    found = judged(
        {"tiers": {"a": tier}, "scores": {"cost_of_transport": {"bar": 1.4, "range": (0.0, 2.0)}}},
        {"cost_of_transport": lambda row: 2.0 if row.scene == "a" else 0.0},
    )
    alone = [reason for reason in found.reasons if reason.startswith("critical scene a alone: ")]
    assert (found.verdict == "REGRESSED") == (tier == "critical") == bool(alone)


def test_a_critical_scene_in_which_a_score_is_worse_by_no_more_than_max_drop_convicts_nobody(
    judged,
):
    found = judged(
        {**CRITICAL, "scores": {"cost_of_transport": {"max_drop": 0.3, "range": (0.0, 2.0)}}},
        {"cost_of_transport": lambda row: 1.22 if row.scene == "a" else 0.62},
        {"cost_of_transport": 0.92},
        trials=40,
    )
    assert found.verdict != "REGRESSED"
