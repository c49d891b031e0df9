"""No number that is none, nor one at the end of all numbers, decides anything.

Such a number is refused with its place, or is in a verdict that it did not decide. A policy that
always fails never passes by one.
"""

from __future__ import annotations

import json
import math
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from nw_base.errors import UsageError
from nw_eval.suite.model import new_suite, override_gate
from nw_gate.absolute import judge
from nw_gate.baseline.scores import with_scores
from nw_gate.ledger import BaselineEntry, LedgerEntry
from nw_gate.results.row import COLUMNS, Row

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ODD = (
    math.nan, math.inf, -math.inf, 1.7e308, -1.7e308, -0.0, 5e-324, -5e-324, 1e-300, 1e300,
)  # fmt: skip
odd = st.sampled_from(ODD)
either = odd | st.floats(-2.0, 2.0)
quiet = settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)

SUITE: dict[str, Any] = {
    "nw-eval": 1,
    "name": "odd",
    "robot": "go1",
    "policy": "stand",
    "trials": 20,
    "seed": 1,
    "scenes": ["a"],
}
BASE = {"name": "mean_power", "bar": 100.0}
NUMBERS: dict[str, Callable[[float], dict[str, Any]]] = {
    "gate.success_rate": lambda x: {"gate": {"success_rate": x}},
    "gate.max_drop": lambda x: {"gate": {"max_drop": x}},
    "gate.tolerate": lambda x: {"gate": {"success_rate": 0.5, "tolerate": x}},
    "gate.scene_drop": lambda x: {"gate": {"success_rate": 0.5, "scene_drop": x}},
    "gate.false_alarm": lambda x: {"gate": {"success_rate": 0.5, "false_alarm": x}},
    "gate.confidence": lambda x: {"gate": {"success_rate": 0.5, "confidence": x}},
    "gate.rounds": lambda x: {"gate": {"success_rate": 0.5, "rounds": x}},
    "trials": lambda x: {"trials": x},
    "seed": lambda x: {"seed": x},
    "episode.duration": lambda x: {"episode": {"duration": x}},
    "render.near": lambda x: {"render": {"near": x}},
    "validity.distance": lambda x: {"gate": {"success_rate": 0.5, "validity": {"distance": x}}},
    "validity.angle": lambda x: {"gate": {"success_rate": 0.5, "validity": {"angle": x}}},
    "validity.alpha": lambda x: {"gate": {"success_rate": 0.5, "validity": {"alpha": x}}},
    "validity.longer_than": lambda x: {
        "gate": {"success_rate": 0.5, "validity": {"angle": 1.0, "longer_than": x}}
    },
    "validity.at_most": lambda x: {
        "gate": {"success_rate": 0.5, "validity": {"angle": 1.0, "at_most": x}}
    },
    "scores.bar": lambda x: {"gate": {"scores": {"foot_slip": {"bar": x}}}},
    "scores.max_drop": lambda x: {"gate": {"scores": {"foot_slip": {"max_drop": x}}}},
    "scores.tolerate": lambda x: {
        "gate": {"scores": {"foot_slip": {"max_drop": 0.5, "tolerate": x}}}
    },
    "scores.range low": lambda x: {
        "gate": {"scores": {"foot_slip": {"bar": 0.5, "range": [x, 0.9]}}}
    },
    "scores.range high": lambda x: {
        "gate": {"scores": {"foot_slip": {"bar": 0.5, "range": [0.0, x]}}}
    },
    "expect.at_most": lambda x: {"expect": {"it": {"reading": "roll", "at_most": x}}},
    "expect.longer_than": lambda x: {
        "expect": {"it": {"reading": "roll", "at_most": 1.0, "longer_than": x}}
    },
    "expect.at_least": lambda x: {"expect": {"it": {"score": "foot_slip", "at_least": x}}},
    "own range": lambda x: {
        "scores": [{"python": "a.py:a", "better": "higher", "range": [x, 1.0]}]
    },
    "own undefined": lambda x: {
        "scores": [{"python": "a.py:a", "better": "higher", "range": [0, 1], "undefined": x}]
    },
    "perturb": lambda x: {"perturb": {"friction": [x]}},
}


def numbers_in(value: Any) -> Iterator[float]:
    """Yield every number that is somewhere in a value."""
    if isinstance(value, bool | str | bytes) or value is None:
        return
    if isinstance(value, int | float):
        yield float(value)
    elif isinstance(value, BaseModel):
        yield from numbers_in(value.model_dump())
    elif is_dataclass(value):
        for each in fields(value):
            yield from numbers_in(getattr(value, each.name))
    elif isinstance(value, dict):
        for each in value.values():
            yield from numbers_in(each)
    elif isinstance(value, tuple | list | frozenset):
        for each in value:
            yield from numbers_in(each)


