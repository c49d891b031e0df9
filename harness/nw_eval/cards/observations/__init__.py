"""The observations that a card can name: which sensor, and how its values are laid out."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Discriminator, Tag

from nw_eval.cards.observations.base import BaseObservation
from nw_eval.cards.observations.cameras import (
    DepthObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_eval.cards.observations.direction import DirectionObservation
from nw_eval.cards.observations.heights import HeightmapObservation, ScandotsObservation
from nw_eval.cards.observations.lidar import LidarObservation, Mount
from nw_eval.cards.observations.plugin_sensor import BUILT_IN_SENSORS, PluginObservation
from nw_eval.cards.observations.plugins import kind_of
from nw_eval.cards.observations.proprio import History, ProprioObservation, selected_indices
from nw_eval.cards.observations.wraps import AnyWrap, Noise, Wrap

AnyObservation = (
    ProprioObservation
    | ScandotsObservation
    | HeightmapObservation
    | SplatRgbObservation
    | DepthObservation
    | SemanticsObservation
    | LidarObservation
    | DirectionObservation
    | PluginObservation
)


def _tag(value: Any) -> str | None:
    return kind_of(value, "sensor", BUILT_IN_SENSORS)


Observation = Annotated[
    Annotated[ProprioObservation, Tag("proprio")]
    | Annotated[ScandotsObservation, Tag("scandots")]
    | Annotated[HeightmapObservation, Tag("heightmap")]
    | Annotated[SplatRgbObservation, Tag("splat_rgb")]
    | Annotated[DepthObservation, Tag("depth")]
    | Annotated[SemanticsObservation, Tag("semantics")]
    | Annotated[LidarObservation, Tag("lidar")]
    | Annotated[DirectionObservation, Tag("direction")]
    | Annotated[PluginObservation, Tag("plug-in")],
    Discriminator(_tag),
]

__all__ = [
    "BUILT_IN_SENSORS",
    "AnyObservation",
    "AnyWrap",
    "BaseObservation",
    "DepthObservation",
    "DirectionObservation",
    "HeightmapObservation",
    "History",
    "LidarObservation",
    "Mount",
    "Noise",
    "Observation",
    "PluginObservation",
    "ProprioObservation",
    "ScandotsObservation",
    "SemanticsObservation",
    "SplatRgbObservation",
    "Wrap",
    "selected_indices",
]
