"""Cards as files: read, validated, and checked against the robot, every fault with its place."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from nw_eval.cards.card import Card
from nw_eval.cards.file.inputs import input_problems
from nw_eval.cards.file.joints import joint_problems
from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.files.yaml_file import (
    Location,
    YamlFile,
    YamlProblems,
    parse_yaml,
    read_yaml,
    validation_problems,
)

CARD_FILE = "policy.yaml"

# What other stacks call our keys.
_ALSO_CALLED = {
    "action_scale": "scale",
    "damping": "kd",
    "default_joint_angles": "default_pose",
    "default_joint_pos": "default_pose",
    "effort_limits": "torque_limits",
    "joint_names": "joints",
    "latency": "delay_steps",
    "stiffness": "kp",
}


def load_card(path: Path) -> Card:
    """Read a card.

    Raises:
        PolicyError: all problems of the file, one line each, with file, line and column.
    """
    try:
        return _card(read_yaml(path))
    except YamlProblems as error:
        raise PolicyError(error.problems) from None


def parse_card(text: str, *, file: str) -> Card:
    """Read the card of a text, such as the one that a log carries along.

    Args:
        text: what the card's file held.
        file: what errors call it.

    Raises:
        PolicyError: as `load_card`.
    """
    try:
        return _card(parse_yaml(text, file=file))
    except YamlProblems as error:
        raise PolicyError(error.problems) from None


def card_of(values: Mapping[str, Any]) -> Card:
    """Return the card of a mapping that says what a file would.

    Raises:
        PolicyError: all problems, one line each.
    """
    places = dict.fromkeys(_locations(values, ()), (1, 1))
    try:
        return _card(YamlFile(path="", data=dict(values), places=places))
    except PolicyError as error:
        name = f"card {clean(values.get('name', ''), at_most=60)!r}"
        raise PolicyError(
            f"{name}: {problem.message}{'' if problem.fix is None else f'; {problem.fix}'}"
            for problem in error.problems
        ) from None


def _card(file: YamlFile) -> Card:
    try:
        card = Card.model_validate(file.data)
    except ValidationError as error:
        problems = validation_problems(error, file, Card, also=_ALSO_CALLED)
        raise PolicyError(problems) from None
    problems = [*joint_problems(card, file), *input_problems(card, file)]
    if problems:
        problems.sort(key=lambda problem: (problem.line, problem.column))
        raise PolicyError(problems)
    return card


def _locations(value: Any, above: Location) -> Iterator[Location]:
    """Yield where everything lies in nested mappings and lists."""
    yield above
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, Mapping):
        items = cast("Mapping[Any, Any]", value).items()
    elif isinstance(value, list | tuple):
        items = enumerate(cast("Sequence[Any]", value))
    for key, item in items:
        yield from _locations(item, (*above, key))
