"""What the baseline's own trials show of its bank on another class of machine."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.errors import StoreError
from nw_eval.gate.baseline.holding.sentinel import watch
from nw_eval.results.bank import trajectory
from nw_eval.suite import Gate

if TYPE_CHECKING:
    from collections.abc import Callable

    from nw_eval.results.provenance import RunInfo
    from nw_eval.results.row import Row

    Make = Callable[..., Any]

SCENES = ("a", "b", "c", "d")
MIXED = [1.0, 1.0, 0.75, 1.0, 0.5, 1.0] * 10


@pytest.fixture
def own(make_run: Make) -> RunInfo:
    """The baseline's own run elsewhere."""
    return make_run(SCENES, 20, drawn_from=60)


@pytest.fixture
def bank(own: RunInfo, make_bank: Make) -> Any:
    return make_bank(own, dict.fromkeys(SCENES, MIXED))


@pytest.fixture
def elsewhere(own: RunInfo, bank: Any, drawn_rows: Make) -> Callable[..., list[Row]]:
    """Rows of the baseline there: as many rounds as scores; `bits` where they go the bank's way."""

    def make(rounds: int, change: Callable[[str, float], float] = lambda _, b: b) -> list[Row]:
        known = bank.panels[0].by_stratum
        blank = drawn_rows(own, dict.fromkeys(SCENES, [1.0] * rounds))
        rows = []
        for row in blank:
            score = change(row.scene, known[row.scene, ()][row.seed_index].success)
            rows.append(
                replace(
                    row,
                    arm="baseline",
                    success=score,
                    completed=score == 1.0,
                    outcome="completed" if score == 1.0 else "fell",
                    waypoints_reached=round(4 * score),
                )
            )
        return rows

    return make


def test_equal_bits_in_every_scene_make_the_panel_known(
    own: RunInfo, bank: Any, elsewhere: Make
) -> None:
    rows = elsewhere(1)
    ways = {(row.scene, row.seed_index): trajectory(row) for row in rows}
    starts = tuple(
        replace(start, trajectory=ways.get((start.scene, start.seed_index), "0" * 16))
        for start in bank.panels[0].starts
    )
    known = replace(bank, panels=(replace(bank.panels[0], starts=starts),))
    assert watch(rows, own, known, Gate()).checked == "bits"
    other = replace(rows[2], state_digest="ab" * 32)
    assert watch([*rows[:2], other, *rows[3:]], own, known, Gate()).checked is None
    assert watch([], own, known, Gate()).checked is None
    assert "no round" in watch([], own, known, Gate()).open[0]


def test_other_bits_with_scores_in_line_make_a_sample_of_it(
    own: RunInfo, bank: Any, elsewhere: Make
) -> None:
    first = watch(elsewhere(1), own, bank, Gate())
    assert (first.checked, first.moved) == (None, ())
    assert "is open" in first.open[0]
    seen = watch(elsewhere(20), own, bank, Gate())
    assert (seen.checked, seen.moved, seen.open) == ("scores", (), ())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda _, b: b / 2, "it scores worse here"),
        (lambda scene, b: 0.0 if scene == "c" else b, "beyond doubt in c (0.00, the bank's 0.88)"),
    ],
)
def test_scores_that_fell_are_no_verdict_on_anybody(
    own: RunInfo, bank: Any, elsewhere: Make, change: Any, words: str
) -> None:
    seen = watch(elsewhere(20, change), own, bank, Gate())
    assert seen.checked is None
    assert words in seen.moved[0]
    assert "the bank's own policy go1-act-rgb goes other ways" in seen.moved[0]
    assert "nw-eval baseline save" in seen.moved[1]


def test_scores_that_rose_are_out_of_line_too(
    own: RunInfo, make_bank: Make, elsewhere: Make
) -> None:
    low = make_bank(own, dict.fromkeys(SCENES, [0.5, 0.25] * 30))
    seen = watch(elsewhere(20, lambda *_: 1.0), own, low, Gate())
    assert seen.checked is None
    assert "it scores better here" in seen.moved[0]


def test_rows_of_a_candidate_say_nothing_of_the_baseline(
    own: RunInfo, bank: Any, elsewhere: Make
) -> None:
    rows = [replace(row, arm="candidate") for row in elsewhere(1)]
    with pytest.raises(StoreError, match="it is the candidate's"):
        watch(rows, own, bank, Gate())
