"""Cards as files: read, validated, and checked against the robot, every fault with its place."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from nw_eval.cards.card import Card
from nw_eval.cards.file.inputs import input_problems
from nw_eval.cards.file.joints import joint_problems
from nw_eval.errors import PolicyError
from nw_eval.yaml_file import YamlProblems, read_yaml, validation_problems

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
        file = read_yaml(path)
    except YamlProblems as error:
        raise PolicyError(error.problems) from None
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
