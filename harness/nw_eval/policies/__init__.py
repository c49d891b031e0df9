"""What runs a checkpoint, whatever file it came from.

A card and its checkpoint make a `Bundle`; `open_policy` makes a `Policy` of it, which turns
observations into raw actions.
"""

from nw_eval.policies.action_delay import ActionDelay
from nw_eval.policies.action_filter import ActionFilter
from nw_eval.policies.adapters import open_policy
from nw_eval.policies.bundle import Bundle, find_card, load_bundle
from nw_eval.policies.instance import instance_bundle
from nw_eval.policies.policy import Observation, Policy

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
