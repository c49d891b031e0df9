"""Policies that are Python classes: `adapter: python:package.module:Class`, behind --allow-code.

The class is called with the bundle and must have `act(observation) -> 12 numbers`. Whatever else
of `Policy` it has is used: `reset(seed)`, `state()` with `restore(state)`, `close()`, `inputs`.
A class without `state` promises that its next action depends on the next observation alone.
All Python files below the card's folder count for the identity of the policy; installed code does
not. Where the card names a file as `checkpoint`, its digest is verified, and counts as well.

A caller in this process may hand in the object itself, or a function in place of its `act`
(`policies.instance_bundle`). It outlives its trials, so it is never closed.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.errors import CodeError, NwEvalError, PolicyError, TrialError
from nw_eval.files.importable import importable
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.policy import Observation, checked_action


class PythonPolicy:
    """An object of the user's, with its actions checked.

    Args:
        bundle: its card, and the object itself if it is there.
        joints: how many numbers an action has.
        allow_code: whether its module may be imported.

    Raises:
        PolicyError: code is not allowed.
        CodeError: the class cannot be imported or made, or the object is no policy.
    """

    def __init__(self, bundle: Bundle, *, joints: int, allow_code: bool) -> None:
        self._name = bundle.name
        self._joints = joints
        self._is_ours = bundle.instance is None
        self._policy: Any = (
            _make(bundle, allow_code=allow_code) if self._is_ours else bundle.instance
        )
        self.inputs: tuple[InputSpec, ...] = getattr(self._policy, "inputs", ())
        if not callable(getattr(self._policy, "act", None if self._is_ours else self._policy)):
            raise CodeError(
                f"{bundle.where}: {bundle.card.adapter} has no method `act`",
                fix="write `act(self, observation)`",
            )
        if hasattr(self._policy, "state") != hasattr(self._policy, "restore"):
            raise CodeError(
                f"{bundle.where}: {bundle.card.adapter} has only one of `state` and `restore`",
                fix="write both, or neither if the policy has no memory",
            )

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._call("reset", seed)

    def act(self, observation: Observation) -> Action:
        """Ask the object, which gets copies: it may write into them.

        Raises:
            TrialError: it raised, or its action is not twelve finite numbers.
        """
        if self._policy is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        copies = {name: np.array(array) for name, array in observation.items()}
        try:
            raw = getattr(self._policy, "act", self._policy)(copies)
        except Exception as error:
            raise _failed(self._name, "act", error) from error
        return checked_action(raw, joints=self._joints, policy=self._name)

    def state(self) -> bytes:
        """Return the object's memory."""
        state = self._call("state")
        if not isinstance(state, bytes | None):
            raise TrialError(
                f"policy {self._name!r}: state() returned a {type(state).__name__}, not bytes"
            )
        return state or b""

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self._call("restore", state)

    def close(self) -> None:
        """Close the object."""
        if self._policy is not None:
            if self._is_ours:
                self._call("close")
            self._policy = None

    def _call(self, method: str, *arguments: Any) -> Any:
        """Call a method if the object has it."""
        function = getattr(self._policy, method, None)
        if function is None:
            return None
        try:
            return function(*arguments)
        except Exception as error:
            raise _failed(self._name, method, error) from error


def _failed(policy: str, method: str, error: Exception) -> TrialError:
    if isinstance(error, TrialError):
        return error
    return TrialError(f"policy {policy!r}: {method} raised {type(error).__name__}: {error}")


def _make(bundle: Bundle, *, allow_code: bool) -> Any:
    if not allow_code:
        raise PolicyError(
            f"{bundle.where}: `{bundle.card.adapter}` imports and runs Python code",
            fix="add --allow-code if you trust it, or use `remote` and run it elsewhere",
        )
    module, _, name = bundle.card.adapter.removeprefix("python:").partition(":")
    try:
        with importable(bundle.folder):
            cls = getattr(importlib.import_module(module), name)
        return cls(bundle)
    except NwEvalError:
        raise
    except Exception as error:  # noqa: BLE001 - the user's code may raise anything.
        raise CodeError(
            f"{bundle.where}: {bundle.card.adapter} cannot be opened: "
            f"{type(error).__name__}: {error}",
            fix=f"the module must lie in {bundle.folder} or be installed, and the class take the "
            "bundle",
        ) from None
