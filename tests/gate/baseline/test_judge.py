from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from nw_eval.gate.baseline.judge import compare
from nw_eval.suite import Gate

if TYPE_CHECKING:
    from collections.abc import Callable

GATE = Gate(max_drop=0.1, scene_drop=0.1)

# The 16 scenes of the figures: means of sixty starts, all of them successes of 0.5 or 1 here.
MEANS = [.525, .9, .933, .933, .933, .95, .95, .95, .967, .967, 1, 1, 1, 1, 1, 1]  # fmt: skip


def test_an_unchanged_policy_passes_after_the_round_that_the_figures_say(
    make_run: Callable[..., Any], make_bank: Callable[..., Any], drawn_rows: Callable[..., Any]
) -> None:
    # Bank and candidate all 1 in one scene, M = 60: E_pass reaches 20 within 37 trials, and a
    # finite panel leaves less: by hand with the shipped process.
    run = make_run(["a"], 40, drawn_from=60)
    bank = make_bank(run, {"a": [1.0] * 60})
    rows = drawn_rows(run, {"a": [1.0] * 40})
    found = compare(rows, run, bank, GATE)
    assert found.word == "PASS"
    print(found)
