"""The states of a labelling, one after another: every one can be gone back to."""

from __future__ import annotations

from nw_eval.twin.label.state import LabelState


class LabelHistory:
    """A line of states, and the one that holds now.

    Args:
        first: which holds until something is done.

    Attributes:
        now: the state that holds.
    """

    def __init__(self, first: LabelState) -> None:
        self.now = first
        self._past: list[LabelState] = []
        self._future: list[LabelState] = []

    @property
    def can_undo(self) -> bool:
        """Whether there is a state before this one."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether a change was taken back, and nothing done since."""
        return bool(self._future)

    def do(self, state: LabelState) -> None:
        """Go on to a state, and forget what was undone; to the one that holds already, stay."""
        if state != self.now:
            self._past.append(self.now)
            self._future.clear()
            self.now = state

    def undo(self) -> None:
        """Go back to the state before; at the first one, stay."""
        if self._past:
            self._future.append(self.now)
            self.now = self._past.pop()

    def redo(self) -> None:
        """Do again what `undo` took back; otherwise stay."""
        if self._future:
            self._past.append(self.now)
            self.now = self._future.pop()
