"""The page's buttons, keys and clicks, called as viser calls them, on a server that runs."""

import urllib.request
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from label_places import UNSCALED, block, floor, gaussians, opened, written_place
from twin_parts import blobs, grid

from nw_eval.viewing.browser import splat_points
from nw_scenes.folder import load_folder
from nw_scenes.mesh import rotation_matrix
from nw_twin.label.drawing import let_through
from nw_twin.label.label_page import LabelPage, profile_svg
from nw_twin.label.labelling import open_labelling

pytest.importorskip("viser")

DOWN = (0.0, 0.0, -1.0)


@pytest.fixture
def labelling(tmp_path):
    return opened(tmp_path)


@pytest.fixture
def page(labelling):
    with LabelPage(labelling, gaussians()) as page:
        yield page


def press(page, label):
    """Call what a button or key does, by its label."""
    handle = page.controls.by_name[label]
    if hasattr(handle, "options"):  # One of a row of buttons.
        handle._impl.value = label.rpartition(": ")[2]
    callbacks = getattr(handle._impl, "trigger_cb", None) or handle._impl.update_cb
    for callback in callbacks:
        callback(SimpleNamespace(client=None, client_id=0, target=handle))


def click(page, x, y):
    page._on_click(SimpleNamespace(ray_origin=(x, y, 5.0), ray_direction=DOWN))


def test_it_serves_on_this_machine_only_and_says_where(page):
    assert page.url.startswith("http://127.0.0.1:")
    assert not page.url.endswith(":0")
    with urllib.request.urlopen(page.url) as answer:
        assert b"<html" in answer.read(2000)


def test_a_click_puts_a_waypoint_on_the_mesh_and_the_key_takes_it_back(page, labelling):
    click(page, 50.0, 0.0)  # Beside the place.
    assert not labelling.can_undo
    assert page.controls.status.content == ""
    click(page, 2.5, 0.3)
    assert labelling.state.waypoints[2] == pytest.approx((2.5, 0.3, 0.1))
    assert page.controls.chosen == 2
    press(page, "key Ctrl(+Shift)+Z: undo")
    assert len(labelling.state.waypoints) == 2
    press(page, "Ctrl(+Shift)+Z: redo")
    assert len(labelling.state.waypoints) == 3


def test_a_click_moves_the_chosen_waypoint_sets_the_start_or_puts_a_marker(page, labelling):
    press(page, "key Clicks (1 2 3 4 5): chosen")
    press(page, "key Edit (N F X): next")
    click(page, 5.0, 1.0)
    assert labelling.state.waypoints[1] == pytest.approx((5.0, 1.0, 0.0))
    page.controls.set_click("start")
    click(page, 2.5, -1.0)
    assert labelling.start.position == pytest.approx((2.5, -1.0, 0.1))
    page.controls.set_click("marker")
    click(page, 0.0, 0.0)
    click(page, 1.0, 0.0)
    assert labelling.distance == pytest.approx(1.0)


def test_with_keys_alone_a_trail_is_laid_and_saved(page, labelling):
    for label in ("remove", "remove", "add 1 m on", "add 1 m on"):
        press(page, f"key Edit (N F X): {label}")
    press(page, "key Move (I K J L): +y")
    assert labelling.state.waypoints[1] == pytest.approx((2.0, 0.1, 0.0), abs=0.1001)
    press(page, "key Order (G H): earlier")
    press(page, "key 1 m before the course (B)")
    press(page, "key Save (Ctrl+S)")
    assert "Saved" in page.controls.status.content
    saved = load_folder(labelling.place.folder)
    np.testing.assert_allclose(saved.trail, labelling.course.trail, atol=1e-4)


def test_the_published_pair_is_written_where_it_is_wanted(page, labelling, monkeypatch):
    written = []
    monkeypatch.setattr(labelling, "publish", lambda folder: written.append(folder) or folder)
    page.save(publishes=False)
    assert written == []
    words = page.save(publishes=True)
    assert written == [labelling.place.folder / "published"]
    assert "beside it in `published`" in words


def test_scale_turn_shift_and_crop_move_the_place_in_the_drawing(page, labelling):
    press(page, "Turn: left")
    assert labelling.state.placement.quat == pytest.approx(
        page.server.scene.get_handle_by_name("/splat").wxyz
    )
    page.controls.set_click("marker")
    click(page, 0.0, 0.0)
    click(page, 0.5, 0.0)
    assert page.controls.place._metres.value == pytest.approx(0.5)  # As it was measured.
    page.controls.place._metres.value = 1.0
    press(page, "Scale the scene")
    assert labelling.state.placement.scale == pytest.approx(2.0)
    assert page.server.scene.get_handle_by_name("/splat").scale == pytest.approx(2.0)
    press(page, "Crop to the pink box")
    assert labelling.state.crop is not None
    press(page, "Take the crop back")
    assert labelling.state.crop is None


