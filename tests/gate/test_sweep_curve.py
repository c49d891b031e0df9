"""Where a policy breaks off along an axis: beyond chance, or not at all."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nw_eval.reporting.sweep import cliff_words, parting_words, sweep_table, write_sweep
from nw_gate.scores import specs_of
from nw_gate.sweep import curve_of
from nw_sim.axes import axis_named


class Row:
    """What a curve reads of a row."""

    def __init__(self, value, completed, scene="a", axis="friction", success=None):
        self.perturbation = ((axis, value),)
        self.scene = scene
        self.completed = completed
        self.success = (1.0 if completed else 0.25) if success is None else success


def rows_of(shares, n=20, axis="friction", scenes=("a", "b")):
    """Rows with these shares completed, by value."""
    return [
        Row(value, number < round(share * n), scene, axis)
        for value, share in shares.items()
        for scene in scenes
        for number in range(n)
    ]


def test_a_cliff_is_the_first_value_from_the_neutral_one_that_is_worse_beyond_chance():
    curve = curve_of(
        axis_named("friction"), "p", rows_of({0.2: 0.0, 0.4: 0.3, 0.6: 0.95, 1.2: 1.0})
    )
    (cliff,) = curve.cliffs
    assert (cliff.holds.value, cliff.falls.value) == (0.6, 0.4)
    assert curve.reference.value == 1.2
    (line,) = cliff_words(curve)
    fell, held = line.split("; ")
    assert fell == "p: falls at friction 0.4: 12 of 40 completed against 40 of 40 at 1.2"
    assert held == "whether it holds at 0.6 (38 of 40), chance leaves open"


def test_a_camera_that_may_tilt_both_ways_has_a_cliff_on_each_side():
    shares = {-0.3: 0.1, -0.1: 1.0, 0.0: 1.0, 0.1: 0.9, 0.3: 0.0}
    curve = curve_of(axis_named("camera_pitch"), "p", rows_of(shares, axis="camera_pitch"))
    assert [(c.holds.value, c.falls.value) for c in curve.cliffs] == [(-0.1, -0.3), (0.1, 0.3)]


def test_a_value_that_is_as_good_as_the_neutral_one_holds():
    curve = curve_of(
        axis_named("payload"), "p", rows_of({0.0: 0.9, 2.0: 0.95, 5.0: 0.0}, axis="payload")
    )
    (line,) = cliff_words(curve)
    assert line.endswith("; holds at 2")


def test_what_chance_may_explain_is_no_cliff():
    curve = curve_of(axis_named("friction"), "p", rows_of({0.4: 0.9, 1.2: 1.0}, n=10))
    assert curve.cliffs == ()
    (line,) = cliff_words(curve)
    assert "no cliff from friction 0.4 to 1.2" in line


def test_a_fall_that_so_few_trials_cannot_show_is_too_few_trials_and_says_how_many_would():
    curve = curve_of(axis_named("friction"), "p", rows_of({0.2: 0.0, 1.25: 1.0}, n=2))
    (line,) = cliff_words(curve)
    assert line == (
        "p: too few trials to tell; 3 needed in each scene at each value (--trials 3) for a fall "
        "from 4 of 4 to none"
    )
    (enough,) = curve_of(axis_named("friction"), "p", rows_of({0.2: 0.0, 1.25: 1.0}, n=3)).cliffs
    assert enough.falls.value == 0.2


@pytest.mark.parametrize("scenes", [("a",), ("a", "b"), ("a", "b", "c", "d", "e", "f")])
@pytest.mark.parametrize("values", [2, 5, 9])
def test_the_number_that_is_needed_is_the_least_with_which_a_fall_to_none_is_found(scenes, values):
    shares = {0.1 * (place + 1): 0.0 for place in range(values - 1)} | {1.25: 1.0}
    few = curve_of(axis_named("friction"), "p", rows_of(shares, n=1, scenes=scenes))
    if few.needed is None:
        assert few.cliffs
        return
    for n in (few.needed - 1, few.needed):
        curve = curve_of(axis_named("friction"), "p", rows_of(shares, n=n, scenes=scenes))
        assert bool(curve.cliffs) == (n == few.needed)
        assert (curve.needed is None) == (n == few.needed)


def test_where_few_complete_at_the_reference_more_trials_are_needed_than_are_for_all():
    curve = curve_of(
        axis_named("friction"), "p", rows_of({0.2: 0.0, 1.25: 0.3}, n=10, scenes=("a",))
    )
    (line,) = cliff_words(curve)
    assert line.endswith("for a fall from 3 of 10 to none")
    more = rows_of({0.2: 0.0, 1.25: 0.3}, n=curve.needed, scenes=("a",))
    assert curve.needed > 10
    assert curve_of(axis_named("friction"), "p", more).cliffs


def test_two_policies_of_too_few_trials_are_not_said_to_be_alike():
    one, two = (
        curve_of(axis_named("friction"), name, rows_of({0.4: share, 1.2: share}, n=2))
        for name, share in (("one", 1.0), ("two", 0.0))
    )
    assert parting_words(one, two) == (
        "one and two: too few trials to tell; 3 needed in each scene at each value (--trials 3) "
        "for all of one and none of the other"
    )


def test_a_value_at_which_too_few_trials_ran_neither_falls_nor_holds_in_the_parquet_file(tmp_path):
    rows = rows_of({0.2: 0.0, 1.25: 1.0}, n=2)
    write_sweep([[curve_of(axis_named("friction"), "p", rows)]], "smoke", tmp_path)
    written = pq.read_table(tmp_path / "sweep.parquet").to_pylist()
    assert [(row["falls"], row["trials_needed"]) for row in written] == [(None, 3), (False, 3)]
    page = (tmp_path / "sweep.md").read_text()
    assert "* p: too few trials to tell; 3 needed" in page
    assert "no cliff" not in page


def test_a_policy_that_never_completes_has_nothing_to_fall_from():
    curve = curve_of(axis_named("friction"), "p", rows_of({0.4: 0.0, 1.2: 0.0}))
    assert cliff_words(curve) == [
        "p: nothing to fall from: none of 40 trials at friction 1.2 completed"
    ]


def test_trials_without_a_result_are_counted_and_judge_nothing():
    rows = rows_of({0.4: 1.0, 1.2: 1.0}, n=3)
    rows.append(Row(0.4, None, success=None))
    rows[-1].success = None
    curve = curve_of(axis_named("friction"), "p", rows)
    assert [point.errors for point in curve.points] == [1, 0]
    assert sweep_table([curve]).rows[0][2] == "6, 1 errors"


def test_two_policies_part_where_they_do_beyond_chance():
    one = curve_of(axis_named("friction"), "one", rows_of({0.4: 1.0, 1.2: 1.0}))
    two = curve_of(axis_named("friction"), "two", rows_of({0.4: 0.1, 1.2: 0.95}))
    assert (
        parting_words(one, two)
        == "one and two: different shares complete at friction 0.4 (1.00 and 0.10)"
    )
    assert "at no value" in parting_words(one, one)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 6), min_size=2, max_size=6), st.integers(0, 2**32 - 1))
def test_the_order_of_rows_changes_nothing(done, seed):
    shares = {0.1 * (place + 1): count / 6 for place, count in enumerate(done)}
    rows = rows_of(shares, n=6)
    shuffled = [rows[i] for i in np.random.default_rng(seed).permutation(len(rows))]
    assert curve_of(axis_named("friction"), "p", rows) == curve_of(
        axis_named("friction"), "p", shuffled
    )


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_a_curve_that_is_flat_seldom_has_a_cliff(share):
    rng, false = np.random.default_rng(5), 0
    for _ in range(200):
        rows = [
            Row(value, bool(rng.random() < share), scene)
            for value in (0.2, 0.4, 0.6, 0.8, 1.2)
            for scene in ("a", "b", "c")
            for _ in range(8)
        ]
        # The intervals play no part here, and take the time.
        false += bool(_cliffs(rows))
    assert false <= 0.05 * 200 + 2.0 * (0.05 * 0.95 * 200) ** 0.5


def _cliffs(rows, monkey=pytest.MonkeyPatch):
    from nw_gate import sweep
    from nw_gate.stats.interval import Estimate, Interval

    quick = Estimate(mean=0.5, interval=Interval(0.0, 1.0), n=1, confidence=0.95)
    with monkey.context() as patch:
        patch.setattr(sweep, "mean_of_scenes", lambda *_: quick)
        return curve_of(axis_named("friction"), "p", rows).cliffs


def test_scores_are_shown_by_value_beside_success(tmp_path):
    rows = rows_of({0.5: 1.0, 1.0: 1.0}, n=4)
    for row in rows:
        row.outcome = "completed"
        by_scene = {"a": 100.0, "b": 200.0}[row.scene]
        value = dict(row.perturbation)["friction"]
        row.scores = (("mean_power", by_scene / value),)
    rows[0].outcome = "policy_failed"
    curve = curve_of(axis_named("friction"), "p", rows, specs=specs_of(["mean_power"]))
    low, high = (point.scores["mean_power"] for point in curve.points)
    assert high == pytest.approx(150.0)
    assert low == pytest.approx(((3 * 200.0 + 1000.0) / 4 + 400.0) / 2)
    table = sweep_table([curve])
    assert table.columns[-1] == "mean_power"
    assert table.rows[1][-1] == "150"
    write_sweep([[curve]], "s", tmp_path)
    assert pq.read_table(tmp_path / "sweep.parquet")["scores"][1].as_py() == [("mean_power", 150.0)]
