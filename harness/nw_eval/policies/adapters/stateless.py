"""What policies without memory have in common."""

from __future__ import annotations


class StatelessPolicy:
    """A policy whose action depends on the present observation only."""

    def reset(self, seed: int) -> None:
        """Begin a trial; there is nothing to forget and nothing random."""

    def state(self) -> bytes:
        """Return an empty state."""
        return b""

    def restore(self, state: bytes) -> None:
        """Go back to a state; all of them are the same."""
