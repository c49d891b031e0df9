"""The tables and the picture of docs/concepts/power.md that are simulated.

`python tests/gate/stats/baseline/record_gate_page.py` writes them anew; tests hold them against the
code.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from math import log
from pathlib import Path

import numpy as np
from gate_cells import (
    ALL,
    BASELINES,
    HURDLES,
    KINDS,
    STUDENTS,
    Cell,
    Found,
    baseline_of,
    recorded_cells,
)

from nw_eval.reporting.pictures import draw_curve
from nw_eval.suite.load import load_suite
from nw_gate.baseline.power_forecast import Outset, outset_of_baseline
from nw_gate.results.baseline_file import read_baseline
from nw_gate.stats.baseline.baseline_bets import _solve
from nw_gate.stats.baseline.curve import CurvePoint, chances_of, draw, operating_curve
from nw_gate.stats.baseline.trials import TrialRules, settle_all
from nw_gate.stats.power import ends

ROOT = Path(__file__).parents[4]
PAGE = ROOT / "docs" / "concepts" / "power.md"
PICTURE = ROOT / "docs" / "images" / "gate_curve.png"
CURVE = "| true drop | hurdles-state/go1-parkour | all-state/go1-parkour | hurdles/go1-act-rgb |"
ERRORS = (
    "| policy | wrong is | at most | panel | fresh, M = 5 to 12 | fresh, M = 30 to 400 | control |"
)
_COLUMNS = [f"{suite}, {drop}" for suite in ("hurdles", "all", "gaps") for drop in ("0.05", "0.10")]
BOUND = (
    "| true drop | hurdles-state/go1-parkour | all-state/go1-parkour | gaps-state/go1-act-depth |"
)
POWER = f"| what gets worse | {' | '.join(_COLUMNS)} |"
DROPS = (0.0, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2)
POLICIES = (
    # The question of the cells, in words, what is wrong, and what is promised.
    ("equal", "equally good", "REGRESSED, or a scene named", "blamed", 1),
    ("drift", "equally good, on a machine where both are 0.05 worse", "the same", "blamed", 1),
    ("at tolerate", "worse by `tolerate`", "REGRESSED", "regressed", 1),
    ("at scene_drop", "no scene worse by more than `scene_drop`", "a scene named", "named", 1),
    ("at max_drop", "worse by `max_drop`", "PASS", "passed", 5),
)
NAMES = {
    "harder": "every waypoint, other initial states than the baseline's",
    "harder, same starts": "every waypoint, the same initial states",
    "some scenes": "some trials of a quarter of the scenes get nowhere",
    "all or nothing": "trials reach all waypoints or none",
}


@cache
def outset(name: str) -> Outset:
    """Return the outset of a shipped suite's gate against one of its committed baselines."""
    gate = load_suite(ROOT / "suites" / f"{name.partition('/')[0]}.yaml").gate
    return outset_of_baseline(read_baseline(BASELINES / f"{name}.parquet").panels[0], gate)


@cache
def curve(name: str) -> tuple[CurvePoint, ...]:
    """Return the operating curve of `outset`."""
    found = outset(name)
    return tuple(operating_curve(found.seen, found.rules, budget=found.budget, drops=DROPS))


def curve_table() -> str:
    """Return the lines of the operating curves."""
    columns = map(curve, CURVE.strip("| ").split(" | ")[1:])
    return _lines(
        [
            f"{points[0].drop:.2f}",
            *(
                _shares(
                    100 * point.passed,
                    100 * point.regressed,
                    100 * point.undecided,
                    point.trials,
                )
                for point in points
            ),
        ]
        for points in zip(*columns, strict=True)
    )


def bound_table() -> str:
    """Return the lines of trials with fixed bets, with bets from the baseline, and of the bound."""
    names = BOUND.strip("| ").split(" | ")[1:]
    return _lines(
        [f"{drop:.2f}", *(" / ".join(f"{x:.0f}" for x in trials_at(n, drop)) for n in names)]
        for drop in (0.0, 0.1, 0.2)
    )


