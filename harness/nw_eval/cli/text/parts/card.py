"""A card as a page: what the policy sees, what its actions mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.cli.text.table import aligned

if TYPE_CHECKING:
    from nw_eval.onboarding.probe.summary import CardFile, CardJoint, CardSummary, CardTerm


def card_page(summary: CardSummary) -> str:
    """Return what a card says: each term, each joint, whatever is not by default, its files."""
    card = summary.card
    terms = [("observation", "term", "numbers", "as", "sampled"), *map(_term, summary.terms)]
    motor = "torque limit", "armature", "friction loss"
    joints = [("joint", "default", "scale", "kp", "kd", *motor), *map(_joint, summary.joints)]
    lines = [
        f"{card.name}: {card.title}" if card.title else card.name,
        f"card        {clean(summary.path)}",
        f"licence     {card.licence or 'not stated'}",
        f"robot       {card.robot}",
        f"adapter     {card.adapter}",
        *_files(summary),
        f"command     {summary.command}",
        *(f"{key:10}  {clean(value)}" for key, value in summary.options.items()),
        "",
        *aligned(terms),
        *_observations(summary),
        "",
        *summary.inputs,
        *([""] if summary.inputs else []),
        f"actions: {', '.join(summary.action)}",
        *aligned(joints, right=range(1, 8)),
    ]
    return "\n".join(line.rstrip() for line in lines)


def _files(summary: CardSummary) -> list[str]:
    lines = [
        f"{'network' if file.network else 'checkpoint':10}  {clean(_file(file))}"
        for file in summary.files
    ]
    own = any(not file.network for file in summary.files)
    return lines if own else ["checkpoint  none", *lines]


def _file(file: CardFile) -> str:
    words = f"{file.network}: {file.file}" if file.network else file.file
    if file.problem is not None:
        return f"{words}: not usable: {file.problem}"
    if not file.sha256:
        return words
    words += f", {file.bytes / 1e6:.2f} MB, SHA-256 {file.sha256[:16]}"
    if file.network:
        return f"{words}, {file.adapter}, {file.rate} Hz"
    return f"{words}, not the card's {file.declared[:16]}" if file.declared else words


def _observations(summary: CardSummary) -> list[str]:
    lines: list[str] = []
    for observation in summary.observations:
        settings = f"; {', '.join(observation.settings)}" if observation.settings else ""
        lines.append(f"  {clean(f'{observation.reckoning}{settings}')}")
    return lines


def _term(term: CardTerm) -> tuple[str, ...]:
    size = f"{term.numbers}"
    if term.frames > 1:
        size += f" ({term.frames} frames)"
    elif len(term.shape) > 1:
        size = " x ".join(str(side) for side in term.shape)
    return term.observation, term.term, size, term.form, f"{term.rate} Hz"


def _joint(joint: CardJoint) -> tuple[str, ...]:
    numbers = joint.default, joint.scale, joint.kp, joint.kd
    motor = joint.torque_limit, joint.armature, joint.friction_loss
    return joint.joint, *("" if n is None else f"{n:zg}" for n in (*numbers, *motor))
