"""Policies: cards, bundles, checkpoints of several formats, and what their actions mean.

A card and its checkpoint make a `Bundle`; `open_policy` makes a `Policy` of it, which turns
observations into raw actions; `JointControl` turns those into joint targets.
"""

from nw_eval.policies.action_filter import ActionFilter
from nw_eval.policies.adapters import open_policy
from nw_eval.policies.bundle import Bundle, find_card, load_bundle
from nw_eval.policies.card import Card
from nw_eval.policies.card_file import load_card
from nw_eval.policies.control import ActionDelay, JointControl, actuator_values, physics_steps
from nw_eval.policies.policy import Action, InputSpec, Observation, Policy

__all__ = [
    "Action",
    "ActionDelay",
    "ActionFilter",
    "Bundle",
    "Card",
    "InputSpec",
    "JointControl",
    "Observation",
    "Policy",
    "actuator_values",
    "find_card",
    "load_bundle",
    "load_card",
    "open_policy",
    "physics_steps",
]
