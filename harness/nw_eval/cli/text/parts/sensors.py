"""Sensors and what they see, as lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nw_eval.api import ListedSensor
    from nw_eval.sensors.gallery import SeenCard, SeenObservation


def sensor_list(sensors: Sequence[ListedSensor]) -> str:
    """Return the names of each kind in one line, behind it a line for each plug-in."""
    lines: list[str] = []
    for kind in ("sensor", "wrapper"):
        own = [sensor for sensor in sensors if sensor.kind == kind]
        built_in = ", ".join(sensor.name for sensor in own if sensor.package is None)
        lines.append(f"nw_eval.{kind}s: {built_in}")
        lines += [f"  {sensor.name} of {sensor.package}" for sensor in own if sensor.package]
    return "\n".join(lines)


def seen_text(seen: SeenCard) -> str:
    """Return a line for each observation, and where the picture is."""
    picture = [] if seen.picture is None else [str(seen.picture)]
    return "\n".join([*(_line(observation) for observation in seen.observations), *picture])


def _line(observation: SeenObservation) -> str:
    form = f"{' x '.join(map(str, observation.shape))} {observation.dtype}"
    span = "nothing finite"
    if observation.low is not None and observation.high is not None:
        span = f"{observation.low:.4g} to {observation.high:.4g}"
    return f"{observation.name}: {observation.sensor}, {form}, {span}"
