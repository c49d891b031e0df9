"""A policy that is an object of Python's: for evaluation in the process that trains it."""

from __future__ import annotations

from nw_eval.cards.card import Card
from nw_eval.errors import PolicyError
from nw_eval.policies.bundle import NO_FILE, Bundle


def was_instance(reference: str) -> bool:
    """Whether a bundle's `reference` is that of an object: nobody can load it."""
    return reference.startswith(NO_FILE)


def instance_bundle(policy: object, card: Card, *, digest: str = "") -> Bundle:
    """Return the bundle of a policy that the caller has at hand.

    It runs only in this process (`engine.in_process`), all trials with the same object,
    which is never closed. It must have `act(observation) -> 12 numbers`, or be a function that does
    that. Whatever else of `Policy` it has is used, as for a `python:` adapter: a trial depends on
    those before it unless `reset(seed)` forgets them, or there is nothing to forget.

    Args:
        policy: the object or function.
        card: what it sees and what its actions mean; its adapter is `python:module:Class`, for the
            record, and it names no files.
        digest: what tells this policy from others, such as the hex SHA-256 of its weights; empty =
            nobody knows, and its rows say so.

    Raises:
        PolicyError: the card is of another kind of policy.
    """
    named = {"checkpoint": card.checkpoint is not None, "networks": bool(card.networks)}
    if not card.adapter.startswith("python:"):
        raise PolicyError(
            f"card {card.name!r}: adapter {card.adapter!r} opens files, the policy is an object",
            fix="write `python:module:Class`, where its class comes from",
        )
    for key, is_there in named.items():
        if is_there:
            raise PolicyError(
                f"card {card.name!r} names `{key}`, the policy is an object",
                fix=f"remove `{key}`",
            )
    return Bundle(
        card=card, card_path=None, checkpoint=None, checkpoint_sha256=digest, instance=policy
    )
