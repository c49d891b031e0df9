"""Which policies can be asked for by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nw_eval.cards.file.load import CARD_FILE, load_card
from nw_eval.errors import PolicyError
from nw_eval.files.shipped import available, shipped


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
    try:
        card = load_card(path)
    except PolicyError as error:
        return ListedPolicy(name=name, card=path, problem=str(error).splitlines()[0])
    named = [network.checkpoint for network in card.networks.values()]
    weights = named if card.checkpoint is None else [card.checkpoint, *named]
    absent = [file for file in weights if not (path.parent / file.file).is_file()]
    return ListedPolicy(
        name=name,
        card=path,
        robot=card.robot,
        adapter=card.adapter,
        title=card.title,
        networks=tuple(card.networks),
        missing=(absent[0].source or "") if absent else None,
    )
