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
from collections.abc import Generator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.errors import CodeError, NwEvalError, PolicyError, TrialError
from nw_eval.files.importable import importable
from nw_eval.policies.apart import code_refused
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.policy import Observation, raised
from nw_eval.policies.policy_process import CodePolicy, FaultError


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
        self._is_ours = bundle.instance is None
        user_object: Any = (
            _make(bundle, allow_code=allow_code) if self._is_ours else bundle.instance
        )
        self.inputs: tuple[InputSpec, ...] = getattr(user_object, "inputs", ())
        if self._is_ours and not callable(getattr(user_object, "act", None)):
            user_object = SimpleNamespace(act=None)  # A function is no class's object.
        with _faults():
            self._policy: CodePolicy | None = CodePolicy(
                user_object,
                name=bundle.name,
                adapter=bundle.card.adapter,
                where=bundle.where,
                joints=joints,
            )

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        if self._policy is not None:
            with _faults():
                self._policy.reset(seed)

    def act(self, observation: Observation) -> Action:
        """Ask the object, which gets copies: it may write into them.

        Raises:
            TrialError: it raised, or its action is not twelve finite numbers.
        """
        if self._policy is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        with _faults():
            return self._policy.act(observation)
        raise AssertionError("no exception vanishes")

    def state(self) -> bytes:
        """Return the object's memory."""
        if self._policy is None:
            return b""
        with _faults():
            return self._policy.state()
        raise AssertionError("no exception vanishes")

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        if self._policy is not None:
            with _faults():
                self._policy.restore(state)

    def close(self) -> None:
        """Close the object."""
        policy, self._policy = self._policy, None
        if policy is not None and self._is_ours:
            with _faults():
                policy.close()


@contextmanager
def _faults() -> Generator[None]:
    """Turn what is wrong with the object into an error of this program."""
    try:
        yield
    except FaultError as fault:
        if isinstance(fault.__cause__, TrialError):
            raise fault.__cause__ from None  # It raised what adapters raise, on purpose.
        raise raised(fault) from fault.__cause__


def _make(bundle: Bundle, *, allow_code: bool) -> Any:
    if not allow_code:
        raise code_refused(bundle)
    if bundle.card.python is not None:
        raise PolicyError(
            f"{bundle.where}: `python: {bundle.card.python}` runs the code in a process of its own",
            fix="drop --in-process, or run it there as a server and use `remote`",
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
