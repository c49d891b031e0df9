"""`nw-eval sensors`: see what sensors see."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from nw_eval.cli.verbs.printed import json_text
from nw_eval.cli.verbs.verb import Verb, verb_of

if TYPE_CHECKING:
    from nw_eval.api import ListedSensor
    from nw_sim.sensors.gallery import SeenCard, SeenObservation


@verb_of("draw_sensors", changes=("allow_code",))
class Sensors(Verb):
    """Draw what the sensors of a policy's card see, or one frame of every sensor."""

    policy = None
    scene = "hurdles/two_logs_park"
    out = Path("sensors.png")
    names: Annotated[bool, tyro.conf.arg(name="list")] = False
    """List sensors and wrappers, with those of plugins, and draw nothing."""
    json: bool = False
    """With --list: print JSON."""

    def show(self, result: SeenCard) -> str:
        return seen_text(result)

    def __call__(self) -> int:
        if not self.names:
            return super().__call__()
        from nw_eval import api

        sensors = api.list_sensors()
        print(json_text(sensors) if self.json else sensor_list(sensors))
        return 0


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
    taken = observation.shutter and f", {observation.shutter}"
    return f"{observation.name}: {observation.sensor}, {form}, {span}{taken}"
