"""What stands in report.html, read by a parser of HTML."""

import os
import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from nw_eval.reporting.html.environment import _coded
from nw_eval.reporting.html.evidence import Clip, Film, LogEvidence, PlaceView, WalkedPath
from nw_eval.reporting.html.page import anchor
from nw_eval.suite import Gate


@pytest.fixture
def rows(make_row):
    """Two scenes of ten trials; in the second most trials miss the third waypoint."""
    good = [make_row("hurdles/low", index, 4) for index in range(10)]
    return good + [make_row("hurdles/high", index, 2 if index < 8 else 4) for index in range(10)]


def walked(trial):
    return WalkedPath(trial_id=trial, points=np.array([[0.0, 0.0], [0.5, 0.1], [1.0, -0.2]]))


CLIP = Clip(
    trial_id="hurdles-high-003",
    mime="image/webp",
    data=b"moving",
    still=b"standing",
    width=80,
    height=45,
    seconds=2.5,
    caption="It looks down.",
)


def test_the_verdict_comes_first_with_what_it_rests_on(make_page, read, rows):
    page = read(make_page(rows))
    heading = next(each for each in page.all() if each.tag in {"h1", "h2"})
    assert (heading.tag, heading.text) == ("h1", "INCONCLUSIVE")
    assert page.one("head").one("title").text == "INCONCLUSIVE · hurdles · go1-parkour"
    facts = [each.text for each in page.one("ul", class_="facts").all("li")]
    assert facts[0] == "completed 12 of 20 trials in 2 scenes"
    assert "success 0.800 (bar 0.75)" in facts
    drawing = page.one("section", id="numbers").one("svg", role="img")
    assert drawing.attributes["aria-label"].startswith("Mean success is 0.800, for new ")


def test_the_next_step_follows_the_verdict_and_what_it_leads_to_is_there(make_page, read, make_row):
    good, bad = ([make_row("hurdles/low", k, to) for k in range(60)] for to in (4, 0))
    passed, failed = (read(make_page(rows)) for rows in (good, bad))
    assert [page.one("h1").text.split()[0] for page in (passed, failed)] == ["PASS", "REGRESSED"]
    assert passed.one("p", class_="next").text.startswith("Next: nw-eval baseline save makes this")
    (link,) = failed.one("p", class_="next").all("a")
    assert failed.one("section", id=link.attributes["href"].removeprefix("#"))


def test_a_reader_without_eyes_finds_a_way_through(make_page, read, rows, full_evidence):
    page = read(make_page(rows, full_evidence(rows)))
    ids = [each.attributes["id"] for each in page.all() if "id" in each.attributes]
    assert len(ids) == len(set(ids))
    for link in page.all("a"):
        where = link.attributes["href"]
        if where.startswith("http://localhost:"):
            assert link.attributes["aria-label"].startswith("view hurdles-")
        else:
            assert where.removeprefix("#") in ids
    for table in page.all("table"):
        assert table.one("caption").text
        for head in table.all("th"):
            assert head.attributes["scope"] in {"row", "col"}
    for drawing in page.all("svg"):
        named = drawing.attributes.get("role") == "img" and drawing.attributes.get("aria-label")
        assert named or drawing.attributes.get("aria-hidden") == "true"
    for picture in page.all("img"):
        assert picture.attributes["alt"]
    levels = [int(each.tag[1]) for each in page.all() if re.fullmatch(r"h[1-6]", each.tag)]
    assert levels[0] == 1
    assert all(deeper - level <= 1 for level, deeper in pairwise(levels))
    assert page.one("html").attributes["lang"] == "en"


def test_no_number_is_parted_from_its_unit_and_commands_keep_their_spaces(make_page, rows):
    body = make_page(rows, LogEvidence(clips=(CLIP,))).partition("</style>")[2]
    text = re.sub(r"<script>.*?</script>|<[^>]*>", "\n", body, flags=re.DOTALL)
    text = text.replace("&nbsp;", "\u00a0")
    assert len(re.findall("[0-9]\u00a0%", text)) > 5
    assert not re.findall(r"[0-9] (?:%|s|ms|m)(?![\w/])", text)
    assert "nw-eval replay &#39;reports/run one/mcap" in text


def test_every_trial_has_a_line_with_the_command_that_replays_it(make_page, read, rows):
    header, *lines = read(make_page(rows)).one("table", id="all").cells
    assert header[:2] == ["trial", "scene"]
    worst_first = sorted(rows, key=lambda row: (row.completed, row.success, row.trial_id))
    assert [line[0] for line in lines] == [row.trial_id for row in worst_first]
    assert lines[0][-1] == (
        "nw-eval replay 'reports/run one/mcap/hurdles/high/hurdles-high-000.mcap' view"
    )
    assert lines[0][4] == "2/4"


