"""What the README tells a newcomer to type and to write is what the program takes."""

import re
from pathlib import Path

from nw_eval.cli import Verb
from nw_eval.policies import load_card
from nw_eval.sensors import check_card
from nw_eval.shipped import available

README = Path(__file__).parents[2] / "README.md"


def text():
    return README.read_text(encoding="utf-8")


def test_the_card_of_the_five_minutes_is_valid(tmp_path):
    (block,) = re.findall(r"```yaml\n(.*?)```", text(), re.DOTALL)
    lines = [line.removeprefix("   ") for line in block.splitlines()]
    card = "\n".join(lines).replace("386cde6a...", "a" * 64)
    (tmp_path / "policy.yaml").write_text(card)
    specs = {spec.name: spec.shape for spec in check_card(load_card(tmp_path / "policy.yaml"))}
    # 5 x (3 + 3 + 3 + 12 + 12 + 12) numbers, and a picture with its channels first.
    assert specs == {"obs": (225,), "rgb": (3, 45, 80)}


def test_every_verb_and_suite_that_it_names_exists():
    named = set(re.findall(r"nw-eval (\w+)", text()))
    verbs = {part.__metadata__[0].name for part in Verb.__args__}
    assert named - {"rolls"} <= verbs, named - verbs
    suites = set(available("suites"))
    for suite in re.findall(r"nw-eval (?:run|check) ([a-z]+)\b", text()):
        assert suite in suites


def test_its_pictures_and_pages_are_there():
    for target in re.findall(r"\]\(([^)#]+)\)", text()):
        assert (README.parent / target).exists(), target
