"""The page of limits of policies: its tables and its picture are those of the record."""

import re
from collections import Counter

import pytest
from record_limits_page import HEADS, PAGE, PICTURE, WIDTH, limits_of, page, picture, recorded

from nw_eval.api.climbing import MOST
from nw_gate.limits.find import LimitSearch
from nw_gate.limits.ladder import LimitTrial
from nw_policies import find_card, load_bundle

SHIPPED = ("go1-parkour", "go1-act-depth", "go1-act-rgb", "go1-act-rgb-ray", "stand")
TEXT = PAGE.read_text(encoding="utf-8")


def rows_below(head):
    lines = TEXT.split(head, 1)[1].splitlines()[2:]
    end = next(place for place, line in enumerate(lines) if not line.startswith("|"))
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines[:end]]


def test_tables_and_picture_are_what_the_record_says():
    assert page() == TEXT
    assert picture() == PICTURE.read_text(encoding="utf-8")
    assert PICTURE.stat().st_size < 200_000
    assert TEXT.index("(images/limits.svg)") < TEXT.index("\n## ")


@pytest.mark.parametrize("group", HEADS)
def test_every_cell_is_two_bounds_and_trials_that_the_record_has(group):
    ladders = HEADS[group].strip("| ").split(" | ")[1:]
    policies = {each["name"]: each for each in recorded() if each["group"] == group}
    rows = rows_below(HEADS[group])
    assert [row[0] for row in rows] == list(policies)
    for name, *cells in rows:
        limits = limits_of(policies[name])
        for ladder, cell in zip(ladders, cells, strict=True):
            if ladder not in limits:
                assert not cell
                continue
            limit = limits[ladder]
            told = re.fullmatch(r"(.+?)(\*?)(\??) \((\d+)\)", cell)
            assert int(told[4]) == len(limit.trials)
            assert (bool(told[2]), bool(told[3])) == (limit.width != WIDTH, not limit.decided)
            ends = {bound.value for bound in (limit.lower, limit.upper) if bound is not None}
            assert {float(number) for number in re.findall(r"\d+(?:\.\d+)?", told[1])} == ends


@pytest.mark.parametrize("group", HEADS)
def test_searches_of_this_version_ask_for_the_trials_that_were_recorded(group):
    for policy in recorded():
        for ladder, limit in limits_of(policy).items() if policy["group"] == group else ():
            results: dict[LimitTrial, bool] = {}
            tried = Counter[int]()
            for rung, completed in limit.trials:
                results[LimitTrial(rung, tried[rung])] = completed
                tried[rung] += 1
            asked = {"share": limit.share, "confidence": limit.confidence, "width": limit.width}
            search = LimitSearch(limit.ladder, **asked, most=MOST)
            assert search.follow(results), f"{policy['name']}, {ladder}: another trial is needed"
            assert search.limit.trials == limit.trials, f"{policy['name']}, {ladder}"


def test_shipped_policies_are_those_of_this_version():
    found = {each["name"]: each for each in recorded() if each["group"] == "shipped"}
    assert set(found) == set(SHIPPED)
    for name, each in found.items():
        assert each["checkpoint"] == load_bundle(find_card(name)).checkpoint_digest


def test_every_public_checkpoint_can_be_had_again():
    sources = {line.strip("| ").split(" | ")[0]: line for line in TEXT.splitlines() if "|" in line}
    for each in recorded():
        if each["group"] in {"public", "contacts"} and each["name"] not in SHIPPED:
            assert re.search(r"\| [0-9a-f]{7} \| `[\w/.-]+` \| ", sources[each["name"]])
