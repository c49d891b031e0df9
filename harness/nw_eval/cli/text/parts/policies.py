"""Policies that can be asked for by name, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from nw_eval.clean import clean
from nw_eval.cli.text.table import aligned

if TYPE_CHECKING:
    from nw_eval.cards.file.listing import ListedPolicy


def policy_table(policies: Sequence[ListedPolicy]) -> str:
    """Return a line for each policy: name, robot, adapter, title; or what is wrong."""
    if not policies:
        return "no policies: neither shipped, nor in ./policies"
    return "\n".join(aligned([(clean(each.name), *_words(each)) for each in policies]))


def _words(policy: ListedPolicy) -> tuple[str, str, str]:
    if policy.problem is not None:
        return "?", "?", policy.problem
    title = policy.title
    if policy.networks:
        title += f" (fed by {', '.join(policy.networks)})"
    if policy.missing is not None:
        title += f" (weights: {policy.missing or 'not here'})"
    return policy.robot, policy.adapter, title
