"""docs/results.md names every way to end and every column, and says the limits that hold."""

from pathlib import Path

import pytest

from nw_eval.results.row import Row
from nw_eval.rollout.episode import HUGE
from nw_eval.sim import Limits
from nw_eval.words import FAULTS, OUTCOMES, POLICY_FAULTS

PAGE = (Path(__file__).parents[2] / "docs" / "results.md").read_text(encoding="utf-8")


def first_cells(title):
    section = PAGE.split(f"\n## {title}")[1].split("\n## ")[0]
    rows = [line.split(" | ")[0] for line in section.splitlines() if line.startswith("| `")]
    return [word for cell in rows[1:] for word in cell.removeprefix("| ").split(", ")]


@pytest.mark.parametrize(
    ("title", "names"),
    [
        ("Outcomes", OUTCOMES),
        ("When the policy itself fails", POLICY_FAULTS),
        ("Errors", FAULTS),
    ],
)
def test_every_way_to_end_has_its_line_and_no_other(title, names):
    assert sorted(first_cells(title)) == sorted(f"`{name}`" for name in names)


def test_every_column_is_told_once():
    section = PAGE.split("\n## Columns of a row")[1]
    told = [
        word.strip("` ")
        for line in section.splitlines()
        if line.startswith("| `")
        for word in line.split(" | ")[0].removeprefix("| ").split(",")
    ]
    assert sorted(told) == sorted(Row.__dataclass_fields__)


def test_its_limits_are_those_of_the_code():
    limits = Limits()
    for said in (
        f"over {limits.tilt:g} rad",
        f"more than {limits.monitored_force:g} N",
        f"{limits.stuck_after:g} s without getting {limits.stuck_distance:g} m",
        f"{limits.off_course_distance:g} m from the trail, or {limits.below_ground:g} m under",
    ):
        assert said in PAGE
    assert HUGE == 1e6, "the page says a million"
