"""Cards as files: read, validated, and checked against the robot; which there are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from nw_eval.cards.card import Card
from nw_eval.cards.problems import UNKNOWN_ROBOT, input_problems, joint_problems
from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.files.shipped import available, shipped
from nw_eval.files.yaml_file import (
    Location,
    YamlFile,
    YamlProblems,
    json_schema_of,
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


@dataclass(frozen=True, kw_only=True)
class ListedPolicy:
    """A policy that can be asked for by name, as far as its card can be read."""

    name: str
    card: Path
    robot: str = ""
    adapter: str = ""
    title: str = ""
    networks: tuple[str, ...] = ()
    """What feeds the checkpoint, by name."""
    missing: str | None = None
    """Where people get the weights that are not here; empty if the card does not say; None if all
    of them are here."""
    problem: str | None = None
    """The first of what is wrong with the card; then nothing else of it is known."""


def list_cards(search: Path | None = None) -> tuple[ListedPolicy, ...]:
    """Return the shipped bundles, those of the project, and the example cards, by name.

    Args:
        search: the project folder, by default the working directory.
    """
    cards = {name: folder / CARD_FILE for name, folder in available("policies", search).items()}
    examples = shipped("policies") / "examples"
    cards |= {f"examples/{path.parent.name}": path for path in examples.glob(f"*/{CARD_FILE}")}
    return tuple(_listed(name, path) for name, path in sorted(cards.items()))


def _listed(name: str, path: Path) -> ListedPolicy:
    elsewhere = ""
    try:
        card = load_card(path)
    except PolicyError as error:
        faults = [each.message for each in error.problems]
        if not faults or not all(each.startswith(UNKNOWN_ROBOT) for each in faults):
            return ListedPolicy(name=name, card=path, problem=str(error).splitlines()[0])
        # A card of a robot that lies elsewhere says all the rest.
        card, elsewhere = Card.model_validate(read_yaml(path).data), " (robot: not here)"
    named = [network.checkpoint for network in card.networks.values()]
    weights = named if card.checkpoint is None else [card.checkpoint, *named]
    absent = [file for file in weights if not (path.parent / file.file).is_file()]
    return ListedPolicy(
        name=name,
        card=path,
        robot=card.robot,
        adapter=card.adapter,
        title=f"{card.title}{elsewhere}",
        networks=tuple(card.networks),
        missing=(absent[0].source or "") if absent else None,
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a policy card."""
    return json_schema_of(Card)