def test_the_crop_that_is_typed_is_drawn_before_it_is_made(page, labelling):
    place = page.controls.place
    assert place.preview is None
    place._low.value = (0.0, -1.0, -1.0)
    page.run(lambda: None)
    assert place.preview.low == (0.0, -1.0, -1.0)
    assert page.server.scene.get_handle_by_name("/crop") is not None
    press(page, "Crop to the pink box")
    assert labelling.state.crop.low == (0.0, -1.0, -1.0)
    assert place.preview is None
    assert page.server.scene.get_handle_by_name("/crop") is None
    press(page, "key Take the crop back")
    assert place._low.value[0] == pytest.approx(-2.01)


def test_splat_and_mesh_are_shown_and_hidden_by_keys(page):
    def seen():
        handles = (page.server.scene.get_handle_by_name(name) for name in ("/splat", "/mesh"))
        return tuple(handle.visible for handle in handles)

    assert seen() == (True, False)
    press(page, "key Show, hide (V C R): mesh")
    assert seen() == (True, True)
    press(page, "key Show, hide (V C R): splat")
    assert seen() == (False, True)


def test_under_a_roof_clicks_reach_the_floor(tmp_path):
    labelling = opened(tmp_path, floor(), block(-2.0, 9.0, 0.1, width=5.0, bottom=2.0))
    with LabelPage(labelling, gaussians()) as page:
        level = page.controls.place.cutaway.level
        assert level == pytest.approx(1.2)
        shown = page.server.scene.get_handle_by_name("/mesh")
        assert shown.vertices[:, 2].max() <= level
        click(page, 1.0, 0.5)
        assert labelling.state.waypoints[-1] == pytest.approx((1.0, 0.5, 0.0))
        press(page, "key Show, hide (V C R): roof")
        click(page, 1.0, 0.5)
        assert labelling.state.waypoints[-1] == pytest.approx((1.0, 0.5, 2.1))
        # A view: the place itself is as it was.
        assert labelling.mesh.vertices[:, 2].max() == pytest.approx(2.1)


@pytest.mark.parametrize(("opacity_logit", "level"), [(3.0, 1.2), (-5.0, None)])
def test_treetops_of_the_splat_between_the_view_and_the_start_are_hidden(
    labelling, opacity_logit, level
):
    points, _ = grid((-6, -6, 2), (14, 0, 0), (0, 14, 0), (46, 46))
    splat = blobs(points, opacity_logit=opacity_logit)
    splat.log_scales[:] = np.log([0.2, 0.2, 0.01])
    with LabelPage(labelling, splat) as page:
        assert page.controls.place.cutaway.level == level


@pytest.mark.parametrize("opacity", [0.2, 0.6])
def test_light_that_goes_through_one_gaussian_is_what_it_does_not_take(opacity):
    one = blobs(np.zeros((1, 3)), opacity_logit=np.log(opacity / (1 - opacity)))
    one.log_scales[0], one.quats[0] = np.log([0.1, 0.2, 0.3]), (0.9, 0.1, 0.3, -0.2)
    splat = splat_points(one, np.eye(4))
    through = [let_through(splat, (x, -3.0, 0.0), (x, 3.0, 0.0)) for x in (0.0, 0.05, 5.0)]
    assert through[0] == pytest.approx(1 - opacity, abs=1e-4)
    assert through[0] < through[1] < through[2] == 1.0
    assert let_through(splat, (0.0, 3.0, 0.0), (0.0, 1.0, 0.0)) == 1.0  # It lies beyond.


def test_the_floor_under_the_start_is_put_at_zero(page, labelling):
    click(page, 2.5, 0.3)
    page.controls.set_click("start")
    click(page, 2.5, 0.3)
    press(page, "Put the floor under the start at z = 0")
    assert labelling.start.position[2] == pytest.approx(0.0)
    assert labelling.mesh.vertices[:, 2].max() == pytest.approx(0.0)


def test_a_proposal_says_on_the_page_what_it_found(page):
    press(page, "key Propose along my waypoints (P)")
    assert page.controls.status.content.startswith("Proposed for ")


def test_every_button_has_a_command_for_the_keyboard(page):
    names = set(page.controls.by_name)
    buttons = {name for name in names if not name.startswith("key ")}
    assert {f"key {name}" for name in buttons} <= names


