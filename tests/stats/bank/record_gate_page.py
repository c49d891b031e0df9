"""The tables and the picture of docs/gate.md that are simulated.

`python tests/stats/bank/record_gate_page.py` writes them anew; tests hold them against the code.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from error_rates import error_rates
from measured import SEEN

from nw_eval.reporting.curve_picture import draw_curve
from nw_eval.stats.bank import CurvePoint, GateRules, Margins, operating_curve

PAGE = Path(__file__).parents[3] / "docs" / "gate.md"
PICTURE = PAGE.parent / "images" / "gate_curve.png"
ERRORS = "| exactly at the margin | starts | wrong PASS | wrong REGRESSED |"
CURVE = "| true drop | `tolerate: 0.0`, 5 % | `tolerate: 0.02`, 5 % | `tolerate: 0.02`, 1 % |"
DROPS = (0.0, 0.02, 0.05, 0.10, 0.20)

RULES = GateRules(tiers=("supporting",) * len(SEEN))
"""The defaults: a wrong PASS 5 %, a wrong REGRESSED 1 % at most."""
COLUMNS = (
    replace(RULES, margins=Margins(tolerate=0.0), alpha_regr=0.05),
    replace(RULES, alpha_regr=0.05),
    RULES,
)


def error_table() -> str:
    """Return the lines of the table of errors at the margins."""
    return "".join(
        f"| {name} | {starts} | {100 * passed:.1f} % | {100 * regressed:.1f} % |\n"
        for name, starts, passed, regressed in error_rates()
    )


def curve_table() -> str:
    """Return the lines of the operating curve of the hurdles suite."""
    columns = [operating_curve(SEEN, rules, starts=60, drops=DROPS) for rules in COLUMNS]
    return "".join(
        f"| {points[0].drop:.2f} | {' | '.join(_cell(point) for point in points)} |\n"
        for points in zip(*columns, strict=True)
    )


def recorded(heading: str) -> list[list[str]]:
    """Return the cells of the table of the page that has this heading."""
    lines = PAGE.read_text(encoding="utf-8").partition(heading)[2].strip().partition("\n\n")[0]
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines.splitlines()[1:]
    ]


def _cell(point: CurvePoint) -> str:
    shares = (point.regressed, point.passed, point.undecided)
    return f"{'/'.join(f'{100 * share:.0f}' for share in shares)}, {len(SEEN) * point.rounds:.0f}"


def _with_table(page: str, heading: str, lines: str) -> str:
    whole = re.compile(re.escape(heading) + r"\n(\|[-|]+\|\n)(?:\|.*\n)*")
    return whole.sub(lambda found: f"{heading}\n{found[1]}{lines}", page)


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    text = _with_table(text, CURVE, curve_table())
    PAGE.write_text(_with_table(text, ERRORS, error_table()), encoding="utf-8")
    draw_curve(
        operating_curve(SEEN, RULES, starts=60, drops=[n / 100 for n in range(31)]),
        PICTURE,
        margins=RULES.margins,
        scenes=len(SEEN),
        title="hurdles, success 0.938: at most 20 rounds of 16 trials",
    )
