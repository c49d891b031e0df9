"""Which policies can be asked for by name."""

from __future__ import annotations

from pathlib import Path

from nw_eval.cards.file.load import CARD_FILE, load_card
from nw_eval.clean import clean
from nw_eval.errors import PolicyError
from nw_eval.shipped import available, shipped


def policy_table(search: Path | None = None) -> str:
    """Return a line for each shipped bundle, each of the project's, and each example card.

    A card with problems is listed with the first of them.

    Args:
        search: the project folder, by default the working directory.
    """
    cards = {name: folder / CARD_FILE for name, folder in available("policies", search).items()}
    examples = shipped("policies") / "examples"
    cards |= {f"examples/{path.parent.name}": path for path in examples.glob(f"*/{CARD_FILE}")}
    rows = [(clean(name), *_describe(path)) for name, path in sorted(cards.items())]
    if not rows:
        return "no policies: neither shipped, nor in ./policies"
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return "\n".join(
        f"{name:{widths[0]}}  {robot:{widths[1]}}  {adapter:{widths[2]}}  {title}".rstrip()
        for name, robot, adapter, title in rows
    )


def _describe(path: Path) -> tuple[str, str, str]:
    try:
        card = load_card(path)
    except PolicyError as error:
        return "?", "?", str(error).splitlines()[0]
    title = card.title
    if card.networks:
        title += f" (fed by {', '.join(card.networks)})"
    named = [network.checkpoint for network in card.networks.values()]
    for checkpoint in named if card.checkpoint is None else (card.checkpoint, *named):
        if not (path.parent / checkpoint.file).is_file():
            title += f" (weights: {checkpoint.source or 'not here'})"
            break
    return card.robot, card.adapter, title