@cache
def trials_at(name: str, drop: float) -> tuple[float, float, float]:
    """Return mean trials with fixed bets, with bets from the baseline, and the fewest possible.

    The bound is Wald's, with the information of the least favourable null (KL_inf), for a rule that
    holds its error against every policy with the null's mean and decides rightly in 99 %.
    """
    start = outset(name)
    margins = start.rules.margins
    rules = TrialRules(tiers=("supporting",) * start.scenes)
    chances = chances_of(start.seen, start.baseline - drop)
    given = {"seen": start.seen, "starts": None, "budget": start.budget, "repetitions": 1000}
    trials = list[float]()
    for bets in (None, margins):
        drawn = draw(**given, margins=bets)
        decisions = settle_all(drawn.reference, drawn.trials(chances), rules)
        trials.append(float(np.mean([decision.trials for decision in decisions])))
    k = np.array([len(course.counts) - 1 for course in start.seen])
    results = np.zeros((start.scenes, k.max() + 1))
    for scene, (chance, most) in enumerate(zip(chances, k, strict=True)):
        results[scene, : most + 1] = ends(chance, most)
    values = np.minimum(np.arange(k.max() + 1) / k[:, None], 1.0)
    passes = drop < margins.max_drop / 2
    null = start.baseline - (margins.max_drop if passes else margins.tolerate)
    y, mean = (values, null) if passes else (1.0 - values, 1.0 - null)
    whole = np.ones((start.scenes, 1))
    fixed, slope = _solve(results.T[..., None], y, whole, np.array(mean))
    growth = (results * np.log(fixed + slope * y)).sum(axis=1).mean()
    alpha = start.rules.alpha_pass if passes else start.rules.alpha_regr
    information = 0.99 * log(0.99 / alpha) + 0.01 * log(0.01 / (1.0 - alpha))
    return trials[0], trials[1], information / float(growth)


def error_table() -> str:
    """Return the lines of the table of errors: the most that was found in any cell, in %."""
    return _lines(
        [
            policy,
            wrong,
            f"{promised} %",
            _most(question, "panel", what),
            _most(question, "fresh", what, range(13)),
            _most(question, "fresh", what, range(13, 401)),
            _most(question, "control", what),
        ]
        for question, policy, wrong, what, promised in POLICIES
    )


def power_table() -> str:
    """Return the lines of the table of kinds of drops, of claims about fresh starts."""
    found = {
        (cell.kind, cell.baseline, cell.drop): result
        for cell, result in recorded_cells()
        if cell.question == "power" and cell.claim == "fresh" and cell.alpha_regr == 0.01
    }
    columns = [(baseline, drop) for baseline in (HURDLES, ALL, STUDENTS) for drop in (0.05, 0.1)]
    return _lines(
        [NAMES[kind], *(_of_cell(found[kind, *column]) for column in columns)] for kind in KINDS
    )


def recorded(heading: str) -> list[list[str]]:
    """Return the cells of the table of the page that has this heading."""
    lines = PAGE.read_text(encoding="utf-8").partition(heading)[2].strip().partition("\n\n")[0]
    return cells_of(lines.split("\n", 1)[1])


def cells_of(lines: str) -> list[list[str]]:
    """Return the cells of the lines of a table."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines.splitlines()]


def _most(question: str, claim: str, what: str, starts: range = range(401)) -> str:
    found = [
        getattr(result, what)
        for cell, result in _asked(question)
        if cell.claim == claim and cell.starts in starts
    ]
    return f"{max(found):.1f} %" if found else "-"


def _asked(question: str) -> Iterator[tuple[Cell, Found]]:
    for cell, result in recorded_cells():
        if question == "drift":
            if cell.drift > 0:
                yield cell, result
        elif cell.question == question and not cell.drift:
            yield cell, result


def _of_cell(found: Found) -> str:
    left = max(0.0, 100 - found.passed - found.regressed)
    return _shares(found.passed, found.regressed, left, found.trials)


def _shares(*values: float) -> str:
    *shares, trials = values
    return f"{' / '.join(f'{share:.0f}' for share in shares)}, {trials:.0f}"


def _lines(rows: Iterable[list[str]]) -> str:
    return "".join(f"| {' | '.join(cells)} |\n" for cells in rows)


def _with_table(page: str, heading: str, lines: str) -> str:
    whole = re.compile(re.escape(heading) + r"\n(\|[-|]+\|\n)(?:\|.*\n)*")
    return whole.sub(lambda found: f"{heading}\n{found[1]}{lines}", page)


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    for heading, lines in (
        (CURVE, curve_table()),
        (BOUND, bound_table()),
        (ERRORS, error_table()),
        (POWER, power_table()),
    ):
        text = _with_table(text, heading, lines)
    PAGE.write_text(text, encoding="utf-8")
    whole = outset(baseline_of(HURDLES))
    draw_curve(
        whole.curve(),
        PICTURE,
        margins=whole.rules.margins,
        title=f"{baseline_of(HURDLES)}, success {whole.baseline:.3f}: {whole.in_words}",
    )
