"""docs/results.md names every way to end and every column, and says the limits that hold."""

import re
from pathlib import Path

import pytest

from nw_eval.results.columns import SCHEMA, about, columns_table
from nw_eval.results.row import MEASURED, OF_THE_PLAN, Row
from nw_eval.rollout.episode import HUGE
from nw_eval.rollout.mcap.topics import topics_table
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


def section(title):
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def test_the_columns_are_told_as_the_file_tells_them():
    assert columns_table() in section("Columns")
    assert [field.name for field in SCHEMA if len(about(field.name)) > 5] == list(SCHEMA.names)
    assert set(SCHEMA.names) == set(Row.__dataclass_fields__)
    measured = MEASURED - {name for name in SCHEMA.names if name.endswith("_s")}
    told = section("Columns").split("| column |")[0]
    assert set(re.findall(r"`(\w+)`", told)) >= measured | OF_THE_PLAN


def test_the_topics_are_told_as_the_code_tells_them():
    assert topics_table() in section("MCAP topics")


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
