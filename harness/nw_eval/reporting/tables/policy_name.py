"""What a policy is called: its folder's name, and a digest of its card and checkpoint."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING

from nw_base.digest import digest_of

if TYPE_CHECKING:
    from nw_gate.results.provenance import PolicyInfo

_DIGITS = 8


def policy_name(policy: PolicyInfo) -> str:
    """Return the name of a policy's folder; the card's own name for a fetched one or an object."""
    card = PurePath(policy.card)
    if policy.fetched is not None or not card.parent.name:
        return policy.name
    return card.parent.name if card.name == "policy.yaml" else card.stem


def policy_digest(policy: PolicyInfo) -> str:
    """Return eight hex digits that tell cards and checkpoints of one name apart."""
    return digest_of([policy.card_digest, policy.checkpoint_digest])[:_DIGITS]
