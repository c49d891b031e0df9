"""What the README tells a newcomer to type and to write is what the program takes."""

import re
from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper

from nw_eval import api
from nw_eval.cli.verbs import Verb
from nw_eval.errors import PolicyError
from nw_eval.policies import load_bundle, load_card
from nw_eval.sensors import check_bundle, check_card
from nw_eval.shipped import available

README = Path(__file__).parents[2] / "README.md"


def text():
    return README.read_text(encoding="utf-8")


def five_minutes():
    return text().split("## Your own checkpoint in five minutes")[1].split("\n## ")[0]


@pytest.fixture
def checkpoint(tmp_path):
    """A graph that takes 48 numbers and an image, where the README copies its checkpoint to."""
    inputs = {"obs": [1, 48], "image": [1, 3, 45, 80]}
    numbers = [helper.make_tensor_value_info(k, TensorProto.FLOAT, v) for k, v in inputs.items()]
    zeros = helper.make_tensor("zeros", TensorProto.FLOAT, [1, 12], [0.0] * 12)
    node = helper.make_node("Constant", [], ["actions"], value=zeros)
    actions = helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, 12])
    graph = helper.make_graph([node], "g", numbers, [actions])
    (tmp_path / "my-policy").mkdir()
    path = tmp_path / "my-policy" / "policy.onnx"
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(path))
    return path


def paste_card(folder):
    """Write the README's card as it stands there."""
    (block,) = re.findall(r"```yaml\n(.*?)```", text(), re.DOTALL)
    lines = [line.removeprefix("   ") for line in block.splitlines()]
    assert lines[0] == f"# {folder.name}/policy.yaml"
    (folder / "policy.yaml").write_text("\n".join(lines) + "\n")


def test_the_card_of_the_five_minutes_is_valid(tmp_path):
    folder = tmp_path / "my-policy"
    folder.mkdir()
    paste_card(folder)
    specs = {spec.name: spec.shape for spec in check_card(load_card(folder / "policy.yaml"))}
    # 5 x (3 + 3 + 3 + 12 + 12 + 12) numbers, and a picture with its channels first.
    assert specs == {"obs": (225,), "rgb": (3, 45, 80)}


def test_the_first_command_writes_a_card_with_the_digest_and_with_what_to_check(checkpoint):
    commands = re.findall(r"nw-eval (?:policies )?(\w+)", five_minutes())
    assert list(dict.fromkeys(commands))[:3] == ["init", "check", "run"]
    told = api.init_policy(checkpoint, robot="go1")
    assert "CHECK" in told.text
    assert load_bundle(checkpoint.parent).checkpoint_sha256 in told.text


def test_the_card_without_a_digest_is_told_the_one_to_add_and_then_what_does_not_fit(checkpoint):
    folder = checkpoint.parent
    paste_card(folder)
    with pytest.raises(PolicyError, match="`checkpoint` has no sha256") as told:
        load_bundle(folder)
    (line,) = re.findall(r"add `(sha256: \w{64})`", str(told.value))
    card = folder / "policy.yaml"
    card.write_text(
        card.read_text().replace("{file: policy.onnx}", f"{{file: policy.onnx, {line}}}")
    )
    (said,) = re.findall(r"error: my-policy/policy.yaml: (.*)", five_minutes())
    with pytest.raises(PolicyError) as told:
        check_bundle(load_bundle(folder))
    assert str(told.value) == f"{card}: {said}"


@pytest.mark.parametrize("page", ["README.md", "docs/policies.md", "docs/wrappers.md"])
def test_every_verb_that_a_page_names_exists(page):
    named = set(re.findall(r"nw-eval (\w+)", (README.parent / page).read_text(encoding="utf-8")))
    verbs = {part.__metadata__[0].name for part in Verb.__args__}
    assert named - {"rolls"} <= verbs, named - verbs


def test_every_suite_that_it_names_exists():
    suites = set(available("suites"))
    for suite in re.findall(r"nw-eval (?:run|check) ([a-z]+)\b", text()):
        assert suite in suites


def test_its_pictures_and_pages_are_there():
    for target in re.findall(r"\]\(([^)#]+)\)", text()):
        assert (README.parent / target).exists(), target
