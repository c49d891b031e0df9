from __future__ import annotations

import json

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nw_gate.results.row import (
    MEASURED,
    from_dict,
    rows_digest,
    self_contradiction,
    to_dict,
)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"success": 1.5}, "not between 0 and 1"),
        ({"success": float("nan")}, "not between 0 and 1"),
        ({"success": None}, "not between 0 and 1"),
        ({"waypoints_reached": 5}, "5 of 4 waypoints"),
        ({"completed": True}, "completed is True at success 0.75"),
        ({"outcome": "crashed"}, "does not go with status 'ok'"),
        ({"status": "fine"}, "neither ok nor error"),
        ({"status": "error", "outcome": "crashed"}, "an error has a success"),
        ({"seed": 2**64}, "does not fit 64 bits"),
        ({"seed": -1}, "does not fit 64 bits"),
        ({"wall_s": float("inf")}, "not finite"),
        ({"coverage_min": float("nan")}, "coverage_min is not finite"),
        ({"waypoint_times": (float("nan"),)}, "waypoint_times is not finite"),
        ({"perturbation": (("friction", float("inf")),)}, "friction is not finite"),
        ({"steps": 2**31}, "steps is 2147483648"),
        ({"attempt": -1}, "attempt is -1"),
        ({"steps": 1.5}, "steps is 1.5"),
        ({"steps": True}, "steps is True"),
        ({"completed": 0}, "completed is 0"),
        ({"scene": {"a": 1}}, "scene is {'a': 1}"),
        ({"wall_s": "\x1b[2J"}, r"wall_s is '\\x1b\[2J'"),
    ],
)
def test_a_row_that_contradicts_itself_is_refused(make_row, changes, words):
    with pytest.raises(ValueError, match=words):
        make_row(**changes)


def test_an_error_has_no_fraction_that_one_could_average(make_row):
    row = make_row(status="error", outcome="hung", success=None, error_text="no step for 60 s")
    assert row.success is None


def test_a_row_survives_json_exactly(make_row):
    row = make_row(perturbation=(("friction", 0.6),), success=1 / 3, coverage_min=0.1)
    again = from_dict(json.loads(json.dumps(to_dict(row))))
    assert again == row
    assert again.digest == row.digest


def test_the_digest_is_that_of_the_first_rows_whatever_columns_are_called_or_added(make_row):
    # As it was when `success` was called `fraction`, and neither robot nor tier was told.
    digest = "01cd5974f4e41df18fb28295e18eb91e72bc005aaa5713e4fb287fe7b59d0635"
    assert make_row().digest == digest
    assert make_row(robot="go2", tier="critical").digest == digest


def test_a_tier_that_is_none_is_refused(make_row):
    with pytest.raises(ValueError, match="tier 'vital' is none of critical, supporting, info"):
        make_row(tier="vital")


@pytest.mark.parametrize("column", sorted(MEASURED))
def test_the_digest_ignores_what_differs_between_runs(make_row, column):
    changed = {"cached": True, "host": "other", "mcap_path": "mcap/x.mcap"}
    changed["mcap_sha256"] = "ff" * 32
    assert make_row(**{column: changed.get(column, 7)}).digest == make_row().digest


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"success": 0.5},
        {"waypoint_times": (1.1, 2.2, 3.4)},
        {"state_digest": "ee"},
        {"action_digest": "ee"},
        {"sim_s": 4.02},
        {"checkpoint_digest": "ee" * 32},
        {"outcome": "timeout"},
    ],
)
def test_the_digest_sees_every_part_of_the_result(make_row, change):
    assert make_row(**change).digest != make_row().digest


def test_the_digest_of_rows_ignores_their_order(make_row):
    rows = [make_row(trial_id=f"t-{k}") for k in range(3)]
    assert rows_digest(rows) == rows_digest(rows[::-1])
    assert rows_digest(rows) != rows_digest(rows[:2])


def test_unknown_or_missing_columns_are_named(make_row):
    values = to_dict(make_row())
    with pytest.raises(ValueError, match="unknown columns colour"):
        from_dict({**values, "colour": 1})
    del values["outcome"]
    with pytest.raises(ValueError, match="outcome"):
        from_dict(values)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text(max_size=60), st.integers(1, 100_000))
def test_texts_from_anywhere_become_harmless_once_and_for_all(make_row, text, times):
    row = make_row(end_reason=text * times, host=text)
    assert row.end_reason.isprintable()
    assert len(row.end_reason) <= 1060
    assert not row.host.startswith("::")
    again = from_dict(json.loads(json.dumps(to_dict(row))))
    assert again == row
    assert again.digest == row.digest


def test_an_error_of_millions_of_characters_is_told_in_a_thousand(make_row):
    row = make_row(
        status="error", outcome="policy_error", success=None, error_text="no\n" * 2_000_000
    )
    assert row.error_text.startswith("no no no")
    assert row.error_text.endswith("more characters")
    assert len(row.error_text) < 1060


@pytest.mark.parametrize("times", [[1e300], ["soon"], [None], 7])
def test_times_that_are_none_are_one_sentence(make_row, times):
    with pytest.raises(ValueError, match=r"\w"):
        from_dict({**to_dict(make_row()), "waypoint_times": times})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {
                "success": 1.0,
                "completed": True,
                "outcome": "completed",
                "waypoints_reached": 0,
                "waypoints_total": 0,
                "waypoint_times": (),
            },
            "success 1.0 of a course without waypoints",
        ),
        ({"success": 0.9}, "success 0.9 with 3 of 4 waypoints reached"),
        ({"outcome": "completed"}, "completed is False and the outcome completed"),
        (
            {"success": 1.0, "completed": True, "waypoints_reached": 4},
            "completed is True and the outcome fell",
        ),
        ({"waypoint_times": ()}, "0 waypoint_times of 3 waypoints reached"),
        ({"waypoint_times": (1.0, 3.0, 2.0)}, "waypoint_times go back"),
        ({"waypoint_times": (1.0, 2.0, 5.0)}, "a waypoint reached at 5.000 s of 4.000 s"),
        ({"steps": 100}, "100 steps, 50 a second, in 4.000 s"),
        ({"contact_s": 4.5}, "4.500 s in contact of 4.000 s"),
        ({"coverage_min": 0.9, "coverage_mean": 0.5}, "coverage_min 0.9 and coverage_mean 0.5"),
        ({"coverage_min": 0.9}, "coverage_min 0.9 and coverage_mean None"),
        ({"coverage_min": 0.9, "coverage_mean": 1.5}, "coverage_mean 1.5"),
        (
            {
                "status": "error",
                "outcome": "crashed",
                "success": None,
                "completed": True,
            },
            "an error is completed",
        ),
    ],
)
def test_a_row_whose_values_are_right_alone_and_make_no_result_together_says_so(
    make_row, changes, said
):
    assert self_contradiction(make_row()) is None
    assert self_contradiction(make_row(**changes)) == said
