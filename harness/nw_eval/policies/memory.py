"""The recurrent state of a policy as bytes, for the snapshot of a trial."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from nw_eval import arrays
from nw_eval.errors import TrialError


def unpack(state: bytes, policy: str) -> dict[str, NDArray[Any]]:
    """Return the arrays that `arrays.pack` made a state of.

    Raises:
        TrialError: the bytes are no such state.
    """
    try:
        return arrays.unpack(state)
    except ValueError as error:
        raise unfitting(policy, str(error)) from None


def unfitting(policy: str, reason: str) -> TrialError:
    """Return the error for a state that belongs to something else."""
    return TrialError(
        f"the state does not fit policy {policy!r}: {reason}",
        fix="continue a trial with the checkpoint and card that began it",
    )