def test_what_is_wrong_is_shown_on_the_page(page):
    press(page, "Scale the scene")
    assert "two markers" in page.controls.status.content
    press(page, "Turn: left")
    assert page.controls.status.content == "● Not saved yet."


def test_even_a_fault_of_its_own_is_shown_and_escaped(page):
    page.run(lambda: 1 / 0)
    assert "ZeroDivisionError" in page.controls.status.content

    def broken():
        raise ValueError("<img src=x>")

    page.run(broken)
    assert "<img" not in page.controls.status.content


def test_the_chart_and_the_hints_follow_every_change(page):
    before = page.controls.chart.content
    assert "within reach" in page.controls.hints.content
    press(page, "Edit (N F X): remove")
    press(page, "Edit (N F X): remove")
    assert page.controls.chart.content != before
    assert "no waypoint yet" in page.controls.hints.content


def test_the_chart_is_well_formed_and_shows_each_waypoint(labelling):
    svg = ET.fromstring(profile_svg(labelling.profile()))
    words = [text.text for text in svg.iter("text")]
    assert {"start", "1", "2"} <= set(words)
    assert len(list(svg.iter("circle"))) == 3


def test_a_page_that_is_closed_twice_is_closed(labelling):
    page = LabelPage(labelling)
    page.close()
    page.close()
    page.run(labelling.add_waypoint)
    assert not labelling.can_undo


def test_the_largest_gaussians_are_sent_with_covariances_in_the_world():
    splat = gaussians(60)
    T = np.eye(4)
    T[:3, :3] = 2.0 * rotation_matrix((0.9, 0.1, 0.3, -0.2))
    T[:3, 3] = (1.0, 2.0, 3.0)
    points = splat_points(splat, T, most=20)
    assert len(points.centers) == 20
    opacity = 1 / (1 + np.exp(-splat.opacity_logits))
    sizes = np.sort(np.exp(splat.log_scales), axis=1)
    least = np.sort(opacity * sizes[:, 1] * sizes[:, 2])[-20]
    kept = np.flatnonzero(opacity * sizes[:, 1] * sizes[:, 2] >= least)
    np.testing.assert_allclose(
        points.centers, splat.means[kept] @ T[:3, :3].T + T[:3, 3], rtol=1e-5
    )
    for i, covariance in zip(kept, points.covariances, strict=True):
        R = rotation_matrix(splat.quats[i].tolist())
        own = R @ np.diag(np.exp(2 * splat.log_scales[i].astype(float))) @ R.T
        np.testing.assert_allclose(covariance, T[:3, :3] @ own @ T[:3, :3].T, rtol=1e-4, atol=1e-7)


def test_names_stand_over_their_waypoints_also_after_all_were_taken_away(page, labelling):
    for _ in range(2):
        press(page, "Edit (N F X): remove")
    for x in (1.0, 4.0):
        click(page, x, 0.4)
    for i, point in enumerate(labelling.state.waypoints):
        name = page.server.scene.get_handle_by_name(f"/trail_name/{i}")
        assert name.text == str(i + 1)
        np.testing.assert_allclose(name.position[:2], point[:2])


def test_a_place_that_is_not_to_scale_asks_for_two_points_first(tmp_path):
    labelling = open_labelling(written_place(tmp_path / "place", scene=UNSCALED))
    with LabelPage(labelling) as page:
        assert "Not to scale" in page.controls.hints.content
        click(page, 2.2, 0.0)  # No key was pressed: clicks put markers.
        click(page, 2.8, 0.0)
        assert page.controls.place._distance.content == "The markers are **0.600 units** apart."
        page.controls.place._metres.value = 1.2
        press(page, "Scale the scene")
        assert labelling.state.placement.scale == pytest.approx(2.0)
        assert "Not to scale" not in page.controls.hints.content


def test_the_floor_is_clicked_and_flipped_and_a_unit_chosen(page, labelling):
    press(page, "Tilt x: left")
    press(page, "Three clicks on the floor (5)")
    for x, y in ((-1.0, -1.5), (-1.0, 1.5), (1.5, 1.5)):
        click(page, x, y)
    assert np.unique(labelling.mesh.vertices[:, 2].round(6)) == pytest.approx((-0.2, 0.0, 0.1))
    press(page, "Flip upside down")
    assert labelling.mesh.vertices[:, 2].max() == pytest.approx(0.2)
    press(page, "The scan's unit is: cm")
    assert labelling.mesh.vertices[:, 2].max() == pytest.approx(0.002)
