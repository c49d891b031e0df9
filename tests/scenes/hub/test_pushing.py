"""A scene folder goes to a hub in one commit, and comes back as it was."""

from __future__ import annotations

import pytest
from hub_content import BOXES, SCENE
from hub_server import LARGE, READER, WRITER

from nw_base.errors import FetchError, SceneError, UsageError
from nw_eval import api
from nw_sim import catalogue


@pytest.fixture
def folder(tmp_path):
    """A scene of boxes with a splat that is large to the hub, and files that are nobody's."""
    import numpy as np

    place = tmp_path / "mine"
    place.mkdir()
    count = LARGE // 32 + 500
    layout = [("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)]
    splat = np.zeros(count, layout)
    splat["xyz"] = np.random.default_rng(3).uniform((-1, -1, 0), (3, 1, 0.05), (count, 3))
    splat["scale"] = (0.06, 0.06, 0.01)
    splat["rgba"], splat["quat"] = 255, (255, 128, 128, 128)
    splat.tofile(place / "splat.splat")
    (place / "scene.yaml").write_bytes(SCENE + b"splat: splat.splat\n")
    (place / "collision.yaml").write_bytes(BOXES)
    (place / "LICENSE").write_text("MIT\n")
    (place / "photos").mkdir()
    (place / "photos" / "me.jpg").write_bytes(b"private")
    (place / ".env").write_text("HF_TOKEN=x")
    return place


@pytest.fixture
def writer(hub, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", WRITER)
    return hub


PUSHED = ("LICENSE", "collision.yaml", "scene.yaml", "splat.splat")


def test_what_is_pushed_is_what_the_scene_is_made_of_and_comes_back(writer, folder):
    pushed = api.push_scene(folder, "hub:lab/mine")
    repository = writer.repositories["datasets", "lab/mine"]
    (commit,) = repository.commits
    assert pushed.reference == f"hub:lab/mine@{commit}"
    assert pushed.files == PUSHED
    assert repository.commits[commit] == {name: (folder / name).read_bytes() for name in PUSHED}
    assert not repository.private
    assert [call.path for call in writer.calls if call.method == "PUT"]  # The splat is large.
    assert catalogue.get_scene(pushed.reference).digest == catalogue.get_scene(folder).digest


@pytest.mark.usefixtures("writer")
def test_a_second_push_is_a_second_revision(folder):
    first = api.push_scene(folder, "hub:lab/mine")
    fetched = api.fetch_scene("hub:lab/mine")
    (folder / "collision.yaml").write_bytes(BOXES.replace(b"0.025", b"0.030"))
    second = api.push_scene(folder, "hub:lab/mine")
    assert first.reference != second.reference
    assert api.fetch_scene("hub:lab/mine").revision != fetched.revision


def test_a_place_may_be_for_its_owner_alone(writer, folder):
    api.push_scene(folder, "hub:lab/mine", private=True)
    assert writer.repositories["datasets", "lab/mine"].private


def test_nobody_pushes_without_a_token(hub, folder):
    with pytest.raises(
        SceneError, match="does not accept uploads without a login; set HF_TOKEN to a"
    ):
        api.push_scene(folder, "hub:lab/mine")
    assert not hub.calls


def test_a_token_that_may_only_read_does_not_write(hub, folder, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", READER)
    with pytest.raises(SceneError, match=r"refuses its token \(403\)|has no data set 'lab/mine'"):
        api.push_scene(folder, "hub:lab/mine")
    assert not hub.repositories


def test_a_scene_with_errors_stays_at_home(writer, folder):
    with (folder / "scene.yaml").open("ab") as file:
        file.write(b"T_world_splat: {translation: [500, 0, 0]}\n")
    with pytest.raises(SceneError, match="is not pushed as it is:\n"):
        api.push_scene(folder, "hub:lab/mine")
    assert not writer.repositories


@pytest.mark.usefixtures("writer")
def test_no_link_takes_a_file_of_elsewhere_along(folder, tmp_path):
    (tmp_path / "secret").write_text("secret")
    (folder / "README.md").symlink_to(tmp_path / "secret")
    (folder / "splat.splat").unlink()
    (folder / "splat.splat").symlink_to(tmp_path / "secret")
    with pytest.raises(SceneError, match="leaves the scene's folder"):
        api.push_scene(folder, "hub:lab/mine")
    (folder / "scene.yaml").write_bytes(SCENE)
    assert "README.md" not in api.push_scene(folder, "hub:lab/mine").files


def test_a_push_makes_a_revision_and_names_none(writer, folder):
    with pytest.raises(UsageError, match="a push makes a new revision of main; write hub:lab/mine"):
        api.push_scene(folder, "hub:lab/mine@v1")
    assert not writer.calls


def test_a_hub_that_goes_away_changes_nothing(writer, folder):
    writer.close()
    with pytest.raises(FetchError, match="cannot reach"):
        api.push_scene(folder, "hub:lab/mine")


@pytest.mark.usefixtures("writer")
def test_a_folder_that_is_no_scene(tmp_path):
    with pytest.raises(SceneError, match=r"scene\.yaml"):
        api.push_scene(tmp_path, "hub:lab/mine")
