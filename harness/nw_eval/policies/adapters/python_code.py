"""Policies that are Python classes: `adapter: python:package.module:Class`, behind --allow-code.

The class is called with the bundle and must have `act(observation) -> 12 numbers`. Whatever else
of `Policy` it has is used: `reset(seed)`, `state()` with `restore(state)`, `close()`, `inputs`.
A class without `state` promises that its next action depends on the next observation alone.
All Python files below the card's folder count for the identity of the policy; installed code does
not. Where the card names a file as `checkpoint`, its digest is verified, and counts as well.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.errors import CodeError, NwEvalError, PolicyError, TrialError
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.policy import Observation, checked_action


class PythonPolicy:
    """An object of the user's class, with its actions checked."""

    def __init__(self, bundle: Bundle, *, joints: int, allow_code: bool) -> None:
        """Import the module and make the object.

        Raises:
            PolicyError: code is not allowed.
            CodeError: the class cannot be imported or made, or is no policy.
        """
        self._name = bundle.name
        self._joints = joints
        self._policy: Any = None
        if not allow_code:
            raise PolicyError(
                f"{bundle.card_path}: `{bundle.card.adapter}` imports and runs Python code",
                fix="add --allow-code if you trust it, or use `remote` and run it elsewhere",
            )
        self._policy = _make(bundle)
        self.inputs: tuple[InputSpec, ...] = getattr(self._policy, "inputs", ())
        if hasattr(self._policy, "state") != hasattr(self._policy, "restore"):
            raise CodeError(
                f"{bundle.card_path}: {bundle.card.adapter} has only one of `state` and `restore`",
                fix="write both, or neither if the policy has no memory",
            )

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._call("reset", seed)

    def act(self, observation: Observation) -> Action:
        """Ask the object.

        Raises:
            TrialError: it raised, or its action is not twelve finite numbers.
        """
        if self._policy is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        try:
            raw = self._policy.act(observation)
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


def _make(bundle: Bundle) -> Any:
    module, _, name = bundle.card.adapter.removeprefix("python:").partition(":")
    try:
        with _importable(bundle.folder):
            cls = getattr(importlib.import_module(module), name)
        policy = cls(bundle)
    except NwEvalError:
        raise
    except Exception as error:  # noqa: BLE001 - the user's code may raise anything.
        raise CodeError(
            f"{bundle.card_path}: {bundle.card.adapter} cannot be opened: "
            f"{type(error).__name__}: {error}",
            fix=f"the module must lie in {bundle.folder} or be installed, and the class take the "
            "bundle",
        ) from None
    if not callable(getattr(policy, "act", None)):
        raise CodeError(
            f"{bundle.card_path}: {bundle.card.adapter} has no method `act`",
            fix="write `act(self, observation)`",
        )
    return policy


@contextmanager
def _importable(folder: Path) -> Generator[None]:
    """Let modules beside the card be imported."""
    sys.path.insert(0, str(folder.resolve()))
    try:
        yield
    finally:
        sys.path.remove(str(folder.resolve()))
