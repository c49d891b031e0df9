"""What report.html shows of a comparison with a baseline."""

from dataclasses import replace

import pytest


@pytest.fixture
def page(make_page, make_row, read, compared):
    rows = [make_row("hurdles/low", index, 4) for index in range(5)]
    rows += [make_row("hurdles/high", index, 1 if index < 4 else 4) for index in range(5)]
    return read(make_page(rows, against=compared))


def test_the_effect_against_the_baseline_comes_before_all_else(page):
    assert page.one("h1").text.startswith("REGRESSED by the baseline comparison")
    facts = [each.text for each in page.one("ul", class_="facts").all("li")]
    assert any(
        fact.endswith("drop 0.200 (max_drop 0.1) in the 10 trials compared") for fact in facts
    )
    # The gauge has the interval, and says in its header how sure its ends are.
    words = page.one("section", id="numbers").text
    assert [words.count(end) for end in ("0.120", "0.410")] == [1, 1]
    assert page.all("figcaption")[0].text == "Drop against shipped (99 % lower, 95 % upper): 0.200"
    drop = page.all("figure", class_="gauge")[0].one("svg")
    assert drop.attributes["aria-label"] == (
        "Mean success fell by 0.200: by at least 0.120 (99 %) and at most 0.410 (95 %)."
        " Up to 0.02 is tolerated; 0.1 must not pass."
    )
    assert [each.text for each in drop.all("text")[:2]] == ["tolerated 0.02", "max_drop 0.1"]
    # What is tolerated lies left of what must not pass, and the estimate in that.
    good, left_open, bad = (float(each.attributes["x"]) for each in drop.all("rect"))
    assert good < left_open < bad < float(drop.one("circle").attributes["cx"])


def test_scenes_are_shown_beside_the_baseline_what_fell_first(page):
    table = page.one("section", id="scenes").all("table")[0]
    header, high, low = table.cells
    assert [name for name in header if name][-9:] == [
        "tier", "trials", "success", "95 % two-sided", "completed", "baseline", "change",
        "regressed", "worse from",
    ]  # fmt: skip
    assert high[0] == "hurdles/high"
    assert high[-8:-6] == ["5", "0.450"]
    assert high[-5:] == ["1 of 5", "0.950", "-0.500", "yes", "waypoint 2"]
    assert low[-3:] == ["+0.100", "", ""]
    lost, won = (each.all("path")[1] for each in table.one("tbody").all("svg"))
    assert (lost.attributes["class"], won.attributes["class"]) == ("lost", "won")


def test_the_course_shows_whom_each_waypoint_stopped_and_where_they_part(page):
    section = page.one("section", id="course")
    together = section.all("table")[0].cells
    # Of 40 starts of the baseline 38 reached the first waypoint, and 37 the second as well.
    assert together[1][4:6] == ["95 %", "2 of 40"]
    assert together[2][1:3] == ["70 %", "3 of 10"]
    assert together[2][4:6] == ["92 %", "1 of 38"]
    high, low = section.one("table", class_="heat").cells[1:]
    assert high[:3] == ["hurdles/high", "0 of 5baseline 0 %", "3 of 5 worsebaseline 5 %"]
    assert low[0] == "hurdles/low"
    assert "the baseline all initial states of the baseline." in section.text
    assert "Baseline: 95 %, 92 %" in section.one("figure").one("svg").attributes["aria-label"]


def test_beside_a_control_the_course_is_of_its_trials(make_page, make_row, read, compared):
    rows = [make_row("hurdles/low", index, 4) for index in range(5)]
    page = read(make_page(rows, against=replace(compared, basis="control")))
    words = page.one("section", id="course").text
    assert "the baseline those of its policy that ran beside the candidate." in words
