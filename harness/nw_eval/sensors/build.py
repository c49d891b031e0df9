"""Makes the sensors that a card names, and no others."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from nw_eval.cards import Card
from nw_eval.scenes import Scene
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.pipeline import Maker
from nw_eval.sensors.place import CLEAR, Air, TrialPlace
from nw_eval.sensors.sampled import Sampled
from nw_eval.sensors.sensor import Sensor
from nw_eval.sim import World

if TYPE_CHECKING:
    from nw_eval.splat.render import Renderer


def build_sensors(
    card: Card,
    world: World,
    *,
    rays: RayScene | Callable[[], RayScene] | None = None,
    renderer: Callable[[Scene], Renderer] | None = None,
    code_from: Path | None = None,
    air: Air = CLEAR,
) -> dict[str, Sensor]:
    """Return the sensors of a card by name, in its order.

    Args:
        card: names the observations.
        world: robot and scene.
        rays: the scene's, or what gives them, if the caller keeps them between trials; asked for
            when a sensor first casts one.
        renderer: makes the renderer of the scene's splat; the CPU renderer if None. It is called
            at most once, and only if a sensor needs images of the splat.
        code_from: the card's folder, if its `module:Class` plug-ins may be imported from there;
            None = a card that names one is an error.
        air: through which cameras see the place.

    Raises:
        PolicyError: an observation does not fit the robot, or a plug-in cannot be used.
        SceneError: the scene has no splat but the card names camera images.
    """
    scene = world.scene

    @cache
    def shared_rays() -> RayScene:
        if rays is None:
            return RayScene(scene.mesh())
        return rays if isinstance(rays, RayScene) else rays()

    place = TrialPlace(
        world=world,
        rays=shared_rays,
        renderer=cache(lambda: (renderer or _cpu_renderer)(scene)),
        air=air,
    )
    maker = Maker(
        card=card,
        robot=world.robot,
        protocol=world.protocol,
        rays=shared_rays,
        code_from=code_from,
    )
    first_step = 1 if world.protocol.first_step_is_blind else 0
    sensors: dict[str, Sensor] = {}
    for name, observation in card.observations.items():
        pipeline = maker.pipeline(name, observation)
        pipeline.measurement.attach(place)
        sensors[name] = Sampled(
            name,
            pipeline.measurement,
            rate=observation.rate,
            latency=observation.latency,
            chain=pipeline.chain,
            first_step=first_step,
        )
    return sensors


def _cpu_renderer(scene: Scene) -> Renderer:
    from nw_eval.splat.render import open_renderer
    from nw_eval.splat.store import open_store

    return open_renderer(open_store(scene.splat_store()), "cpu")
