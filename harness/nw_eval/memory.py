"""What remembers something from one control step to the next, so that a trial can be saved."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
"""Arrays of numbers by name; `nw_eval.arrays` turns them into bytes and back."""

State = TypeVar("State")


class Memory(Protocol[State]):
    """A part of a trial whose future depends on its past.

    The parts that a trial is saved by give bytes. What lies inside such a part gives `Arrays`,
    which the part packs together with its own.
    """

    def state(self) -> State:
        """Return what its future depends on, beside what it will be shown."""
        ...

    def restore(self, state: State) -> None:
        """Go back, or on, to a `state` of the same trial, bit for bit.

        Raises:
            TrialError, KeyError, TypeError, ValueError: it is damaged, or of something else.
        """
        ...


class Forgetful:
    """What stands among those that remember, and remembers nothing."""

    def state(self) -> Arrays:
        """Return nothing."""
        return {}

    def restore(self, state: Arrays) -> None:
        """Go back to nothing."""
