"""The simulated searches and gates: what they promise, and the code that they speak of."""

from dataclasses import replace
from math import sqrt

import pytest
from limit_cells import (
    FALLING,
    GATES,
    GateCell,
    LadderCell,
    cells,
    gate_cells,
    recorded_cells,
    recorded_gate_cells,
    simulate,
    simulate_gate,
)

EVERY, JUDGED = dict(recorded_cells()), dict(recorded_gate_cells())
ASKED = {
    ("hurdles", 2): 42,
    ("gaps", 2): 24,
    ("stairs", 2): 23,
    ("hurdles", 3): 26,
    ("gaps", 3): 19,
    ("stairs", 3): 20,
    ("logistic at 4.3", 4): 40,
    ("logistic at 7.5", 4): 40,
    ("all", 2): 10,
    ("none", 2): 10,
}
"""The most trials on average, by shape and width."""


def most(share, count):
    """Return what may be found of this share, in %: three and a half standard errors more."""
    return 100 * (share + 3.5 * sqrt(share * (1 - share) / count))


def test_the_tables_have_every_cell_once():
    assert list(EVERY) == list(cells())
    assert list(JUDGED) == list(gate_cells())


@pytest.mark.parametrize(("shape", "width"), ASKED)
def test_a_search_takes_as_few_trials_as_asked(shape, width):
    assert EVERY[LadderCell(shape=shape, width=width)].trials <= ASKED[shape, width]


def test_a_bound_is_false_as_seldom_as_promised_on_every_curve():
    assert len({cell.shape for cell in EVERY}) >= 10
    for cell, found in EVERY.items():
        assert found.false_lower <= most(0.05, cell.ladders), cell
        assert found.false_upper <= most(0.05, cell.ladders), cell


def test_a_curve_that_falls_is_called_uneven_as_seldom_as_promised_and_a_dip_is_found():
    for cell, found in EVERY.items():
        if cell.shape in FALLING:
            assert found.dip_said <= most(0.05, cell.ladders), cell
    assert EVERY[LadderCell(shape="dip", width=2, check=2)].dip_said >= 60


def test_an_equal_limit_is_rarely_regressed_and_passes_within_thirty_trials():
    equal = {cell: found for cell, found in JUDGED.items() if cell.question == "equal"}
    for cell, found in equal.items():
        assert found.regressed <= most(0.01, GATES), cell
        if cell.baseline in {"hurdles", "gaps", "stairs"}:
            assert found.trials <= 30, cell
            assert found.passed >= 95, cell


def test_a_limit_that_is_lower_by_more_than_max_drop_rarely_passes():
    for cell, found in JUDGED.items():
        if cell.question != "equal":
            assert found.passed <= most(0.05, GATES), cell


def test_a_policy_with_weak_motors_is_regressed_within_twenty_trials():
    for width in (2, 3):
        cell = GateCell(question="power", baseline="stairs", candidate="kp x 0.8", width=width)
        assert JUDGED[cell].trials <= 20
        assert JUDGED[cell].regressed >= 95


def test_the_code_does_what_the_table_says_of_some_searches():
    for cell in (LadderCell(shape="stairs", width=3), LadderCell(shape="hurdles", width=2)):
        found, recorded = simulate(cell, 300), EVERY[cell]
        # The 90th percentile is about as far above the mean as the trials scatter.
        error = (recorded.p90 - recorded.trials) / sqrt(300)
        assert found.trials == pytest.approx(recorded.trials, abs=4 * error)
        assert max(found.false_lower, found.false_upper) <= most(0.05, 300)


def test_the_code_does_what_the_table_says_of_a_gate():
    cell = GateCell(question="power", baseline="stairs", candidate="kp x 0.8")
    found = simulate_gate(cell, 20)
    assert found.regressed >= 90
    assert found.trials == pytest.approx(JUDGED[cell].trials, rel=0.4)


def test_a_policy_that_is_at_the_share_everywhere_has_false_bounds_that_are_seen():
    assert EVERY[LadderCell(shape="half", width=3)].false_upper > 0.5


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("cell", EVERY, ids=str)
def test_the_code_does_what_the_table_says_of_every_search(cell):
    found = simulate(cell)
    rounded = {name: float(f"{value:.2f}") for name, value in vars(found).items()}
    assert replace(found, **rounded) == EVERY[cell]


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("cell", JUDGED, ids=str)
def test_the_code_does_what_the_table_says_of_every_gate(cell):
    found = simulate_gate(cell)
    rounded = {name: float(f"{value:.2f}") for name, value in vars(found).items()}
    assert replace(found, **rounded) == JUDGED[cell]
