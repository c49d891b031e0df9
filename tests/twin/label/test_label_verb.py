"""`nw-eval twin label` serves a page until a signal, and edits nothing that is not one's own."""

import signal
import urllib.request

import numpy as np
import pytest
from label_places import written_place

from nw_base.errors import StoreError, UsageError
from nw_eval import cli
from nw_eval.suite import load_suite
from nw_scenes.folder import load_folder
from nw_scenes.neverwhere import load_published
from nw_sim.catalogue import get_scene
from nw_splat.files import read_splat
from nw_twin.label import files
from nw_twin.label.labelling import open_labelling

pytest.importorskip("viser")


def test_the_page_is_there_until_ctrl_c_and_it_says_what_was_saved(label, tmp_path):
    folder = written_place(tmp_path / "place")

    def person(page):
        with urllib.request.urlopen(page.url) as answer:
            assert answer.status == 200
        page.run(lambda: page._labelling.nudge_waypoint(1, 0.5, 0.0))
        page.run(lambda: page.save(publishes=False))

    code, printed = label(folder, do=person)
    assert code == 0
    first, saved, last = printed.out.splitlines()
    assert first.startswith(f"label: {folder} is at http://127.0.0.1:")
    assert saved == (
        f"label: saved {folder / 'scene.yaml'}: stairs, 2 waypoints, start at 0.00, 0.00, 0.00"
    )
    assert last == f"label: next: nw-eval scenes check {folder}"
    assert load_folder(folder).trail[1, 0] == pytest.approx(5.0)


def test_what_was_changed_and_not_saved_is_said_at_the_end(label, tmp_path):
    folder = written_place(tmp_path / "place")

    def person(page):
        page.run(lambda: page.save(publishes=False))
        page.run(lambda: page._labelling.nudge_waypoint(1, 0.5, 0.0))

    code, printed = label(folder, do=person, number=signal.SIGTERM)
    assert code == 0
    assert "changed after the last save is not saved" in printed.out
    code, printed = label(folder)
    assert (code, printed.out.splitlines()[-1]) == (0, "label: nothing was saved")


@pytest.mark.parametrize(
    ("scene", "why"),
    [
        ("hurdles/two_logs_park", "built-in"),
        ("hurdles/two_logs_park~2", "built-in"),
        ("hub:org/corridor", "not a scene folder of your own"),
        ("neverwhere:hurdle_stata_v1", "not a scene folder of your own"),
    ],
)
def test_what_is_nobody_s_to_edit_is_labelled_as_a_copy(capsys, scene, why):
    with pytest.raises(SystemExit) as left:
        cli.main(["twin", "label", scene])
    assert left.value.code == 2
    words = capsys.readouterr().err
    assert why in words
    assert f"nw-eval twin label {scene} --out my-scene" in words


def test_a_folder_in_the_cache_is_not_edited(tmp_path, monkeypatch):
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path))
    folder = written_place(tmp_path / "hub" / "place")
    with pytest.raises(UsageError, match="in the cache"):
        files.own_folder(str(folder), None)
    assert files.own_folder(str(written_place(tmp_path.parent / "mine")), None)


def test_a_copy_of_a_built_in_place_is_the_same_to_feet(tmp_path):
    name = "hurdles/two_logs_park~2"
    original = get_scene(name)
    out = tmp_path / "park"
    files.copy_scene(name, out)
    copy = load_folder(out)
    assert copy.name == "park"
    assert copy.solids == original.solids
    assert (copy.ground.z, copy.spawn) == (original.ground.z, original.spawn)
    np.testing.assert_allclose(copy.trail, original.trail, atol=5e-5)
    written, baked = read_splat(copy.splat.path), read_splat(original.splat_store())
    np.testing.assert_array_equal(written.means, baked.means)
    assert load_suite(out / "suite.yaml").name == "park"
    labelling = open_labelling(out)
    labelling.nudge_waypoint(0, 0.1, 0.0)
    labelling.save()
    assert load_folder(out).trail[0, 0] == pytest.approx(original.trail[0, 0] + 0.1, abs=1e-4)


def test_a_copy_of_a_folder_is_its_files_and_a_suite(tmp_path):
    folder = written_place(tmp_path / "place")
    files.copy_scene(str(folder), tmp_path / "other")
    names = {path.name for path in (tmp_path / "other").iterdir()}
    assert names == {"scene.yaml", "collision.ply", "splat.ply", "suite.yaml"}
    for name in names - {"suite.yaml"}:
        assert (tmp_path / "other" / name).read_bytes() == (folder / name).read_bytes()
    with pytest.raises(UsageError, match="is there already"):
        files.copy_scene(str(folder), tmp_path / "other")


def test_a_copy_that_fails_leaves_nothing_behind(tmp_path, monkeypatch):
    folder = written_place(tmp_path / "place")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.shutil, "copyfile", full)
    with pytest.raises(StoreError, match="No space left"):
        files.copy_scene(str(folder), tmp_path / "copies" / "other")
    assert not (tmp_path / "copies").exists()


def test_a_copy_of_a_published_scene_is_its_mesh_trail_and_splat(tmp_path):
    pair = open_labelling(written_place(tmp_path / "place")).publish(tmp_path)
    files.copy_scene(f"neverwhere:{pair}", tmp_path / "mine")
    original, copy = load_published(pair), load_folder(tmp_path / "mine")
    assert (copy.name, copy.task) == ("mine", original.task)
    np.testing.assert_allclose(copy.trail, original.trail, atol=5e-5)
    np.testing.assert_allclose(
        copy.static_mesh.triangles, original.static_mesh.triangles, atol=1e-5
    )
    np.testing.assert_allclose(copy.T_world_splat, original.T_world_splat, atol=1e-9)
    assert len(read_splat(copy.splat.path)) == len(read_splat(original.splat.path))
    labelling = open_labelling(tmp_path / "mine")
    labelling.turn("z", 0.3)
    labelling.save()
