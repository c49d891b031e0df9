"""Sensors: what a policy observes, computed from a world at the rates that its card names."""

from nw_eval.sensors.build import SensorKit, build_sensors
from nw_eval.sensors.check import ObservationSpec, check_bundle, check_card
from nw_eval.sensors.sensor import Moment, Sensor

__all__ = [
    "Moment",
    "ObservationSpec",
    "Sensor",
    "SensorKit",
    "build_sensors",
    "check_bundle",
    "check_card",
]
