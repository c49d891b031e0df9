"""What a sensor may ask of the place that it is in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nw_eval.scenes.rays import RayScene
from nw_eval.sim import World
from nw_eval.splat.image import Image

if TYPE_CHECKING:
    from nw_eval.splat.render import Renderer


FOG = 0.8
"""How bright fog is, of white."""


@dataclass(frozen=True, kw_only=True)
class Air:
    """What lies between a camera and the place, and how long it is exposed.

    Attributes:
        exposure: factor of all colours.
        fog: share of the light that is lost per metre, as the exponent, 1/m.
    """

    exposure: float = 1.0
    fog: float = 0.0

    def seen(self, image: Image) -> Image:
        """Return an image, depth in m, as it is seen through this air."""
        rgb = image.rgb
        if self.fog:
            # Where nothing was drawn there is no end to the fog.
            metres = np.where(image.depth > 0.0, image.depth, np.float32(np.inf))
            clear = np.exp(-np.float32(self.fog) * metres)[..., np.newaxis]
            rgb = rgb * clear + np.float32(FOG) * (np.float32(1.0) - clear)
        if self.exposure != 1.0:
            rgb = rgb * np.float32(self.exposure)
        return Image(rgb=rgb, depth=image.depth, alpha=image.alpha)


CLEAR = Air()
"""As the place was captured."""


@dataclass(frozen=True, kw_only=True)
class TrialPlace:
    """The world of one trial, and what its sensors share.

    Attributes:
        world: the robot in its scene (`world.scene`).
        rays: gives the scene's static geometry for ray casting; made on the first call.
        renderer: gives the renderer of the scene's splat; made on the first call.
        air: through which cameras see it.
    """

    world: World
    rays: Callable[[], RayScene]
    renderer: Callable[[], Renderer]
    air: Air = CLEAR
