"""Sensors: what a policy observes, computed from a world at the rates that its card names."""

from nw_eval.sensors.build import build_sensors
from nw_eval.sensors.check import ObservationSpec, check_card
from nw_eval.sensors.sensor import Moment, Sensor, Shot, TrialPlace

__all__ = [
    "Moment",
    "ObservationSpec",
    "Sensor",
    "Shot",
    "TrialPlace",
    "build_sensors",
    "check_card",
]
