"""What a sensor may ask of the place that it is in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nw_eval.scenes.rays import RayScene
from nw_eval.sim import World

if TYPE_CHECKING:
    from nw_eval.splat.render import Renderer


@dataclass(frozen=True, kw_only=True)
class TrialPlace:
    """The world of one trial, and what its sensors share.

    Attributes:
        world: the robot in its scene (`world.scene`).
        rays: gives the scene's static geometry for ray casting; made on the first call.
        renderer: gives the renderer of the scene's splat; made on the first call.
    """

    world: World
    rays: Callable[[], RayScene]
    renderer: Callable[[], Renderer]