def test_where_trials_fail_is_told_waypoint_by_waypoint(make_page, read, rows):
    page = read(make_page(rows))
    scenes = page.one("table", class_="heat").cells
    assert scenes[1] == ["hurdles/high", "0 of 10", "0 of 10", "8 of 10", "0 of 2"]
    assert scenes[2][0] == "hurdles/low"
    together = page.one("section", id="course").all("table")[0].cells
    assert together[3][:3] == ["3", "60 %", "8 of 20"]
    survival = page.one("figure", class_="survival").one("svg").attributes["aria-label"]
    assert "100 % waypoint 1, 100 % waypoint 2, 60 % waypoint 3, 60 % waypoint 4" in survival


def test_of_many_trials_those_that_failed_are_listed_first(make_page, read, rows, monkeypatch):
    monkeypatch.setattr("nw_eval.reporting.html.page.MOST_LINES", 10)
    section = read(make_page(rows)).one("section", id="trials")
    listed = [line[0] for line in section.one("table").cells[1:]]
    failed = [row.trial_id for row in rows if not row.completed]
    assert len(listed) == 10 > len(failed) > 0
    assert listed[: len(failed)] == sorted(failed)
    assert f"10 of {len(rows)} trials, those that failed before" in section.text


def test_a_page_without_logs_is_whole_and_claims_none(make_page, read, rows):
    page = read(make_page([replace(row, mcap_path="") for row in rows]))
    assert not page.all("img")
    assert not page.all("section", id="course")[0].all("figure", class_="view")
    assert "replay" not in page.one("section", id="worst").text
    titles = [each.text for each in page.one("main").all("h2")]
    assert titles == [
        "Worst trials",
        "Numbers of the verdict",
        "Scenes",
        "Progress along the course",
        "Outcomes",
        "Where the time went",
        "Provenance",
        "All trials",
    ]


def test_a_run_of_which_nothing_came_says_so(make_page, read, make_row):
    page = read(make_page([make_row("a", 0, None)]))
    assert page.one("h1").text == "INFRASTRUCTURE"
    assert "signal 11" in page.one("section", id="outcomes").text
    assert "No trial has a row." in read(make_page([])).one("section", id="outcomes").text


def test_paths_are_drawn_on_their_scene_in_the_colour_of_their_outcome(make_page, read, rows):
    place = PlaceView(scene="hurdles/high", waypoints=np.array([[1.0, 0.0]]), reach=0.3)
    evidence = LogEvidence(
        paths=(walked("hurdles-high-003"), walked("hurdles-high-009"), walked("not-of-this-run")),
        places=(place, PlaceView(scene="elsewhere", waypoints=np.zeros((0, 2)))),
    )
    view = read(make_page(rows, evidence)).one("figure", class_="view")
    assert view.one("figcaption").text == "hurdles/high"
    # A centimetre is the unit, and y points down: what fell lies above what completed.
    paths = [(each.attributes["class"], each.attributes["d"]) for each in view.all("path")[:2]]
    assert paths == [("p o-completed", "M0 0l50 -10l50 30"), ("p o-fell", "M0 0l50 -10l50 30")]
    assert [each.attributes["class"] for each in view.all("use")] == ["end o-fell"]
    assert view.one("circle").attributes["r"] == "30"


def test_a_clip_stands_still_until_somebody_plays_it(make_page, read, rows):
    page = read(make_page(rows, LogEvidence(clips=(CLIP,), remarks=("One log is cut short.",))))
    worst = page.one("section", id="worst")
    (card,) = [each for each in worst.all("li") if each.all("img")]
    assert card.one("h3").text == "hurdles-high-003"
    still, moving = card.all("img")
    assert still.attributes["src"] == "data:image/webp;base64,c3RhbmRpbmc="
    assert moving in card.one("details").all("img")
    assert "open" not in card.one("details").attributes
    assert "One log is cut short." in worst.text


