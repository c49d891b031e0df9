"""Whatever stands between a reference and its files is said in one line, with what to do."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hub_content import BOXES, SCENE
from hub_server import READER

from nw_base.errors import (
    FetchError,
    PolicyError,
    PrerequisiteError,
    SceneError,
    StoreError,
    UsageError,
)
from nw_eval import api
from nw_eval.cli import main
from nw_eval.testing import FakeClock
from nw_scenes.hub import client, limits
from nw_scenes.hub.reference import forget_checks
from nw_sim import catalogue


def line_of(error):
    """What an error says, which is one line."""
    text = str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    "text", ["hub:", "hub:lab", "hub:lab/a/b", "hub:../a", "hub:lab/a@", "hub:lab/a@../b",
             "hub:lab/.git", "hub:la--b/c", "hub:lab/a b", "hub:lab/a\n"]
)  # fmt: skip
def test_what_names_nothing_is_refused_before_anybody_is_asked(hub, text):
    with pytest.raises(SceneError, match="names nothing on a hub; write hub:org/name"):
        catalogue.references([text])
    assert not hub.calls


def test_a_repository_that_is_not_there(hub):
    with pytest.raises(SceneError) as error:
        api.fetch_scene("hub:lab/nothing")
    assert line_of(error) == (
        f"hub:lab/nothing: {hub.url} has no data set 'lab/nothing', or not for you; check the "
        "name; if it is private, set HF_TOKEN, or log in with `hf auth login`"
    )
    with pytest.raises(PolicyError, match="has no model 'lab/nothing'"):
        api.fetch_policy("hub:lab/nothing")


@pytest.mark.usefixtures("place")
def test_a_revision_that_is_not_there():
    with pytest.raises(SceneError, match="lab/corridor has no revision 'v9'; name a branch, a tag"):
        api.fetch_scene("hub:lab/corridor@v9")


def test_a_private_place_needs_a_token_and_opens_with_one(hub, monkeypatch):
    hub.add("datasets", "lab/secret", {"scene.yaml": SCENE, "collision.yaml": BOXES}, private=True)
    with pytest.raises(SceneError, match="or not for you; check the name; if it is private, set"):
        api.fetch_scene("hub:lab/secret")
    monkeypatch.setenv("HF_TOKEN", READER)
    assert api.fetch_scene("hub:lab/secret").files


@pytest.mark.usefixtures("place")
def test_a_token_that_nobody_knows(monkeypatch):
    monkeypatch.setenv("HF_TOKEN", "hf_stolen")
    with pytest.raises(SceneError, match=r"refuses its token \(401\); set HF_TOKEN"):
        api.fetch_scene("hub:lab/corridor")


def test_a_place_whose_owner_lets_in_only_some(hub):
    hub.add("datasets", "lab/gated", {"scene.yaml": SCENE}, gated=True)
    with pytest.raises(SceneError) as error:
        api.fetch_scene("hub:lab/gated")
    assert f"ask for it at {hub.url}/datasets/lab/gated, then set HF_TOKEN" in line_of(error)


@pytest.mark.usefixtures("place")
def test_a_token_is_not_told_to_where_large_files_lie(hub, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", READER)
    api.fetch_scene("hub:lab/corridor")
    assert {call.token for call in hub.calls if "/resolve/" in call.path} == {READER}
    assert {call.token for call in hub.calls if call.origin == "cdn"} == {None}


@pytest.mark.usefixtures("place")
def test_no_network(hub):
    hub.close()
    with pytest.raises(FetchError, match=rf"cannot reach {hub.url}: .*; check the network, proxy"):
        api.fetch_scene("hub:lab/corridor")


@pytest.mark.usefixtures("place")
def test_no_network_to_say_whether_what_is_kept_is_new(hub):
    fetched = api.fetch_scene("hub:lab/corridor")
    hub.close()
    with pytest.raises(FetchError, match=f"is revision {fetched.revision[:12]}, .* what runs use"):
        api.fetch_scene("hub:lab/corridor")
    assert api.fetch_scene(f"hub:lab/corridor@{fetched.revision}").folder == fetched.folder


@pytest.mark.usefixtures("place")
def test_a_hub_that_fails(hub):
    hub.status = 500
    with pytest.raises(FetchError, match=r"answers 500: .*; try again later"):
        api.fetch_scene("hub:lab/corridor")


@pytest.mark.usefixtures("place")
def test_a_page_of_somebody_else(hub):
    hub.status = 200
    with pytest.raises(FetchError, match="does not answer as a hub does"):
        api.fetch_scene("hub:lab/corridor")


def test_an_endpoint_that_is_no_address(monkeypatch):
    monkeypatch.setenv("HF_ENDPOINT", "my-mirror")
    with pytest.raises(UsageError, match="HF_ENDPOINT 'my-mirror' is not an address"):
        api.fetch_scene("hub:lab/corridor")


def test_no_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(PrerequisiteError, match=r"pip install 'nw-eval\[hub\]'"):
        api.fetch_scene("hub:lab/corridor")


@pytest.mark.usefixtures("place")
def test_what_is_kept_needs_no_extra_either(monkeypatch):
    api.fetch_scene("hub:lab/corridor")
    forget_checks()
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    assert catalogue.get_scene("hub:lab/corridor").name == "far/corridor"


@pytest.mark.usefixtures("place")
def test_a_user_who_forbids_the_network(hub, monkeypatch, capsys):
    # The client looks at the variable once, when it is imported.
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    with pytest.raises(SystemExit) as left:
        main(["scenes", "fetch", "hub:lab/corridor"])
    assert left.value.code == FetchError.exit_code
    (line,) = capsys.readouterr().err.splitlines()
    assert "HF_HUB_OFFLINE forbids the network; unset HF_HUB_OFFLINE" in line
    assert not hub.calls


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(
    ("announced", "words"),
    [
        ({"path": "../../../escaped"}, r"cannot be kept: it has `\.\.`"),
        ({"path": "/etc/passwd"}, "cannot be kept: it is an absolute path"),
        ({"path": "a\\b"}, "cannot be kept: it has a backslash"),
        ({"path": "x" * 300}, "longer than a file system allows"),
        ({"size": limits.BYTES + 1}, "over the limit of"),
        ({"size": -5}, "over the limit of"),
    ],
)
def test_names_and_sizes_of_strangers_are_checked_before_a_file_is_asked_for(
    hub, tmp_path, announced, words
):
    hub.announced["collision.yaml"] = announced
    with pytest.raises(SceneError, match=words) as error:
        api.fetch_scene("hub:lab/corridor")
    line_of(error)
    assert not hub.transfers()
    assert not [path for path in tmp_path.rglob("*") if "escaped" in path.name]


@pytest.mark.parametrize("oid", ["../../../../escaped", "", "A" * 40])
@pytest.mark.usefixtures("place")
def test_a_digest_is_one_before_a_file_is_called_by_it(hub, oid):
    hub.announced["collision.yaml"] = {"oid": oid}
    with pytest.raises(FetchError, match="does not answer as a hub does"):
        api.fetch_scene("hub:lab/corridor")
    assert not hub.transfers()


def test_too_many_files(hub):
    hub.add("datasets", "lab/heap", {f"{n}.txt": b"" for n in range(limits.FILES + 1)})
    with pytest.raises(SceneError, match="more than 1000 files"):
        api.fetch_scene("hub:lab/heap")
    assert not hub.transfers()


def test_a_link_of_git_is_a_file_that_holds_where_it_led(hub):
    """Its entry in the listing is one of a file; Git keeps the target as content."""
    hub.add("models", "lab/link", {"policy.yaml": b"/etc/passwd"})
    fetched = api.fetch_policy("hub:lab/link")
    assert not (fetched.folder / "policy.yaml").is_symlink()


@pytest.mark.usefixtures("place")
def test_no_room(monkeypatch):
    class Usage:
        free = 1000

    monkeypatch.setattr("shutil.disk_usage", lambda _: Usage)
    with pytest.raises(StoreError, match=r"needs 2 MB, and \S+ has room for 1 kB; free space"):
        api.fetch_scene("hub:lab/corridor")


@pytest.mark.usefixtures("place")
def test_a_cache_that_cannot_be_written(tmp_path):
    Path(tmp_path / "cache").write_text("a file")
    with pytest.raises(StoreError, match="cannot write"):
        api.fetch_scene("hub:lab/corridor")


def test_a_pinned_commit_is_the_one_that_the_hub_gives(place):
    (first,) = place.commits
    place.revisions[first] = newer = place.commit({"collision.yaml": b"boxes: []\n"})
    with pytest.raises(SceneError, match=f"gives commit {newer} for it; write the commit") as error:
        api.fetch_scene(f"hub:lab/corridor@{first}")
    line_of(error)
    assert not api.fetch_scene("hub:lab/corridor").files.keys() ^ {
        *("scene.yaml", "collision.yaml", "notes/large.bin")
    }


def test_the_beginning_of_a_commit_is_one_too(place):
    (first,) = place.commits
    place.revisions[first[:10]] = first
    assert api.fetch_scene(f"hub:lab/corridor@{first[:10]}").revision == first
    other = f"{int(first[0], 16) ^ 1:x}{first[1:10]}"
    place.revisions[other] = first
    with pytest.raises(SceneError, match=f"gives commit {first} for it"):
        api.fetch_scene(f"hub:lab/corridor@{other}")


@pytest.mark.usefixtures("place")
def test_files_of_another_commit_are_not_taken(hub):
    hub.says_commit = "c" * 40
    with pytest.raises(
        FetchError, match=rf"gives \S+ of commit {'c' * 40}, not of [0-9a-f]+; check"
    ):
        api.fetch_scene("hub:lab/corridor")
    hub.says_commit = None
    assert api.fetch_scene("hub:lab/corridor").files


@pytest.mark.usefixtures("place")
def test_an_answer_that_is_larger_than_any_is_not_read_to_its_end(hub):
    hub.padding = limits.JSON + 1
    with pytest.raises(FetchError, match="an answer has over 16 MiB") as error:
        api.fetch_scene("hub:lab/corridor")
    line_of(error)


@pytest.mark.usefixtures("place")
def test_a_listing_without_an_end(hub):
    hub.page = 0
    with pytest.raises(FetchError, match="its listing has over 64 pages"):
        api.fetch_scene("hub:lab/corridor")


@pytest.mark.parametrize(
    ("what", "seconds", "tick", "words"),
    [
        ("headers", 0.6, 0.0, "no answer came within 1 s"),
        ("json", 20.0, 1.0, "it takes over 20 s"),
        ("files", 20.0, 1.0, "it takes over 20 s"),
    ],
)
@pytest.mark.usefixtures("place")
def test_what_comes_byte_by_byte_is_given_up_in_time(hub, monkeypatch, what, seconds, tick, words):
    # Each look at the clock, at every byte that comes, moves it on, and nothing else does.
    monkeypatch.setattr(client, "time", SimpleNamespace(monotonic=FakeClock(tick)))
    monkeypatch.setattr(limits, "SECONDS", seconds)
    monkeypatch.setattr(limits, "SLOWEST", 10**9)
    hub.drips = what
    with pytest.raises(FetchError, match=f"cannot fetch all from {hub.url}: {words}") as error:
        api.fetch_scene("hub:lab/corridor")
    line_of(error)
