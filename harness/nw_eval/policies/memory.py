"""What a policy remembers as bytes, and what is wrong with the bytes of another one."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from nw_eval.arrays import unpack
from nw_eval.errors import TrialError
from nw_eval.memory import Arrays


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