def test_the_three_worst_trials_are_shown_before_others_from_outside_and_as_the_policy_saw(
    make_page, read, rows
):
    film = Film(data=b"outside", still=b"standing outside", width=256, height=144)
    failed = [row for row in rows if not row.completed][:5]
    clips = tuple(replace(CLIP, trial_id=row.trial_id, outside=film) for row in failed)
    completed = next(row for row in rows if row.completed)
    rivals = {failed[0].trial_id: completed}
    page = read(make_page(rows, LogEvidence(clips=clips), rivals=rivals))
    first, more = page.one("section", id="worst").all("ul", class_="worst")
    assert [len(first.all("li")), len(more.all("li"))] == [3, 5]
    card = first.all("li")[0]
    assert "The baseline's policy passed waypoint 3 at 2.0 s and completed at 4.0 s." in card.text
    assert [each.attributes["alt"] for each in card.one("details").all("img")] == [
        "candidate", CLIP.caption,
    ]  # fmt: skip
    assert [each.tag for each in page.one("main").all() if each.tag == "section"]
    assert page.one("main").all("section")[0].attributes["id"] == "worst"
    assert page.one("main").all("section")[-1].attributes["id"] == "trials"


@pytest.mark.parametrize("is_of_policy", [True, False])
def test_the_baseline_stands_beside_the_candidate(make_page, read, rows, is_of_policy):
    """A camera that no policy sees through gives way to it."""
    film = Film(data=b"outside", still=b"standing outside", width=256, height=144)
    other = replace(film, data=b"baseline")
    clip = replace(
        CLIP, caption="The last 2.5 s: eyes.", span="The last 2.5 s.", is_of_policy=is_of_policy,
        outside=film, baseline=other, baseline_caption="baseline shipped up to waypoint 3",
    )  # fmt: skip
    page = read(make_page(rows, LogEvidence(clips=(clip,))))
    (card,) = [each for each in page.one("section", id="worst").all("li") if each.all("img")]
    moving = card.one("details").all("img")
    more = ["The last 2.5 s: eyes."] if is_of_policy else []
    assert [each.attributes["alt"] for each in moving] == ["candidate", "baseline", *more]
    assert moving[1].attributes["src"] == "data:image/webp;base64,YmFzZWxpbmU="
    said = card.one("p", class_="caption").text
    shown = "The last 2.5 s: eyes." if is_of_policy else "The last 2.5 s."
    assert said == f"{shown} Beside it: baseline shipped up to waypoint 3."


def test_a_trial_opens_in_the_page_itself(make_page, read, rows):
    """By a link alone: no script, no server."""
    evidence = LogEvidence(
        paths=tuple(walked(row.trial_id) for row in rows),
        places=(PlaceView(scene="hurdles/high", waypoints=np.array([[1.0, 0.0]])),),
    )
    page = read(make_page(rows, evidence))
    ids = {each.attributes["id"]: each for each in page.all() if "id" in each.attributes}
    lines = page.one("table", id="all").all("tr")[1:]
    assert len(lines) == len(rows) == 20
    carded = {each.attributes["id"] for each in page.one("section", id="worst").all("li")}
    by_name = {row.trial_id: row for row in rows}
    for line in lines:
        (link,) = line.one("th").all("a")
        row = by_name[link.text]
        assert link.attributes["href"] == f"#trial-{row.trial_id}"
        opened = ids[link.attributes["href"][1:]]
        assert opened.tag == ("li" if opened.attributes["id"] in carded else "article")
        assert f"{row.waypoints_reached} of 4 waypoints" in opened.text
        chart = opened.one("figure", class_="timeline").one("svg", role="img")
        assert chart.attributes["aria-label"].endswith(f"{row.outcome} at {row.sim_s:.1f} s.")
        if opened.tag == "article":
            back = opened.one("a", class_="close").attributes["href"]
            assert ids[back[1:]] is line
            (walk,) = opened.all("svg", class_="walk")
            assert {each.attributes["href"][1:] for each in walk.all("use")} <= set(ids)
    assert carded
    assert len(carded) < 20


def test_a_trial_without_a_log_is_a_line_alone(make_page, read, rows):
    page = read(make_page(rows, LogEvidence(paths=(walked(rows[-1].trial_id),))))
    assert [each.one("h3").text for each in page.all("article")] == [rows[-1].trial_id]
    completed = [row.trial_id for row in rows if row.completed]
    lines = page.one("table", id="all").all("tr")[1:]
    linked = {line.one("th").text for line in lines if line.one("th").all("a")}
    assert linked & set(completed) == {rows[-1].trial_id}


def test_the_address_of_a_trial_is_plain_and_its_own_whatever_its_name():
    names = ["a b", "a/b", "a_b", "\u00fc", 'a"b', "a.b"]
    found = [anchor(name) for name in names]
    assert len(set(found)) == len(names)
    assert all(re.fullmatch(r"trial-[A-Za-z0-9_.~=+-]+", each) for each in found)


