from nw_policies.bundle import Bundle, find_card, instance_bundle, load_bundle
from nw_policies.opening import open_policy
from nw_policies.policy import ActionDelay, ActionFilter, Observation, Policy

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
