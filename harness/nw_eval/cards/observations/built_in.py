"""The table of built-in sensors: a sensor that stands here can be named by cards."""

from __future__ import annotations

from nw_eval.cards.observations.cameras import (
    DepthObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_eval.cards.observations.direction import DirectionObservation
from nw_eval.cards.observations.heights import HeightmapObservation, ScandotsObservation
from nw_eval.cards.observations.lidar import LidarObservation
from nw_eval.cards.observations.named_union import names_of
from nw_eval.cards.observations.proprio import ProprioObservation

BuiltInObservation = (
    ProprioObservation
    | ScandotsObservation
    | HeightmapObservation
    | SplatRgbObservation
    | DepthObservation
    | SemanticsObservation
    | LidarObservation
    | DirectionObservation
)
"""What measures each of them stands in `sensors.build`."""

BUILT_IN_SENSORS = names_of(BuiltInObservation, "sensor")
