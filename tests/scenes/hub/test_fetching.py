"""What is fetched from a hub is kept by its commit, needs no network then, and says which it is."""

from __future__ import annotations

import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hub_content import CARD

from nw_base.errors import PolicyError, SceneError
from nw_eval import api
from nw_policies import load_bundle
from nw_scenes.hub import heard_by
from nw_scenes.hub.fetch import located
from nw_scenes.hub.reference import forget_checks, parse
from nw_sim import catalogue


def names(folder):
    return sorted(path.relative_to(folder).as_posix() for path in Path(folder).rglob("*.*"))


def test_a_place_is_fetched_as_it_is_with_a_digest_of_each_file(place, ears):
    fetched = api.fetch_scene("hub:lab/corridor", listener=ears)
    (commit,) = place.commits
    assert (fetched.revision, fetched.folder.parent.name) == (commit, commit)
    # What is for Git stays there.
    assert names(fetched.folder) == ["collision.yaml", "notes/large.bin", "scene.yaml"]
    for name, digest in fetched.files.items():
        content = (fetched.folder / name).read_bytes()
        assert content == place.commits[commit][name]
        assert digest == hashlib.sha256(content).hexdigest()
    assert fetched.bytes == sum(len(place.commits[commit][name]) for name in fetched.files)
    assert catalogue.get_scene("hub:lab/corridor").name == "far/corridor"
    assert not api.check_scenes(["hub:lab/corridor"])[0].findings


@pytest.mark.usefixtures("place")
def test_how_far_it_is_is_heard_in_bytes(ears):
    api.fetch_scene("hub:lab/corridor", listener=ears)
    large = [(done, total) for name, done, total in ears.heard if name == "notes/large.bin"]
    assert large == sorted(large)
    assert len(large) > 3
    assert large[-1] == (2_000_000, 2_000_000)
    assert "3 files, 2 MB" in ears.messages[0]


@pytest.mark.usefixtures("place")
def test_what_was_fetched_needs_no_network_and_says_which_revision_it_is(hub, ears):
    fetched = api.fetch_scene("hub:lab/corridor")
    hub.close()
    with heard_by(ears):
        assert catalogue.references(["hub:lab/corridor"]) == ((str(fetched.folder), "terrain"),)
    assert f"revision {fetched.revision[:12]}" in ears.messages[0]
    assert catalogue.get_scene(f"hub:lab/corridor@{fetched.revision}").name == "far/corridor"


def test_a_name_stays_at_its_commit_until_it_is_fetched_again(hub, place):
    first = api.fetch_scene("hub:lab/corridor")
    newer = place.commit({"scene.yaml": b"# moved\n" + place.commits[first.revision]["scene.yaml"]})
    assert catalogue.references(["hub:lab/corridor"])[0][0] == str(first.folder)
    hub.calls.clear()
    second = api.fetch_scene("hub:lab/corridor")
    assert second.revision == newer
    assert catalogue.references(["hub:lab/corridor"])[0][0] == str(second.folder)
    # The earlier one is still there for whoever names it, and what had not changed was not fetched.
    assert catalogue.references([f"hub:lab/corridor@{first.revision}"])[0][0] == str(first.folder)
    assert not [call for call in hub.transfers() if "large" in call.path or call.origin == "cdn"]
    large = "notes/large.bin"
    assert (second.folder / large).read_bytes() == place.commits[newer][large]


def test_a_tag_names_its_own_revision(place):
    (first,) = place.commits
    place.revisions["v1"] = first
    newer = place.commit({"collision.yaml": b"boxes: []\n"})
    assert api.fetch_scene("hub:lab/corridor@v1").revision == first
    assert api.fetch_scene("hub:lab/corridor").revision == newer


@pytest.mark.usefixtures("place")
def test_an_entry_of_a_suite_and_a_glob_beside_it_are_found():
    found = catalogue.references(["hub:lab/corridor", "triangles:hub:lab/corridor", "hurdles/*"])
    assert found[0][0] == found[1][0]
    assert (found[0][1], found[1][1]) == ("terrain", "triangles")
    assert len(found) == 18


def test_a_policy_is_fetched_when_it_is_asked_for(hub, policy):
    bundle = load_bundle("hub:lab/still")
    hub.close()
    assert bundle.name == "still"
    assert load_bundle("hub:lab/still").digest == bundle.digest
    (commit,) = policy.commits
    assert commit in bundle.reference


def test_the_code_of_a_policy_is_fetched_and_does_not_run_without_leave(hub, tmp_path):
    witness = tmp_path / "ran"
    code = f"open({str(witness)!r}, 'w').close()\nclass Bad:\n    pass\n".encode()
    card = CARD.replace(b"zero", b"python:bad:Bad")
    card += b"observations: {proprio: {sensor: proprio, layout: parkour53}}\n"
    hub.add("models", "lab/bad", {"policy.yaml": card, "bad.py": code})
    with pytest.raises(PolicyError, match="allow-code"):
        api.check("smoke", policy="hub:lab/bad")
    assert (api.fetch_policy("hub:lab/bad").folder / "bad.py").read_bytes() == code
    assert not witness.exists()


def test_a_file_that_was_changed_on_disk_is_not_used(hub, place):
    fetched = api.fetch_scene("hub:lab/corridor")
    (fetched.folder / "collision.yaml").write_text("boxes: []\n")
    forget_checks()  # Another process.
    place.commit({"scene.yaml": b"another place"})
    hub.calls.clear()
    again = catalogue.get_scene("hub:lab/corridor")
    assert len(again.solids) == 1  # Fetched anew, at the revision that it was.
    assert hub.transfers()


@pytest.mark.usefixtures("place")
def test_a_list_that_names_files_elsewhere_is_not_believed():
    fetched = api.fetch_scene("hub:lab/corridor")
    path = fetched.folder.with_name("corridor.json")
    values = json.loads(path.read_text())
    for files in ({"../../x": "0" * 64}, ["scene.yaml"], {"scene.yaml": 1}):
        forget_checks()
        path.write_text(json.dumps(values | {"files": files}))
        assert api.fetch_scene("hub:lab/corridor").files == fetched.files


def test_what_lies_in_pages_is_all_fetched(hub):
    files = {f"{n:02}.txt": bytes([n]) for n in range(7)}
    hub.add("datasets", "lab/many", files)
    hub.page = 3
    with pytest.raises(SceneError, match=r"hub:lab/many: its revision \w{12} has no scene.yaml"):
        api.fetch_scene("hub:lab/many")
    assert sorted(located(parse("hub:lab/many", "scene")).files) == sorted(files)


def test_two_files_of_the_same_bytes_are_two_files(hub):
    hub.add("models", "lab/twice", {"policy.yaml": b"x", "a/__init__.py": b"", "b.py": b""})
    fetched = api.fetch_policy("hub:lab/twice")
    assert names(fetched.folder) == ["a/__init__.py", "b.py", "policy.yaml"]


def test_what_two_ask_for_at_once_is_fetched_once(hub, place):
    with ThreadPoolExecutor(2) as both:
        found = list(both.map(api.fetch_scene, ["hub:lab/corridor"] * 2))
    assert found[0].folder == found[1].folder
    assert found[0].revision == place.revisions["main"]
    assert len([call for call in hub.calls if call.origin == "cdn"]) == 1
