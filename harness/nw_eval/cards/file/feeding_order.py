"""Which network of a card is asked after which."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cards.networks import input_parts

if TYPE_CHECKING:
    from nw_eval.cards.card import Card


def feeding_order(card: Card) -> list[str]:
    """Return the networks of a card, each behind those that feed it.

    Those of a circle are left out, and those that one feeds.
    """
    order: list[str] = []
    waiting = dict(card.networks)
    while ready := [name for name in waiting if _fed_by(card, name) <= set(order)]:
        order += ready
        for name in ready:
            del waiting[name]
    return order


def way_back(card: Card, name: str) -> list[str] | None:
    """Return the way from a network over those that feed it to itself; None = there is none."""
    ways = [[name]]
    seen: set[str] = set()
    for way in ways:
        for other in sorted(_fed_by(card, way[-1])):
            if other == name:
                return [*way, name]
            if other not in seen:
                seen.add(other)
                ways.append([*way, other])
    return None


def _fed_by(card: Card, name: str) -> set[str]:
    """Return the networks that feed a network."""
    taken = {part for _, parts in input_parts(card.networks[name].inputs) for part in parts}
    return {
        other for other, network in card.networks.items() if taken & set(network.given_as(other))
    }
