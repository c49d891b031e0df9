"""What a file of weights is when it runs: numbers in, numbers out, and a memory between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from numpy.typing import NDArray

from nw_eval.cards.inputs import InputSpec
from nw_eval.errors import PolicyError, nearest
from nw_eval.memory import Memory
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.policy import Observation

Wanted = Sequence[str | int | None]
"""Outputs of a file, by name or by place among those that feed no state; None = the first one."""


class Network(Memory[bytes], Protocol):
    """A file of weights in one trial, on one thread, with batch 1 and without randomness."""

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the file declares to take; empty where its format does not say."""
        ...

    def reset(self, seed: int) -> None:
        """Begin a trial with the memory that the file holds."""
        ...

    def run(self, given: Observation) -> tuple[NDArray[Any], ...]:
        """Return the outputs that it was opened for; they may change with the next call.

        Args:
            given: by the names that the card's `inputs` have, without a batch axis.

        Raises:
            TrialError: it failed.
        """
        ...

    def close(self) -> None:
        """Free what it holds. Closing twice is allowed."""
        ...


def place_of(wanted: str | int | None, names: Sequence[str], bundle: Bundle) -> int:
    """Return which of the outputs of a file is meant.

    Raises:
        PolicyError: there is no such output.
    """
    if isinstance(wanted, str) and wanted in names:
        return names.index(wanted)
    place = 0 if wanted is None else wanted
    if isinstance(place, int) and place < len(names):
        return place
    raise PolicyError(
        f"{bundle.where}: the checkpoint has no output {wanted!r}", fix=nearest(str(wanted), names)
    )
