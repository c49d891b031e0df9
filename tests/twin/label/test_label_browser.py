"""A person's minute on the page, in a browser without a screen: click a waypoint, save."""

import os
import time
from pathlib import Path

import pytest
from label_places import block, floor, gaussians, opened

from nw_eval.scenes.folder import load_folder
from nw_eval.twin.label.page import LabelPage

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MIDDLE = (640, 420)

playwright = pytest.importorskip("playwright.sync_api")
pytest.importorskip("viser")


@pytest.mark.nightly
@pytest.mark.skipif(not CHROMIUM.exists(), reason="no chromium here")
def test_a_click_in_the_browser_puts_a_waypoint_and_the_key_saves_it(tmp_path):
    labelling = opened(tmp_path, floor(), block(2.0, 1.0, 0.1), block(4.5, 0.3, 0.3))
    before = labelling.state.waypoints
    pictures = Path(os.environ.get("NW_EVAL_PICTURES", tmp_path))
    with LabelPage(labelling, gaussians(400)) as page, playwright.sync_playwright() as play:
        page.controls.place.mesh.value = True
        page.run(lambda: None)
        browser = play.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        view = browser.new_page(viewport={"width": 1400, "height": 900})
        view.goto(page.url)
        view.get_by_text("add 1 m on").wait_for(timeout=60_000)
        view.wait_for_timeout(10_000)
        view.mouse.move(*MIDDLE)
        view.mouse.down()
        view.wait_for_timeout(150)
        view.mouse.up()
        wait(lambda: len(labelling.state.waypoints) == len(before) + 1)
        view.wait_for_timeout(3_000)
        view.screenshot(path=pictures / "clicked.png")
        view.keyboard.press("n")
        wait(lambda: len(labelling.state.waypoints) == len(before) + 2)
        view.keyboard.press("Control+s")
        wait(lambda: "Saved" in page.controls.status.content)
        view.wait_for_timeout(3_000)
        view.screenshot(path=pictures / "saved.png")
        browser.close()
    again = load_folder(labelling.place.folder)
    assert len(again.trail) == len(before) + 2
    assert again.trail[len(before)] == pytest.approx(labelling.state.waypoints[2], abs=1e-4)


def wait(holds, seconds=30):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.1)
