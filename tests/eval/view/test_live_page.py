"""The live page: its buttons, called as viser calls them, on a server that runs."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from nw_base.errors import UsageError
from nw_eval.testing import FakeClock
from nw_eval.view import live_page
from nw_eval.view.live_page import open_live
from nw_eval.view.sources import kind_of

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    with open_live("go1-parkour", "hurdles/one_low_carpet", port=0) as page:
        page.folder = tmp_path_factory.mktemp("played")
        yield page


def wait(holds):
    end = time.monotonic() + 60.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def press(page, label, value=None):
    """Do what a person does with a button, a slider or a field."""
    handles = page.server.gui._gui_input_handle_from_uuid.values()
    (handle,) = [each for each in handles if each.label == label]
    if value is not None:
        handle._impl.value = value
    for callback in handle._impl.update_cb:
        callback(SimpleNamespace(client=None, client_id=0, target=handle))


def test_it_stands_still_until_it_is_told_to_go(page):
    assert page.url.startswith("http://127.0.0.1:")
    step = page._stage.trial.episode.step
    time.sleep(0.3)
    assert page._stage.trial.episode.step == step
    press(page, "One step")
    wait(lambda: page._stage.trial.episode.step == step + 1)


def test_it_walks_in_real_time_and_the_robot_is_where_it_is(page, monkeypatch):
    now = FakeClock()
    monkeypatch.setattr(live_page, "clock", SimpleNamespace(monotonic=now))
    press(page, "Start again")
    wait(lambda: page._stage.trial.episode.step == 0)
    press(page, "Play")
    for step in range(1, 26):
        wait(lambda step=step: page._stage.trial.episode.step >= step)
        assert page._stage.trial.episode.step == step
        now.advance(page._stage.trial.episode.world.control_period)
    press(page, "Pause")
    wait(lambda: not page.runs)
    page.act(lambda _: None)
    wait(lambda: np.allclose(page._bodies["trunk"].position, trunk_of(page)))


def trunk_of(page):
    return page._stage.trial.episode.world.trunk_position


def test_sliders_push_and_boxes_reach_the_stage(page):
    press(page, "payload, kg", 1.0)
    press(page, "payload, kg", 3.0)
    wait(lambda: page._stage.cell.get("payload") == 3.0)
    wait(lambda: "payload 3" in page.words)
    press(page, "To", "left")
    wait(lambda: page._stage.pushed == pytest.approx(0.5))
    press(page, "Drop a box")
    wait(lambda: len(page._boxes) == 1)
    np.testing.assert_allclose(page._boxes[0].position, page._stage.place.boxes[0].center)
    press(page, "No boxes")
    wait(lambda: not page._boxes)


def test_a_dragged_goal_is_where_it_was_dropped(page):
    page._goal.position = (2.0, 1.0, 0.0)
    for phase in ("start", "update", "end"):
        for callback in page._goal._impl_aux.update_cb:
            callback(SimpleNamespace(client=None, client_id=0, target=page._goal, phase=phase))
    wait(lambda: tuple(page._stage.trial.scene.trail[-1, :2]) == (2.0, 1.0))
    assert page._stage.place.goal == (2.0, 1.0)


def test_what_was_done_is_saved_once_and_said(page):
    folder = page.folder / "mine"
    press(page, "Folder", str(folder))
    press(page, "Save as a suite")
    wait(lambda: f"nw-eval run {folder}" in page.words)
    saved = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert folder / "suite.yaml" in saved
    press(page, "Save as a suite")
    wait(lambda: "is there already" in page.words)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == saved


def test_what_a_word_names_is_found_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nothing = {"policy": None, "scene": None}
    assert kind_of("hurdles/one_low_carpet", **nothing) == "scene"
    assert kind_of("hurdles/one_low_carpet~3", **nothing) == "scene"
    assert kind_of("go1-act-rgb", **nothing) == "policy"
    assert kind_of(None, policy="stand", scene=None) is None
    (tmp_path / "run.json").touch()
    assert kind_of(".", **nothing) == "log"
    for source, words, others in (
        (None, "nothing to view", nothing),
        ("no-such-thing", "no log, run, scene or policy", nothing),
        ("hub:org/name", "scene or a policy", nothing),
        (".", "what was logged", nothing | {"policy": "stand"}),
        ("go1-act-rgb", "name the same kind of thing", nothing | {"policy": "stand"}),
    ):
        with pytest.raises(UsageError, match=words):
            kind_of(source, **others)
