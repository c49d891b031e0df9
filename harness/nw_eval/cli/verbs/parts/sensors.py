"""`nw-eval sensors`: see what sensors see."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Draw what the sensors of a policy's card see, or one frame of every sensor there is."""

    policy: tyro.conf.Positional[str | None] = None
    """A bundle's name, folder or card; every built-in sensor when absent."""
    scene: str = "hurdles/two_logs_park"
    """Where to look: a scene's name or folder."""
    out: Path = Path("sensors.png")
    """The PNG to write."""
    allow_code: bool = False
    """Let the card import code of its own."""
    names: Annotated[bool, tyro.conf.arg(name="list")] = False
    """List sensors and wrappers, plug-ins included, and draw nothing."""

    def __call__(self) -> int:
        from nw_eval import api
        from nw_eval.cli.text.parts.sensors import seen_text, sensor_list

        if self.names:
            print(sensor_list(api.list_sensors()))
            return 0
        seen = api.draw_sensors(
            self.policy, scene=self.scene, out=self.out, allow_code=self.allow_code
        )
        if text := seen_text(seen):
            print(text)
        return 0
