"""One module for each kind of checkpoint; `open_policy` picks it by the card."""

from __future__ import annotations

from nw_eval.policies.bundle import Bundle
from nw_eval.policies.policy import Policy
from nw_eval.robots import get_robot


def open_policy(bundle: Bundle, *, allow_code: bool = False) -> Policy:  # noqa: ARG001
    """Load a bundle's checkpoint. Loading runs no code that the checkpoint contains.

    Args:
        bundle: from `load_bundle`.
        allow_code: whether adapters that import the user's Python code may do so; none of the
            adapters here does.

    Raises:
        PolicyError: the file is not what the card's adapter reads, or its inputs and outputs do
            not fit the card.
    """
    joints = len(get_robot(bundle.card.robot).joints)
    match bundle.card.adapter:
        case "onnx":
            from nw_eval.policies.adapters.onnx import OnnxPolicy

            return OnnxPolicy(bundle, joints=joints)
        case "torchscript":
            from nw_eval.policies.adapters.torchscript import TorchScriptPolicy

            return TorchScriptPolicy(bundle, joints=joints)
        case "zero":
            from nw_eval.policies.adapters.zero import ZeroPolicy

            return ZeroPolicy(joints=joints)
