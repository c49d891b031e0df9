"""What most measurements have in common: they give numbers, at once, and remember nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from nw_eval.sensors.place import Place
from nw_eval.sensors.wrappers.wrapper import Wrapper


class BaseMeasurement:
    """A measurement of numbers, seen as they are measured, unless it says otherwise."""

    is_image = False
    coverage: float | None = None
    nothing = 0.0
    form: Sequence[Wrapper] = ()
    sum_of = ""

    def attach(self, place: Place) -> None:
        """Nothing to take."""


class Stateless(BaseMeasurement):
    """One that depends on the moment alone."""

    def reset(self) -> None:
        """Nothing to forget."""

    def memory(self) -> dict[str, NDArray[Any]]:
        """Nothing to remember."""
        return {}

    def remember(self, memory: dict[str, NDArray[Any]]) -> None:
        """Nothing to go back to."""
