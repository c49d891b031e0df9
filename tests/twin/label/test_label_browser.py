"""A person on the page, in a browser without a screen: measure, lay a trail, save, run."""

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from label_person import CHROMIUM, Browser, wait
from label_places import SCENE, block, floor, gaussians, written_place
from two_minutes import MOST, labelled

from nw_eval import cli
from nw_scenes.folder import load_folder
from nw_scenes.neverwhere import load_published
from nw_splat.files import write_splat
from nw_twin.label import files

pytest.importorskip("playwright")
viser = pytest.importorskip("viser")
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


def test_with_the_keyboard_alone_a_trail_is_proposed_measured_and_saved(
    label,
    folder,
    pictures,
):
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


def test_a_tilted_place_without_a_scale_is_scaled_levelled_and_flipped_by_clicks(
    label, pictures, tmp_path
):
    tilt = trimesh.transformations.rotation_matrix(0.12, [1, 0.4, 0])
    solids = [floor(width=6.0), block(2.0, 1.0, 0.1)]
    for solid in solids:
        solid.apply_transform(tilt)
    scene = SCENE.replace("licence:", "units: unknown\nlicence:")
    folder = written_place(tmp_path / "tilted", *solids, scene=scene)

    def person(page):
        labelling = page._labelling
        with Browser(page, pictures) as browser:

            def click(x, y, z):
                lies = labelling.state.placement.matrix @ tilt @ [x, y, z, 1.0]
                browser.click(tuple(lies[:3]))

            browser.press("v")
            browser.press("c")
            browser.shows("Not to scale, and runs nowhere yet")
            click(2.2, 0.5, 0.1)
            click(2.8, 0.5, 0.1)
            wait(lambda: labelling.distance is not None)
            browser.shows("0.6")
            browser.picture("unscaled")
            browser.view.get_by_label("It is really, m").fill("0.3")
            browser.press("Tab")
            browser.view.get_by_role("button", name="Scale the scene").click()
            wait(lambda: labelling.state.to_scale)
            assert labelling.state.placement.scale == pytest.approx(0.5, abs=0.05)
            scale = labelling.state.placement.scale
            browser.view.get_by_role("button", name="feet").click()
            wait(lambda: labelling.state.placement.scale == pytest.approx(0.3048))
            browser.press("Control+z")
            wait(lambda: labelling.state.placement.scale == scale)

            browser.view.get_by_role("tab", name="Place").click()
            browser.view.get_by_role("button", name="Three clicks on the floor").click()
            wait(lambda: page.controls.click == "floor")
            for count, spot in enumerate([(0.0, -1.0, 0.0), (0.0, 1.5, 0.0), (1.6, -1.2, 0.0)], 1):
                click(*spot)
                wait(lambda count=count: len(labelling.state.floor) == count % 3)
            heights = labelling.mesh.vertices[:, 2] / scale
            assert heights.min() == pytest.approx(-0.2, abs=0.02)
            assert heights.max() == pytest.approx(0.1, abs=0.02)
            browser.picture("levelled")
            browser.view.get_by_role("button", name="Flip upside down").click()
            wait(lambda: labelling.mesh.vertices[:, 2].max() > 0.15 * scale)
            browser.picture("flipped")
            browser.press("Control+z")
            browser.press("Control+s")
            browser.shows("✓ Saved")

    code, printed = label(folder, do=person)
    assert code == 0
    assert f"label: {folder} is not to scale: put two markers" in printed.out
    assert np.ptp(load_folder(folder).static_mesh.vertices[:, 0]) == pytest.approx(4.5, abs=0.3)


def test_a_scan_is_scaled_levelled_cropped_and_labelled_by_hand_in_two_minutes(pictures, folder):
    clock = labelled(folder, pictures)
    assert len(clock.steps) == 7
    assert clock.total <= MOST, clock.steps


def test_another_page_of_the_same_browser_cannot_speak_to_it(label, folder, pictures):
    opens = """([url, word]) => new Promise(resolve => {
        const socket = new WebSocket(url, [word]);
        socket.onopen = () => resolve("opened");
        socket.onerror = () => resolve("refused");
    })"""

    def person(page):
        with Browser(page, pictures) as browser:
            words = [page.url.replace("http", "ws"), f"viser-v{viser.__version__}"]
            assert browser.view.evaluate(opens, words) == "opened"  # The page itself may.
            browser.view.goto("data:text/html,<p>another page</p>")
            assert browser.view.evaluate(opens, words) == "refused"

    code, _ = label(folder, do=person)
    assert code == 0
