"""The observations that a card can name: which sensor, and how its values are laid out."""

from __future__ import annotations

from typing import Annotated

from nw_eval.cards.observations.base import BaseObservation
from nw_eval.cards.observations.built_in import BUILT_IN_SENSORS, BuiltInObservation
from nw_eval.cards.observations.named_union import NamedBy
from nw_eval.cards.observations.plugin_sensor import PluginObservation
from nw_eval.cards.observations.proprio import History, ProprioObservation, selected_indices

AnyObservation = BuiltInObservation | PluginObservation
Observation = Annotated[AnyObservation, NamedBy("sensor")]

__all__ = [
    "BUILT_IN_SENSORS",
    "AnyObservation",
    "BaseObservation",
    "BuiltInObservation",
    "History",
    "Observation",
    "PluginObservation",
    "ProprioObservation",
    "selected_indices",
]
