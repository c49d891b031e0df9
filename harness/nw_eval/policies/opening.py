"""Opens policies: one class for each kind of checkpoint; `open_policy` picks it by the card."""

from __future__ import annotations

from typing import Literal, assert_never

import numpy as np

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.cards.networks import is_built_in
from nw_eval.policies.apart import ApartPolicy, current_line
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.drawing import DrawingPolicy
from nw_eval.policies.policy import Observation, Policy

PROGRAMS = frozenset({"torchscript", "torch-export"})
"""Adapters whose files are programs: torch runs whatever they say."""


def open_policy(bundle: Bundle, *, allow_code: bool = False) -> Policy:
    """Load a bundle's checkpoint, and its networks: in the policy's process, where there is one.

    Args:
        bundle: from `load_bundle`.
        allow_code: whether `python:` adapters may import the user's code.

    Raises:
        PolicyError: a file is not what the card's adapter reads, or its inputs and outputs do not
            fit the card.
    """
    line = current_line()
    if line is not None and bundle.card.adapter != "zero":
        joints = bundle.joints
        return ApartPolicy(bundle, line, joints=joints, allow_code=allow_code)
    policy = _open_checkpoint(bundle, allow_code=allow_code)
    if bundle.card.networks:
        from nw_eval.policies.fed_policy import FedPolicy

        policy = FedPolicy(bundle, policy, allow_code=allow_code)
    adapters = {bundle.card.adapter, *(net.adapter for net in bundle.card.networks.values())}
    draws = adapters & PROGRAMS or bundle.card.adapter.startswith("python:")
    return DrawingPolicy(policy, name=bundle.name) if draws and bundle.instance is None else policy


def _open_checkpoint(bundle: Bundle, *, allow_code: bool) -> Policy:
    """Open a bundle's own checkpoint, without the networks that feed it."""
    joints = bundle.joints
    adapter = bundle.card.adapter
    if not is_built_in(adapter):
        from nw_eval.policies.python_code import PythonPolicy

        return PythonPolicy(bundle, joints=joints, allow_code=allow_code)
    match adapter:
        case "onnx":
            from nw_eval.policies.onnx import OnnxPolicy

            return OnnxPolicy(bundle, joints=joints)
        case "torchscript":
            from nw_eval.policies.torchscript import TorchScriptPolicy

            return TorchScriptPolicy(bundle, joints=joints, allow_code=allow_code)
        case "torch-export":
            from nw_eval.policies.torch_network import TorchExportPolicy

            return TorchExportPolicy(bundle, joints=joints, allow_code=allow_code)
        case "mlp" | "lucidsim" | "extreme-parkour" | "act":
            return _open_weights(adapter, bundle, joints=joints)
        case "remote":
            from nw_eval.policies.remote import RemotePolicy

            return RemotePolicy(bundle, joints=joints)
        case "zero":
            return ZeroPolicy(joints=joints)
        case _:
            assert_never(adapter)


def _open_weights(
    adapter: Literal["mlp", "lucidsim", "extreme-parkour", "act"], bundle: Bundle, *, joints: int
) -> Policy:
    """Open a file that holds the weights of a network of ours, and no network."""
    match adapter:
        case "mlp":
            from nw_eval.policies.mlp import MlpPolicy

            return MlpPolicy(bundle, joints=joints)
        case "lucidsim":
            from nw_eval.policies.published import LucidSimPolicy

            return LucidSimPolicy(bundle, joints=joints)
        case "extreme-parkour":
            from nw_eval.policies.published import open_extreme_parkour

            return open_extreme_parkour(bundle, joints=joints)
        case "act":
            from nw_eval.policies.published import ActPolicy

            return ActPolicy(bundle, joints=joints)


class ZeroPolicy:
    """Answers every observation with zeros: the robot holds its default pose."""

    inputs: tuple[InputSpec, ...] = ()

    def __init__(self, *, joints: int) -> None:
        self._joints = joints

    def reset(self, seed: int) -> None:
        """Begin a trial; there is nothing to forget and nothing random."""

    def act(self, observation: Observation) -> Action:  # noqa: ARG002 - that is the point.
        """Return zeros."""
        return np.zeros(self._joints)

    def state(self) -> bytes:
        """Return an empty state."""
        return b""

    def restore(self, state: bytes) -> None:
        """Go back to a state; all of them are the same."""

    def close(self) -> None:
        """Do nothing, as always."""
