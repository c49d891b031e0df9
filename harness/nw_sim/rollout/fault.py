"""Whose fault an exception is: the policy's own, or that of everything around it.

A policy's own code may raise whatever Python knows, `SystemExit` included. What it raises ends its
trial and nothing else. Only Ctrl-C at this process is no fault and is raised again.
"""

from __future__ import annotations

import re
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.clean import message_of
from nw_base.errors import (
    ActionError,
    CodeError,
    NwEvalError,
    ServerError,
    TrialError,
    is_interrupt,
)

if TYPE_CHECKING:
    from nw_base.words import PolicyFault

# Where an object lies in memory differs from process to process, and is useless.
_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{5,}")


class PolicyFailedError(TrialError):
    """The policy itself failed, in one of the ways that `kind` can say."""

    def __init__(
        self, message: str, *, kind: PolicyFault = "exception", fix: str | None = None
    ) -> None:
        super().__init__(message, fix=fix)
        self.kind: PolicyFault = kind


class policy_at_fault:  # noqa: N801 - it reads like a function, and costs less than one.
    """Turn whatever a checkpoint or an adapter throws into a failure of the policy.

    Adapters raise TrialError where the checkpoint failed. Any other error of this program's own
    passes as it is: a file that is gone or a server that is silent says nothing about the policy.

    Raises:
        PolicyFailedError: a TrialError other than a ServerError, or anything foreign was raised
            inside.
    """

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> None:
        if error is None or is_interrupt(error):
            return
        if not isinstance(error, NwEvalError):
            raise PolicyFailedError(
                f"the policy raised {type(error).__name__}: {message_of(error)}",
                fix="run the checkpoint on its own with an observation of the card's shapes",
            ) from error
        if isinstance(error, ActionError):
            raise PolicyFailedError(str(error), kind="action") from error
        if isinstance(error, TrialError) and not isinstance(error, PolicyFailedError | ServerError):
            raise PolicyFailedError(str(error)) from error


class ExtensionFailedError(NwEvalError):
    """Code of a score, a task or a perturbation raised what would else count as the policy's."""


class extension_at_fault:  # noqa: N801 - as `policy_at_fault`.
    """Turn what code other than the policy's throws into an error that is not the policy's.

    Raises:
        ExtensionFailedError: SystemExit and its like, or an error of a policy, was raised inside.
    """

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> None:
        if error is not None and not is_interrupt(error) and fault_of(error) is not None:
            raise ExtensionFailedError(
                f"a score, task or perturbation raised {one_line(error)}", fix="fix its code"
            ) from error


def fault_of(error: BaseException) -> PolicyFault | None:
    """Return how the policy itself failed; None if this is no failure of the policy."""
    if isinstance(error, PolicyFailedError):
        return error.kind
    # Nothing of ours raises SystemExit and its like: wherever they come from, code of the card's
    # threw them.
    if isinstance(error, CodeError) or not isinstance(error, Exception):
        return "exception"
    return None


def one_line(error: BaseException) -> str:
    """Return an error in one line; an unexpected one also says where it came from.

    Addresses are left out, so that the same failure reads the same in every process.
    """
    if isinstance(error, NwEvalError):
        return _ADDRESS.sub("0x...", message_of(error))
    frames = traceback.extract_tb(error.__traceback__)
    location = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return _ADDRESS.sub("0x...", f"{type(error).__name__}: {message_of(error)}{location}")