def made_or_refused(make: Callable[[], Any]) -> Any:
    try:
        return make()
    except (UsageError, ValidationError) as error:
        return error


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", ODD)
def test_a_number_of_a_suite_is_refused_or_decides_nothing(name, value, run_scene):
    suite = made_or_refused(lambda: new_suite({**SUITE, **NUMBERS[name](value)}))
    if isinstance(suite, ValidationError):
        assert suite.errors()[0]["loc"], "the place is said"
        return
    assert all(map(math.isfinite, numbers_in(suite)))
    verdict = judge(run_scene("a", [0] * 20), suite.gate, {"a": 20})
    assert verdict.verdict in {"REGRESSED", "INCONCLUSIVE", "RAN"}
    assert all(map(math.isfinite, numbers_in(verdict)))
    assert not any("nan" in reason for reason in verdict.reasons)


@pytest.mark.parametrize("value", ODD)
@pytest.mark.parametrize("name", ["max_drop", "tolerate"])
def test_an_option_of_the_gate_is_refused_by_its_name(name, value):
    suite = new_suite({**SUITE, "gate": {"success_rate": 0.5}})
    changed = made_or_refused(lambda: override_gate(suite, **{name: value}))
    if isinstance(changed, UsageError):
        assert name.replace("_", "-") in str(changed) or name in str(changed)
        assert "{" not in str(changed), "no setting is printed as Python has it"
    else:
        assert 0.0 <= getattr(changed.gate, name) < 1.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_row_holds_finite_numbers_alone(value, run_scene):
    (row,) = run_scene("a", [4])
    held = [name for name, column in COLUMNS.items() if column.is_real]
    assert len(held) > 10
    for name in held:
        with pytest.raises(ValueError, match=name):
            replace(row, **{name: value})
    for name in ("perturbation", "scores"):
        with pytest.raises(ValueError, match="x is not finite"):
            replace(row, **{name: (("x", value),)})
    for name in ("waypoint_times", "capture_alpha"):
        with pytest.raises(ValueError, match=name):
            replace(row, **{name: (value,)})


@quiet
@given(ends=st.tuples(either, either), bar=either, value=either, better=st.booleans())
def test_a_score_passes_by_values_that_reach_its_bar_and_by_nothing_else(
    ends, bar, value, *, better, run_info
):
    own = {"python": "a.py:own", "better": "higher" if better else "lower", "range": list(ends)}
    try:
        suite = new_suite({**SUITE, "scores": [own], "gate": {"scores": {"own": {"bar": bar}}}})
    except ValidationError:
        return
    rows, run = run_info(suite, value)
    verdict = judge(rows, suite.gate, {"a": len(rows)})
    judged = with_scores(verdict, rows, run, suite.gate, None)
    assert all(map(math.isfinite, numbers_in(judged)))
    assert not any("nan" in reason or "inf" in reason.split() for reason in judged.reasons)
    if judged.verdict == "PASS":
        assert value >= bar if better else value <= bar


@pytest.fixture
def run_info(run_scene):
    """Rows of 100 trials with one value of a score, as far as rows can hold it; and their run."""

    class Run:
        def __init__(self, suite: Any) -> None:
            self.scores = suite.measured

    def make(suite: Any, value: float) -> tuple[list[Row], Any]:
        scores = (("own", value),) if math.isfinite(value) else ()
        rows = [replace(row, scores=scores) for row in run_scene("a", [4] * 100)]
        return rows, Run(suite)

    return make


ENTRY: dict[str, Any] = {
    "time": "2026-11-29T00:00:00Z", "run": "r", "suite": "s", "suite_digest": "d",
    "panel": "pinned", "candidate": "c", "candidate_digest": "d", "word": "PASS", "trials": 1,
    "success": 1.0, "bar": 0.5, "confidence": 0.95, "scores": {"x": [0.1, 0.2, 0.0, 1.0]},
    "baseline": {
        "bank": "b", "digest": "d", "basis": "panel", "word": "PASS", "trials": 1, "drop": 0.0,
        "max_drop": 0.1, "tolerate": 0.02, "alpha_pass": 0.05, "alpha_regr": 0.01,
        "scene_drop": 0.1,
    },
}  # fmt: skip


@pytest.mark.parametrize("word", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_ledger_holds_finite_numbers_alone(word):
    assert LedgerEntry.model_validate_json(json.dumps(ENTRY))
    real = {name for name, field in LedgerEntry.model_fields.items() if "float" in str(field)}
    nested = {
        name
        for name, field in BaselineEntry.model_fields.items()
        if "float" in str(field.annotation)
    }
    for name in real - {"scores", "baseline"}:
        text = json.dumps({**ENTRY, name: "@"}).replace('"@"', word)
        with pytest.raises(ValidationError, match=name):
            LedgerEntry.model_validate_json(text)
    for name in nested:
        baseline = {**ENTRY["baseline"], name: "@"}
        text = json.dumps({**ENTRY, "baseline": baseline}).replace('"@"', word)
        with pytest.raises(ValidationError, match=name):
            LedgerEntry.model_validate_json(text)
    text = json.dumps({**ENTRY, "scores": {"x": [0.1, "@", 0, 1]}}).replace('"@"', word)
    with pytest.raises(ValidationError, match="scores"):
        LedgerEntry.model_validate_json(text)
