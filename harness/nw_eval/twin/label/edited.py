"""What is edited: a place as it was opened, and the line of states since."""

from __future__ import annotations

import math

from nw_eval.errors import UsageError
from nw_eval.twin.label.folder.opening import OpenedPlace
from nw_eval.twin.label.history import LabelHistory
from nw_eval.twin.label.shown import ShownPlace
from nw_eval.twin.label.state import LabelState


class Edited:
    """A place, what is decided of it now, and what was before.

    Args:
        place: as opened.

    Attributes:
        place: as above.
    """

    def __init__(self, place: OpenedPlace) -> None:
        self.place = place
        self._history = LabelHistory(place.state)
        self._shown = ShownPlace(place.mesh, place.state)

    @property
    def state(self) -> LabelState:
        """What is decided now."""
        return self._shown.state

    @property
    def can_undo(self) -> bool:
        """Whether there is a state before this one."""
        return self._history.can_undo

    @property
    def can_redo(self) -> bool:
        """Whether a change was taken back, and nothing done since."""
        return self._history.can_redo

    def undo(self) -> None:
        """Go back to the state before; at the first one, stay."""
        self._history.undo()
        self._show()

    def redo(self) -> None:
        """Do again what `undo` took back; otherwise stay."""
        self._history.redo()
        self._show()

    def _do(self, state: LabelState) -> None:
        self._history.do(state)
        self._show()

    def _show(self) -> None:
        state = self._history.now
        same = (state.placement, state.crop) == (self.state.placement, self.state.crop)
        ground = self._shown.ground if same and self._shown.is_built else None
        self._shown = ShownPlace(self.place.mesh, state, ground)

    @staticmethod
    def _check_number(what: str, number: float) -> None:
        if not math.isfinite(number):
            raise UsageError(f"{what} of {number}", fix="give a finite number")
