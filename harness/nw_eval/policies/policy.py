"""What a running policy is, whatever file it came from."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

from numpy.typing import NDArray

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.errors import ActionError, CodeError, NotFiniteError, NwEvalError, TrialError
from nw_eval.memory import Arrays, Memory, unpack
from nw_eval.policies.policy_process import FaultError, all_finite, as_action

__all__ = ["Observation", "Policy", "all_finite", "checked_action", "raised"]

_KINDS = {kind.__name__: kind for kind in (ActionError, CodeError, NotFiniteError, TrialError)}

Observation = Mapping[str, NDArray[Any]]
"""Observation names of the card to arrays, without a batch axis."""


class Policy(Memory[bytes], Protocol):
    """A policy in one trial. It has one thread, batch 1 and no randomness of its own.

    It is used as `reset`, then `act` once for each control step, then `close`. Two policies share
    nothing that changes, so trials do not depend on what ran before them.
    """

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take; empty where its format does not say."""
        ...

    def reset(self, seed: int) -> None:
        """Begin a trial: forget the last one, and seed whatever is random."""
        ...

    def act(self, observation: Observation) -> Action:
        """Return the raw action for an observation.

        Raises:
            ActionError: the action has another shape, inf or NaN.
            ServerError: the policy's server could not be asked, which is no failure of the policy.
            TrialError: the checkpoint failed otherwise.
        """
        ...

    def close(self) -> None:
        """Free what the policy holds. Closing twice is allowed."""
        ...


def checked_action(raw: Any, *, joints: int, policy: str) -> Action:
    """Return a checkpoint's output as an action of its own memory.

    Args:
        raw: the output, (joints,) or with leading axes of length 1.
        joints: how many numbers an action has.
        policy: name of the policy, for errors.

    Raises:
        ActionError: the output has another size or is not finite.
    """
    try:
        return as_action(raw, joints=joints, policy=policy)
    except FaultError as fault:
        raise raised(fault) from None


def raised(fault: FaultError) -> NwEvalError:
    """Return a fault of a policy as the error that it is here."""
    return _KINDS[fault.kind](str(fault), fix=fault.fix)


@contextmanager
def unpacked(state: bytes, policy: str) -> Generator[Arrays]:
    """Give the arrays that `arrays.pack` made a state of, to be taken in the `with` block.

    Raises:
        TrialError: the bytes are no such state, or the block finds that the arrays do not fit.
    """
    try:
        arrays = unpack(state)
    except ValueError as error:
        raise unfitting(policy, str(error)) from None
    found = {name: (array.shape, array.dtype) for name, array in arrays.items()}
    try:
        yield arrays
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise unfitting(policy, f"{error!r}, it has {found}") from None


def unfitting(policy: str, reason: str) -> TrialError:
    """Return the error for a state that belongs to something else."""
    return TrialError(
        f"the state does not fit policy {policy!r}: {reason}",
        fix="continue a trial with the checkpoint and card that began it",
    )
