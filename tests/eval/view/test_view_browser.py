"""A person at the pages, in a browser without a screen: follow a link, scrub, play, push, save."""

import os
import re
import shutil
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from nw_eval import cli
from nw_eval.view.live_page import open_live
from nw_eval.view.sources import open_shelf
from nw_eval.view.trials_page import ViewPage

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]

playwright = pytest.importorskip("playwright.sync_api")
pytest.importorskip("viser")
pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(900),
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium here"),
]


def wait(holds, seconds=60.0):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def picture(tmp_path):
    """Keep a picture of a page, for people."""
    folder = Path(os.environ.get("NW_EVAL_PICTURES", tmp_path))

    def keep(view, name):
        view.wait_for_timeout(3_000)
        view.screenshot(path=folder / f"{name}.png")

    return keep


@contextmanager
def browser(url):
    with playwright.sync_playwright() as play:
        chromium = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        view = chromium.new_page(viewport={"width": 1180, "height": 860})
        view.set_default_timeout(120_000)
        view.goto(url)
        yield view
        chromium.close()


def drag(view, label, to):
    """Drag the knob of a slider to a share of its width."""
    knob = view.get_by_text(label, exact=True).locator("xpath=following::*[@role='slider'][1]")
    box = knob.locator("xpath=ancestor::*[contains(@class, 'Slider-track')][1]").bounding_box()
    middle = box["y"] + box["height"] / 2
    at = knob.bounding_box()
    view.mouse.move(at["x"] + at["width"] / 2, middle)
    view.mouse.down()
    view.mouse.move(box["x"] + to * box["width"], middle, steps=8)
    view.mouse.up()


def test_a_link_of_the_report_opens_its_trial_which_is_scrubbed_and_played(runs, picture):
    with (
        ViewPage(open_shelf(runs[1], runs[0])) as page,
        browser((runs[1] / "report.html").as_uri()) as view,
    ):
        link = view.get_by_role("link", name="view").last.get_attribute("href")
        assert link.startswith("http://localhost:8720/?")
        view.goto(page.url + link.removeprefix("http://localhost:8720"))
        view.get_by_role("button", name="Play").wait_for()
        name, moment = re.search(r"trial=([\w-]+)&t=([\d.]+)", link).groups()
        wait(lambda: page.name == name and page.time == pytest.approx(float(moment)))
        picture(view, "view-linked")

        for share in (0.9, 0.6, 0.2):
            before = page.time
            drag(view, "Time, s", share)
            wait(lambda before=before: page.time != before)
            wait(lambda share=share: page.time == pytest.approx(share * page.end, abs=0.15))
        picture(view, "view-scrubbed")

        for words, step in (("-10", -0.2), ("+1", 0.02)):
            before = page.time
            view.get_by_text(words, exact=True).click()
            wait(lambda at=before + step: page.time == pytest.approx(at))
        sent = page.sent
        view.get_by_role("button", name="Play").click()
        wait(lambda: page.plays)
        wait(lambda: not page.plays and page.time == page.end)
        assert page.sent > sent + 5


def test_a_policy_is_played_with_and_what_was_done_runs_as_a_suite(tmp_path, picture):
    with (
        open_live("go1-act-rgb", "hurdles/one_low_carpet", port=0) as page,
        browser(page.url) as view,
    ):
        stage = page._stage
        view.get_by_role("button", name="Play").wait_for()
        picture(view, "live-still")
        view.get_by_role("button", name="Play").click()
        wait(lambda: stage.trial.episode.step >= 40)
        view.get_by_text("left", exact=True).click()
        wait(lambda: stage.pushed)
        view.get_by_role("button", name="Drop a box").click()
        wait(lambda: stage.place.boxes)
        drag(view, "payload, kg", 0.3)
        wait(lambda: stage.cell.get("payload", 0.0) > 2.0)
        wait(lambda: stage.trial.episode.step >= 80)
        picture(view, "live-played")
        if page.runs:
            view.get_by_role("button", name="Pause").click()
            wait(lambda: not page.runs)
        folder = view.get_by_text("Folder", exact=True).locator("xpath=following::input[1]")
        folder.fill(str(tmp_path / "played"))
        view.keyboard.press("Tab")
        view.get_by_role("button", name="Save as a suite").click()
        wait((tmp_path / "played" / "suite.yaml").exists)
        view.get_by_text("nw-eval run").first.wait_for()

    suite = (tmp_path / "played" / "suite.yaml").read_text()
    assert "payload" in suite
    assert "push" in suite
    run = ["run", str(tmp_path / "played" / "suite.yaml"), "--trials", "1", "--workers", "1"]
    with pytest.raises(SystemExit) as left:
        cli.main([*run, "--out", str(tmp_path / "run")])
    assert left.value.code in {0, 3}  # One trial decides nothing.
