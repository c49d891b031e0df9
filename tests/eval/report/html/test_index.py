"""The page over many runs: a line for each policy, named as people know it, with where it is of."""

import re
from importlib.resources import files
from itertools import pairwise
from types import SimpleNamespace

import pytest

from nw_eval.reporting.html.environment import _environment
from nw_eval.reporting.html.runs import LEFT, MOST, RIGHT, ListedRun, Result, chart, render_index
from nw_eval.suite import Gate
from nw_gate.absolute import judge
from nw_gate.results.provenance import PolicyInfo
from nw_gate.stats.interval import Interval

COMMIT = "0a1b2c3d4e5f60718293a4b5c6d7e8f901234567"
CI = {
    "repository": "acme/dogs",
    "commit": COMMIT,
    "job_url": "https://github.com/acme/dogs/actions/runs/123",
}


@pytest.fixture
def listed(make_run, make_row):
    def make(name, policy, reached, day, **labels):
        verdict = judge([make_row("a", k, reached) for k in range(20)], Gate(), {"a": 20})
        info = make_run(
            {"a": 20}, id=name, started=f"2026-11-{day}T11:00:05Z", labels=labels,
            policy=PolicyInfo(name=policy, checkpoint_digest="ab" * 32),
        )  # fmt: skip
        return ListedRun(folder=name, href=f"{name}.html", info=info, verdict=verdict)

    return make


def test_a_training_is_a_line_over_its_steps_and_other_policies_are_lines_over_dates(listed, read):
    runs = [
        listed("b", "walker", 4, 20, training_run="seed-1", step="1000"),
        listed("a", "walker", 1, 21, training_run="seed-1", step="500"),
        listed("x", "stand", 2, 22),
        listed("y", "stand", 0, 23),
        listed("z", "trot", 4, 23),
    ]
    page = read(render_index(runs, []))
    steps, dates = page.one("section", id="trends").all("svg")
    lines = [[group.one("text").text for group in drawn.all("g")] for drawn in (steps, dates)]
    assert lines == [["walker (seed-1)"], ["trot", "stand"]]
    assert [title.text for title in steps.all("title")] == [
        "walker (seed-1), step 500: success 0.250",
        "walker (seed-1), step 1000: success 1.000",
    ]
    # Two policies are two trends, and a column is named by policy and run.
    _, trends = page.all("table")
    assert [cell for cell in trends.cells[0] if cell] == [
        "scene",
        "trot z",
        *("stand last change", "stand x", "stand y"),
        *("walker (seed-1) last change", "walker (seed-1) step 500", "walker (seed-1) step 1000"),
    ]
    together = [cell for cell in trends.cells[1] if cell]
    assert together == [
        "all scenes",
        "1.000",
        "-0.500",
        "0.500",
        "0.000",
        "+0.750",
        "0.250",
        "1.000",
    ]


def test_a_run_leads_to_its_commit_and_its_job(listed, read):
    page = read(render_index([listed("x", "stand", 2, 22, **CI), listed("y", "stand", 2, 23)], []))
    links = [each for each in page.one("section", id="runs").all("a") if "rel" in each.attributes]
    assert [each.attributes["href"] for each in links] == [
        f"https://github.com/acme/dogs/commit/{COMMIT}",
        CI["job_url"],
    ]
    assert {each.attributes["rel"] for each in links} == {"noopener noreferrer nofollow"}
    table = page.one("section", id="runs").one("table")
    assert table.cells[0][-2:] == ["commit", "job"]
    bare = read(render_index([listed("y", "stand", 2, 23)], []))
    assert "commit" not in bare.one("section", id="runs").one("table").cells[0]


def test_the_server_of_a_job_is_named_where_readers_may_not_expect_it(listed):
    own = {"repository": "acme/dogs", "job_url": "https://ci.acme.dev/acme/dogs/-/jobs/7"}
    assert listed("x", "stand", 2, 22, **own).links["job"].host == "ci.acme.dev"
    assert listed("x", "stand", 2, 22, **CI).links["job"].host == ""
    assert listed("x", "stand", 2, 22, job="gate").links["job"].href == ""
    assert listed("x", "stand", 2, 22, pull_request="javascript:x").links["pull_request"].href == ""


def test_a_folder_s_name_that_nobody_chose_is_the_time_of_its_run(listed):
    given = listed("hurdles-stand-20261122T110005Z-1a2b3c4d", "stand", 2, 22)
    assert (given.name, listed("mine", "stand", 2, 22).name) == ("2026-11-22 11:00", "mine")


@pytest.mark.parametrize("started", ["never", "0001-01-01T00:00:00+23:59", "9999-12-31", ""])
def test_a_run_of_no_time_is_in_the_table_only(make_run, make_row, read, started):
    verdict = judge([make_row("a", 0, 4)], Gate(), {"a": 1})
    run = ListedRun(
        folder="x", href=None, info=make_run({"a": 1}, started=started), verdict=verdict
    )
    page = read(render_index([run], []))
    assert not page.all("svg", role="img")
    assert started in page.one("section", id="runs").text


def test_names_of_lines_that_end_together_stand_below_each_other():
    results = [
        (f"policy {k}", [Result(at=1.0, success=0.5, interval=Interval(0.2, 0.8), name="x")])
        for k in range(MOST + 3)
    ]
    drawn = chart("training step", results)
    assert drawn is not None
    assert (len(drawn.lines), drawn.left_out) == (MOST, 3)
    heights = sorted(line.name_y for line in drawn.lines)
    assert min(b - a for a, b in pairwise(heights)) >= 15.0
    assert heights[0] > 0.0
    assert heights[-1] < 250.0


def test_a_dashed_line_has_its_colour_and_its_dashes():
    """A class that ran into the one before was neither."""
    source = files("nw_eval.reporting").joinpath("templates/index.html.j2").read_text("utf-8")
    (opening,) = re.findall(r"<g class=.*>", source)
    line = SimpleNamespace(style=1, dashed=True)
    found = _environment().from_string(opening).render(line=line)
    assert found == '<g class="l1 dashed">'


@pytest.mark.parametrize("span", [0.0, 0.4, 7, 50, 170, 2000, 9000, 40_000, 3e5, 4e6, 9e7, 1e9])
def test_ticks_of_dates_are_within_the_axis_and_no_two_are_alike(span):
    """Of a run every minute each tick says another minute."""
    first = 1_764_234_567.25
    runs = [
        Result(at=at, success=1.0, interval=Interval(0.9, 1.0), name="x")
        for at in (first, first + span)
    ]
    drawn = chart("date", [("a", runs)])
    assert drawn is not None
    texts = [text for _, text in drawn.ticks]
    assert 1 <= len(texts) == len(set(texts)) <= 6
    assert len(texts) > 1 or span < 1.0
    assert all(LEFT <= x <= RIGHT for x, _ in drawn.ticks)


def test_ticks_are_round_steps_within_the_axis():
    found = [
        Result(at=at, success=1.0, interval=Interval(0.9, 1.0), name="x") for at in (130.0, 4870.0)
    ]
    drawn = chart("training step", [("a", found)])
    assert drawn is not None
    assert [text for _, text in drawn.ticks] == ["1000", "2000", "3000", "4000"]
    assert all(re.fullmatch(r"[0-9.]+", str(x)) for x, _ in drawn.ticks)
