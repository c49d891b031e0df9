"""A sensor of somebody else."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, model_validator

from nw_eval.cards.observations.base import BaseObservation
from nw_eval.cards.observations.built_in import BUILT_IN_SENSORS
from nw_eval.cards.observations.plugins import SENSORS, known_or_raise


class PluginObservation(BaseObservation):
    """An installed plug-in of the group `nw_eval.sensors`, or `module:Class`.

    Every key that this class does not have is a parameter of the plug-in's class.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    sensor: str
    """Name of an installed sensor, or `module:Class`."""

    @model_validator(mode="after")
    def _known(self) -> PluginObservation:
        known_or_raise(self.sensor, SENSORS, BUILT_IN_SENSORS)
        return self

    @property
    def parameters(self) -> dict[str, Any]:
        """Keyword arguments of its class."""
        return dict(self.model_extra or {})
