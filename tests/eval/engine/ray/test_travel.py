"""What travels to a node is known by its content, and checked where it arrives."""

import shutil
from pathlib import Path

import pytest

from nw_base.errors import StoreError, UsageError
from nw_eval.engine import ray_file_bundles
from nw_eval.engine.plan import Plan
from nw_eval.engine.ray_file_bundles import Outgoing
from nw_eval.engine.ray_node import LibraryHere
from nw_eval.engine.ray_workers import _differences
from nw_eval.suite.model import new_suite
from nw_gate.results.request import Request
from nw_policies import load_bundle
from nw_sim.catalogue import FoundScene

SHIPPED = Path(__file__).parents[4] / "policies"

SCENE = """\
nw-scene: 1
name: mine/step
task: hurdles
licence: MIT
trail: [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
collision: steps.yaml
"""
BOXES = "boxes:\n  - {center: [1.0, 0.0, 0.05], half_size: [0.2, 1.0, 0.05]}\n"


@pytest.fixture
def node(tmp_path, monkeypatch):
    """Make the cache that of a node that has nothing yet."""
    monkeypatch.setenv("NW_EVAL_CACHE", str(tmp_path / "node"))
    return tmp_path / "node"


@pytest.fixture
def scene(tmp_path):
    folder = tmp_path / "places" / "step"
    folder.mkdir(parents=True)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "steps.yaml").write_text(BOXES)
    (folder / "notes.txt").write_text("of no use to a trial")
    return folder


def plan_of(policy, *scenes, checkpoint=None):
    suite = {
        "nw-eval": 1,
        "name": "tiny",
        "robot": "go1",
        "policy": "p",
        "trials": 1,
        "seed": 7,
        "scenes": ["flat/carpet_room"],
        "record": "none",
    }
    return Plan(
        request=Request(checkpoint=checkpoint),
        suite=new_suite(suite),
        bundle=load_bundle(policy, checkpoint=checkpoint),
        found=tuple(FoundScene.at(str(scene)) for scene in scenes),
        trials=(),
    )


def send(outgoing):
    """Receive what is missing; return the names of the files that were fetched."""
    fetched = []

    def fetch(sha256):
        fetched.append(outgoing.sources[sha256].name)
        return [outgoing.sources[sha256].read_bytes()]

    ray_file_bundles.receive(outgoing.file_bundles, fetch)
    return fetched


def test_scene_and_policy_open_on_a_node_under_the_references_of_the_head(node, scene):
    plan = plan_of(SHIPPED / "go1-parkour", scene, "flat/carpet_room")
    outgoing = Outgoing(plan)

    fetched = send(outgoing)

    places = ray_file_bundles.places(outgoing.file_bundles)
    assert {"scene.yaml", "steps.yaml", "policy.yaml"} < set(fetched)
    assert "notes.txt" not in fetched
    assert all(Path(place).is_relative_to(node / "received") for place in places.values())
    library = LibraryHere(places)
    for found in plan.found:
        assert library.scene(found.reference).digest == found.scene.digest
    assert library.bundle(plan.bundle.reference, None).digest == plan.bundle.digest


@pytest.mark.usefixtures("node")
def test_what_a_node_has_does_not_travel_again(scene):
    outgoing = Outgoing(plan_of("stand", scene))
    send(outgoing)
    assert ray_file_bundles.missing(outgoing.file_bundles) == ()
    assert send(outgoing) == []


def test_a_damaged_file_is_fetched_again(node, scene):
    outgoing = Outgoing(plan_of("stand", scene))
    send(outgoing)
    (kept,) = node.rglob("steps.yaml")
    kept.write_text(BOXES.replace("0.2", "0.3"))

    assert len(ray_file_bundles.missing(outgoing.file_bundles)) == 1
    assert "steps.yaml" in send(outgoing)

    (kept,) = node.rglob("steps.yaml")
    assert kept.read_text() == BOXES


@pytest.mark.parametrize("pieces", [[], [b"other"], [b"x" * 10**6] * 3])
def test_what_is_not_what_was_announced_is_not_kept(pieces, node, scene):
    outgoing = Outgoing(plan_of("stand", scene))
    with pytest.raises(StoreError, match="was announced"):
        ray_file_bundles.receive(outgoing.file_bundles, lambda _: pieces)
    assert [path.name for path in (node / "received").iterdir()] == [".lock"]


def test_weights_of_the_callers_own_travel_in_place_of_the_cards(node, tmp_path):
    (own,) = (SHIPPED / "go1-parkour").glob("*.onnx")
    shutil.copy(own, tmp_path / "other.onnx")
    plan = plan_of("go1-parkour", checkpoint=tmp_path / "other.onnx")
    outgoing = Outgoing(plan)
    send(outgoing)

    library = LibraryHere(ray_file_bundles.places(outgoing.file_bundles))

    bundle = library.bundle(plan.bundle.reference, tmp_path / "other.onnx")
    assert bundle.checkpoint is not None
    assert bundle.checkpoint.is_relative_to(node)
    assert bundle.checkpoint_digest == plan.bundle.checkpoint_digest


@pytest.mark.usefixtures("node")
def test_code_travels_with_all_that_lies_beside_it_but_not_through_a_link(tmp_path):
    folder = tmp_path / "mine"
    (folder / "tables").mkdir(parents=True)
    (folder / "policy.yaml").write_text(
        "nw-policy: 1\nname: mine\nrobot: go1\nadapter: python:mine:Policy\n"
        "control: {action: joint_position_offset, scale: 0.25}\n"
        "observations: {proprio: {sensor: proprio, layout: parkour53}}\n"
    )
    (folder / "mine.py").write_text("class Policy: ...\n")
    (folder / "tables" / "gains.json").write_text("{}")
    plan = plan_of(folder)
    outgoing = Outgoing(plan)
    assert set(send(outgoing)) == {"policy.yaml", "mine.py", "gains.json"}
    library = LibraryHere(ray_file_bundles.places(outgoing.file_bundles))
    assert library.bundle(plan.bundle.reference, None).code_sha256 == plan.bundle.code_sha256

    (folder / "more.py").symlink_to("mine.py")
    with pytest.raises(UsageError, match="a link, and code that has links does not travel"):
        Outgoing(plan_of(folder))


def test_a_node_that_differs_is_told_apart_by_what_differs():
    ours = {"mujoco": "4.0.0", "cpu": "znver4 1f0c77a2", "code": "abc"}
    assert not _differences(dict(ours), ours)
    assert _differences(ours | {"mujoco": "4.1.0"}, ours) == "mujoco 4.1.0, here 4.0.0"
    assert _differences({"cpu": ours["cpu"], "code": "abc"}, ours) == "mujoco none, here 4.0.0"
