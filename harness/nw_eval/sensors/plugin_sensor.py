"""Sensors of somebody else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations import PluginObservation
from nw_eval.cards.observations.plugins import SENSORS
from nw_eval.errors import CodeError, NwEvalError
from nw_eval.memory import Arrays
from nw_eval.robots import RobotSpec
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.place import TrialPlace
from nw_eval.sensors.plugins import make_plugin, remembers
from nw_eval.sensors.sensor import Moment


class PluginSensor(Measurement):
    """A measurement by an object of a plug-in's class.

    The class is called as `Class(robot, **parameters)` and needs `shape`, `dtype` and
    `measure(moment)`. Whatever else of a measurement it has is used: `attach(place)`, `reset()`,
    `state()` with `restore(state)`, `unit`, `is_image`.

    Raises:
        CodeError: the class cannot be imported or made, or is no sensor.
    """

    def __init__(
        self,
        name: str,
        observation: PluginObservation,
        robot: RobotSpec,
        *,
        code_from: Path | None,
    ) -> None:
        self._name = name
        self._sensor = observation.sensor
        plugin = make_plugin(
            observation.sensor, SENSORS, (robot,), observation.parameters, code_from=code_from
        )
        for needed in ("shape", "dtype", "measure"):
            if not hasattr(plugin, needed):
                raise CodeError(
                    f"`{name}`: sensor {self._sensor} has no `{needed}`",
                    fix="a sensor needs `shape`, `dtype` and `measure(moment)`",
                )
        self._plugin = plugin
        self.shape: tuple[int, ...] = tuple(int(side) for side in plugin.shape)
        self.dtype = np.dtype(plugin.dtype)
        self.unit = str(getattr(plugin, "unit", "mixed"))
        self.is_image = bool(getattr(plugin, "is_image", False))

    def attach(self, place: TrialPlace) -> None:
        """Show it the place."""
        self._call("attach", place)

    def reset(self) -> None:
        """Begin a trial."""
        self._call("reset")

    def measure(self, moment: Moment) -> NDArray[Any]:
        """Ask it.

        Raises:
            CodeError: it raised, or returned another shape or type than it said.
        """
        sample = self._call("measure", moment)
        if not isinstance(sample, np.ndarray):
            form = type(sample).__name__
        elif sample.shape != self.shape or sample.dtype != self.dtype:
            form = f"{sample.shape} {sample.dtype}"
        else:
            return sample.copy()  # It may write the next sample into the same array.
        raise CodeError(
            f"`{self._name}`: sensor {self._sensor} returned {form}",
            fix=f"it says that it returns {self.shape} {self.dtype}",
        )

    def state(self) -> Arrays:
        """Return what it remembers."""
        return self._call("state") or {} if remembers(self._plugin) else {}

    def restore(self, state: Arrays) -> None:
        """Go back to a `state`."""
        if remembers(self._plugin):
            self._call("restore", state)

    def _call(self, method: str, *arguments: Any) -> Any:
        """Call a method if the object has it."""
        function = getattr(self._plugin, method, None)
        if function is None:
            return None
        try:
            return function(*arguments)
        except NwEvalError:
            raise
        except Exception as error:
            raise CodeError(
                f"`{self._name}`: sensor {self._sensor}: {method} raised "
                f"{type(error).__name__}: {error}"
            ) from error
