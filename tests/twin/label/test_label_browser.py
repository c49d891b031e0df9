"""A person on the page, in a browser without a screen: measure, lay a trail, save, run."""

import os
from pathlib import Path

import numpy as np
import pytest
from label_person import CHROMIUM, Browser, wait
from label_places import block, floor, gaussians, written_place

from nw_eval import cli
from nw_scenes.folder import load_folder
from nw_scenes.neverwhere import load_published
from nw_splat.files import write_splat
from nw_twin.label import files

pytest.importorskip("playwright")
pytest.importorskip("viser")
pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(1200),
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium here"),
]


@pytest.fixture
def pictures(tmp_path):
    return Path(os.environ.get("NW_EVAL_PICTURES", tmp_path))


@pytest.fixture
def folder(tmp_path):
    """A corridor with a bar of 0.1 m, twice as large as it should be: 0.2 m; and a suite of it."""
    first = written_place(tmp_path / "first", floor(-4.0, 18.0, width=10.0), block(4.0, 0.6, 0.2))
    write_splat(first / "splat.ply", gaussians(300))
    files.copy_scene(str(first), tmp_path / "corridor")
    return tmp_path / "corridor"


def test_two_markers_three_waypoints_saved_and_run(label, folder, pictures, tmp_path):
    def person(page):
        labelling = page._labelling
        with Browser(page, pictures) as browser:
            # The bar is 0.6 m long in the scan and 0.3 m in the world: two points say so.
            browser.press("4")
            browser.click((4.0, 0.5, 0.2))
            browser.click((4.6, 0.5, 0.2))
            wait(lambda: labelling.distance is not None)
            assert labelling.distance == pytest.approx(0.6, abs=0.05)
            browser.view.get_by_role("tab", name="Scale").click()
            browser.shows(f"{labelling.distance:.3f} m")
            browser.picture("measured")
            scale = 0.3 / labelling.distance
            browser.view.get_by_label("It is really, m").fill("0.3")
            browser.press("Tab")
            browser.view.get_by_role("button", name="Scale the scene").click()
            wait(lambda: labelling.state.placement.scale == pytest.approx(scale))
            assert scale == pytest.approx(0.5, abs=0.05)

            browser.view.get_by_role("tab", name="Trail").click()
            for count in (1, 0):
                browser.press("x")
                wait(lambda count=count: len(labelling.state.waypoints) == count)
            browser.shows("There is no waypoint yet")
            browser.press("1")
            for i, point in enumerate([(2.15, 0.0, 0.1), (3.0, 0.2, 0.0), (3.6, 0.0, 0.0)], 1):
                browser.click(point)
                wait(lambda i=i: len(labelling.state.waypoints) == i, at=lambda i=i: i)
                assert labelling.state.waypoints[-1] == pytest.approx(point, abs=0.05)
            heights = [point[2] for point in labelling.state.waypoints]
            np.testing.assert_allclose(heights, [0.1, 0.0, 0.0], atol=1e-3)  # Snapped to the mesh.
            browser.press("Control+z")
            wait(lambda: len(labelling.state.waypoints) == 2)
            browser.press("Control+Shift+z")
            wait(lambda: len(labelling.state.waypoints) == 3)
            browser.shows("1 hurdle, 0.10 m at most: within reach.")
            browser.shows("Not saved yet")
            browser.press("Control+Shift+s")
            browser.shows("✓ Saved")
            browser.picture("saved")

    code, printed = label(folder, do=person)
    assert code == 0
    assert f"label: next: nw-eval run {folder / 'suite.yaml'}" in printed.out

    scene = load_folder(folder)
    np.testing.assert_allclose(scene.trail[:, 2], [0.1, 0.0, 0.0], atol=1e-3)
    (pair,) = (folder / "published").iterdir()
    np.testing.assert_allclose(load_published(pair).trail[:, 2], scene.trail[:, 2], atol=1e-3)
    run = ["run", str(folder / "suite.yaml"), "--trials", "2", "--out", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as left:
        cli.main(run)
    assert left.value.code in {0, 3}  # Two trials decide nothing.


def test_with_the_keyboard_alone_a_trail_is_proposed_measured_and_saved(label, folder, pictures):
    def person(page):
        labelling = page._labelling
        with Browser(page, pictures) as browser:
            browser.press("v")  # Without a splat a browser without a graphics card is quick.
            browser.press("c")
            wait(lambda: page.controls.place.shows_mesh and not page.controls.place.shows_splat)
            for _ in range(4):
                browser.press("n")
            browser.press("p")
            browser.shows("Proposed for hurdles: a bar 0.20 m high")
            wait(lambda: labelling.state.task == "hurdles")
            browser.press("m")
            browser.press("f")
            browser.press("m")
            wait(lambda: labelling.distance is not None)
            before = labelling.state.waypoints
            # Letters that are typed into a field are no keys.
            browser.view.get_by_label("by, m").first.focus()
            browser.view.keyboard.type("x")
            browser.press("Escape")
            browser.view.get_by_role("tab", name="Trail").focus()
            for _ in range(3):
                browser.press("ArrowRight")
            browser.shows("Crop from, m")
            assert labelling.state.waypoints == before
            browser.picture("keys")
            browser.press("Control+s")
            browser.shows("✓ Saved")

    code, _ = label(folder, do=person)
    assert code == 0
    assert load_folder(folder).trail[0, 2] == pytest.approx(0.2)