def test_the_count_of_an_outcome_leads_to_its_trials(make_page, read, rows):
    page = read(make_page(rows))
    links = page.one("section", id="outcomes").one("ul", class_="legend").all("a")
    assert [each.attributes["data-outcome"] for each in links] == ["completed", "fell"]
    assert {each.attributes["href"] for each in links} == {"#trials"}


def test_scenes_have_their_picture_from_above_in_colours_once(make_page, read, rows, full_evidence):
    evidence = full_evidence(rows)
    coloured = [
        replace(place, picture=replace(place.picture, is_coloured=True))
        for place in evidence.places
    ]
    page = read(make_page(rows, replace(evidence, places=tuple(coloured), clips=())))
    pictures = page.all("image")
    assert {each.attributes["class"] for each in pictures} == {"colours"}
    used = [each.one("use").attributes["href"] for each in page.all("a", class_="thumb")]
    assert sorted(used) == sorted(f"#{each.attributes['id']}" for each in pictures)


def test_labels_of_a_run_lead_its_provenance_and_link_the_job_s_server_alone(make_page, read, rows):
    labels = {
        "repository": "legs/walker", "commit": "a1" * 20, "branch": 'x"><script>',
        "job_url": "https://ci.example/legs/walker/actions/runs/7", "note": "<b>bold</b>",
    }  # fmt: skip
    page = read(make_page(rows, labels=labels))
    table = page.one("section", id="provenance").one("table")
    assert [line[0] for line in table.cells[1:6]] == [
        "repository", "commit", "branch", "job's page", "label note",
    ]  # fmt: skip
    assert table.cells[5][1] == "<b>bold</b>"
    links = {each.text: each.attributes["href"] for each in table.all("a")}
    base = "https://ci.example/legs/walker"
    assert links["legs/walker"] == base
    assert links["a1" * 20] == f"{base}/commit/{'a1' * 20}"
    assert all(each.startswith(f"{base}") and '"' not in each for each in links.values())
    assert not page.all("b")


def test_what_the_page_has_no_room_for_is_left_out_and_said(make_page, read, rows):
    large = [replace(CLIP, trial_id=row.trial_id, data=bytes(900_000)) for row in rows[10:13]]
    page = read(make_page(rows, LogEvidence(clips=tuple(large))))
    assert len(page.one("section", id="worst").all("details", class_="clip")) == 2
    assert "1 clip left out: the page is full." in page.one("section", id="worst").text


def test_the_same_run_gives_the_same_page_byte_for_byte(make_page, rows, full_evidence):
    evidence = full_evidence(rows)
    turned = replace(evidence, paths=evidence.paths[::-1], places=evidence.places[::-1])
    assert make_page(rows, evidence) == make_page(rows[::-1], turned)


def test_no_process_draws_a_page_otherwise():
    script = "from nw_eval.reporting.html.runs import render_index; print(render_index([], ['x']))"
    pages = {
        subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(pages) == 1


def test_scenes_that_do_not_count_are_in_no_task(make_page, read, rows):
    gate = Gate(success_rate=0.75, tiers={"hurdles/high": "informational"})
    more = [replace(row, task="gaps") for row in rows if row.scene == "hurdles/low"]
    more = [replace(row, scene="gaps/one", trial_id=f"gaps-{row.trial_id}") for row in more]
    tasks = read(make_page([*rows, *more], gate=gate)).one("section", id="numbers").one("table")
    assert [line[0] for line in tasks.cells[1:]] == ["gaps", "hurdles"]
    assert tasks.cells[2][2:5] == ["1", "10", "1.000"]


@pytest.mark.parametrize(("trials", "scenes", "most"), [(160, 16, 5e6), (3200, 64, 15e6)])
def test_a_page_stays_small(make_page, make_row, full_evidence, trials, scenes, most):
    drawn = [
        make_row(f"hurdles/scene_with_a_name_{index % scenes:02d}", index, index % 5)
        for index in range(trials)
    ]
    assert len(make_page(drawn, full_evidence(drawn)).encode()) < most


def test_what_is_to_be_typed_is_set_as_code_in_a_reason():
    assert (
        _coded("`nw-eval run x` <b> runs 5 s")
        == "<code>nw-eval run x</code> &lt;b&gt; runs 5\u00a0s"
    )
    assert _coded("one ` alone") == "one ` alone"
