"""The page of logged trials, steered as viser's clients steer it, on a server that runs."""

import time
import urllib.error
import urllib.request
from types import SimpleNamespace

import numpy as np
import pytest

from nw_eval.testing import FakeClock
from nw_eval.view import trials_page
from nw_eval.view.sources import open_shelf
from nw_eval.view.trials_page import ViewPage

pytest.importorskip("viser")

FIRST, SECOND = "hurdles-one_low_carpet-000", "hurdles-one_low_carpet-001"


@pytest.fixture(scope="module")
def page(runs):
    with ViewPage(open_shelf(runs[0], runs[1])) as page:
        yield page


def wait(holds):
    end = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def fetch(page, query="", **headers):
    request = urllib.request.Request(page.url + query, headers=headers)
    with urllib.request.urlopen(request) as answer:
        return answer.status


def test_seeking_puts_every_robot_where_it_was(page):
    page.choose(FIRST)
    page.seek(1.0)
    for trace, handles in zip(page._traces, page._drawing._bodies, strict=True):
        where = trace.trunk[trace.at(1.0)]
        np.testing.assert_allclose(handles["trunk"].position, where)
    page.seek(99.0)
    assert page.time == page.end
    page.seek(-1.0)
    assert page.time == 0.0


def test_it_plays_in_its_own_time_to_the_end_and_stops_there(page, monkeypatch):
    now = FakeClock()
    monkeypatch.setattr(trials_page, "clock", SimpleNamespace(monotonic=now))
    page.seek(1.0)
    sent = page.sent
    page.play(wanted=True)
    for moment in (1.04, 1.08, 1.12):
        now.advance(0.04)
        wait(lambda moment=moment: page.time == pytest.approx(moment))
    assert page.plays
    now.advance(99.0)
    wait(lambda: not page.plays)  # It has drawn the last moment by then.
    assert page.time == page.end
    assert page.sent >= sent + 4
    page.play(wanted=True)
    assert page.time == 0.0  # From the start again.
    page.play(wanted=False)


def test_a_link_shows_its_trial_at_its_second(page, runs):
    page.choose(FIRST)
    assert fetch(page, f"/?run={runs[0].name}&trial={SECOND}&t=0.84") == 200
    wait(lambda: page.name == SECOND and page.time == pytest.approx(0.84))
    assert fetch(page, "/?t=0.2") == 200
    wait(lambda: page.time == pytest.approx(0.2))
    assert page.name == SECOND


@pytest.mark.parametrize("query", ["/?trial=no-such&t=1", f"/?run=other&trial={FIRST}&t=1"])
def test_a_link_to_what_is_not_here_is_said_and_changes_nothing(page, query):
    page.choose(SECOND)
    page.seek(0.4)
    before = page._panel
    assert fetch(page, query) == 200
    wait(lambda: page._panel is not before)
    wait(lambda: r"no\-such" in page._panel.heading or "another run" in page._panel.heading)
    assert (page.name, page.time) == (SECOND, pytest.approx(0.4))


def test_another_page_cannot_turn_to_a_trial_behind_ones_back(page):
    page.choose(FIRST)
    page.seek(0.0)
    fetch(page, f"/?trial={SECOND}&t=1", **{"Sec-Fetch-Dest": "image"})
    with pytest.raises(urllib.error.HTTPError, match="403"):
        fetch(page, f"/?trial={SECOND}&t=1", Host="evil.example")
    time.sleep(0.3)
    assert (page.name, page.time) == (FIRST, 0.0)


def test_other_trials_of_the_place_are_ghosts_when_they_are_wanted(page):
    page.choose(FIRST)
    page.seek(0.6)
    page.choose(FIRST, 1)
    assert [trace.name for trace in page._traces] == [FIRST, FIRST, SECOND]
    assert page.time == pytest.approx(0.6)
    page.choose(FIRST, 0)
    assert len(page._traces) == 2


def test_a_damaged_log_is_said_and_the_trial_stays(page, monkeypatch, tmp_path):
    page.choose(FIRST)
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(b"\x89MCAP0\r\n nothing")
    monkeypatch.setitem(page._shelf.logs, SECOND, torn)
    page.choose(SECOND)
    assert page.name == FIRST
    assert "cannot be shown" in page._panel.heading


def test_the_mesh_is_there_under_the_splat(page):
    page.choose(FIRST)
    assert not page._drawing.shows_mesh
    page.show_mesh(True)
    assert page._drawing.shows_mesh
    page.show_mesh(False)
