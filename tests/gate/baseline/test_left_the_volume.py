"""Against a bank, a trial that left the captured volume is a start of which nothing is known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.gate.baseline.combine import judge_run
from nw_eval.gate.baseline.judge import compare
from nw_eval.results.bank.against import Against
from nw_eval.results.provenance import BaselineInfo
from nw_eval.suite import Gate
from nw_eval.suite.model import Validity

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from nw_eval.results.row import Row

    Make = Callable[..., Any]

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
def meet(make_run: Make, make_bank: Make, drawn_rows: Make) -> Make:
    """A candidate's rows in two scenes, by the successes of its rounds, beside a perfect bank."""

    def make(a: Sequence[float | None], b: Sequence[float | None]) -> Any:
        run = make_run(["a", "b"], 20, drawn_from=60)
        bank = make_bank(run, {"a": [1.0] * 60, "b": [1.0] * 60})
        return drawn_rows(run, {"a": a, "b": b}), run, bank

    return make


@pytest.mark.parametrize("success", [1.0, 0.0])
def test_it_counts_as_a_trial_without_result_does_whatever_it_scored(
    meet: Make, success: float
) -> None:
    crashed, run, bank = meet([1.0, None, *[1.0] * 8], [1.0] * 10)
    known, _, _ = meet([1.0, success, *[1.0] * 8], [1.0] * 10)
    lost, left = (
        compare(rows, run, bank, gate) for rows, gate in ((crashed, BARE), (gone(known, [1]), GATE))
    )
    assert (left.word, left.rounds, left.interval) == (lost.word, lost.rounds, lost.interval)
    assert left.drop == lost.drop == 0.0
    assert [item.evidence for item in left.scenes] == [item.evidence for item in lost.scenes]
    assert [item.trials for item in left.scenes] == [item.trials for item in lost.scenes]
    assert [item.ends for item in left.scenes] == [item.ends for item in lost.scenes]


def test_no_candidate_passes_or_falls_by_what_left(meet: Make) -> None:
    rows, run, bank = meet([1.0] * 20, [1.0] * 20)
    assert compare(rows, run, bank, GATE).word == "PASS"
    assert compare(gone(rows, range(0, 40, 6)), run, bank, GATE).word == "INCONCLUSIVE"
    worse, _, _ = meet([0.0] * 3 + [1.0] * 17, [0.0] * 3 + [1.0] * 17)
    assert compare(worse, run, bank, GATE).word == "REGRESSED"
    fog = [*range(3), *range(20, 23)]
    assert compare(gone(worse, fog), run, bank, GATE).word == "INCONCLUSIVE"


def test_over_the_cap_not_even_a_policy_that_always_falls_is_convicted(meet: Make) -> None:
    rows, run, bank = meet([0.0] * 20, [0.0] * 20)
    assert compare(rows, run, bank, GATE).word == "REGRESSED"
    far = gone(rows, range(9))
    found = compare(far, run, bank, GATE)
    assert found.word == "INCONCLUSIVE"
    assert found.reasons[0].startswith("9 of 40 trials left the captured volume, over")
    against = Against(info=_info(bank), bank=bank, content=b"")
    verdict = judge_run(far, run, GATE, against)
    assert (verdict.verdict, verdict.exit_code) == ("INCONCLUSIVE", 3)
    assert sum("over gate.validity.at_most" in reason for reason in verdict.reasons) == 1


def test_without_the_key_the_bank_is_met_as_ever(meet: Make) -> None:
    rows, run, bank = meet([1.0, 0.5] * 10, [1.0] * 20)
    assert compare(gone(rows, range(15)), run, bank, BARE) == compare(rows, run, bank, BARE)


def _info(bank: Any) -> BaselineInfo:
    return BaselineInfo(name=bank.manifest.name, path="shipped.parquet", sha256="ab" * 32)
