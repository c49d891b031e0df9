"""What a sensor measures each time that it samples, before noise and wrappers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.memory import Arrays, Memory
from nw_eval.scenes.scene import Nearness
from nw_eval.sensors.place import TrialPlace
from nw_eval.sensors.sensor import Moment
from nw_eval.sensors.wrappers.wrapper import Wrapper


class Measurement(Memory[Arrays], Protocol):
    """What is sampled; by default numbers that depend on the moment alone, seen as measured."""

    shape: tuple[int, ...]
    """Shape of a measurement."""
    dtype: np.dtype[Any]
    """Type of a measurement."""
    unit: str
    """As `Sensor.unit`."""
    is_image: bool = False
    """As `Sensor.is_image`."""
    coverage: float | None = None
    """As `Sensor.coverage`."""
    nearness: Nearness | None = None
    """As `Sensor.nearness`."""
    nothing: float = 0.0
    """What a number reads where there is nothing, and where noise loses it."""
    form: Sequence[Wrapper] = ()
    """What brings a measurement, behind its noise, into the form that the card asks for."""
    sum_of: str = ""
    """What its size is the sum or the product of: `3 + 3 + 12`; empty if that says nothing."""

    def attach(self, place: TrialPlace) -> None:
        """Take what it needs of the place; called once, before `reset`."""

    def reset(self) -> None:
        """Forget earlier measurements."""

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Return a new measurement, which nobody will change."""
        ...

    def state(self) -> Arrays:
        """Return what the next measurements depend on beside the moment."""
        return {}

    def restore(self, state: Arrays) -> None:
        """Go back to a `state`."""
