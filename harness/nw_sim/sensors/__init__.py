"""Sensors: what a policy observes, computed from a world at the rates that its card names."""

from nw_sim.sensors.build import ObservationSpec, build_sensors, check_card
from nw_sim.sensors.sensor import SceneView, Sensor, Shot, StepContext

Moment, TrialPlace = StepContext, SceneView  # Their names until 0.1.

__all__ = [
    "Moment",
    "ObservationSpec",
    "SceneView",
    "Sensor",
    "Shot",
    "StepContext",
    "TrialPlace",
    "build_sensors",
    "check_card",
]
