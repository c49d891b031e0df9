"""What runs a checkpoint, whatever file it came from.

A card and its checkpoint make a `Bundle`; `open_policy` makes a `Policy` of it, which turns
observations into raw actions.
"""

from nw_eval.policies.bundle import Bundle, find_card, instance_bundle, load_bundle
from nw_eval.policies.opening import open_policy
from nw_eval.policies.policy import ActionDelay, ActionFilter, Observation, Policy

__all__ = [
    "ActionDelay",
    "ActionFilter",
    "Bundle",
    "Observation",
    "Policy",
    "find_card",
    "instance_bundle",
    "load_bundle",
    "open_policy",
]
