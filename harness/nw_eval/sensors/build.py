"""Makes the sensors that a card names, and no others."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from nw_eval.policies import Card, JointControl
from nw_eval.policies.observations import (
    AnyObservation,
    ProprioObservation,
    ScandotsObservation,
    SplatRgbObservation,
)
from nw_eval.scenes import Scene
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.proprio import Proprio
from nw_eval.sensors.published_scandots import PublishedScandots
from nw_eval.sensors.sampled import Measurement, Sampled
from nw_eval.sensors.scandots import Scandots
from nw_eval.sensors.sensor import Sensor
from nw_eval.sim import World

if TYPE_CHECKING:
    from nw_eval.splat.render import Renderer


class SensorKit:
    """What sensors of one trial share: rays and renderer, made when the first of them needs it.

    Args:
        world: the robot that carries the sensors, in its scene.
        rays: the scene's, if the caller has them already.
        renderer: makes the renderer of the scene's splat; called at most once.
    """

    def __init__(
        self,
        world: World,
        *,
        rays: RayScene | None = None,
        renderer: Callable[[Scene], Renderer] | None = None,
    ) -> None:
        self._world = world
        self._rays = rays
        self._make_renderer = renderer or _cpu_renderer
        self._renderer: Renderer | None = None

    def sensor(self, name: str, observation: AnyObservation, card: Card) -> Sensor:
        """Return one sensor.

        Raises:
            PolicyError: the observation does not fit the robot.
            SceneError: the scene has no splat, or it cannot be made.
        """
        measurement = self._measurement(name, observation, card)
        return Sampled(name, measurement, rate=observation.rate, latency=observation.latency)

    def _measurement(self, name: str, observation: AnyObservation, card: Card) -> Measurement:
        robot = self._world.robot
        match observation:
            case ProprioObservation():
                control = JointControl.from_card(card, robot)
                return Proprio(name, observation, card.command, control)
            case ScandotsObservation():
                rays = self._scene_rays()
                if self._world.protocol == "neverwhere-2026":
                    offset = robot.height_camera_offset
                    return PublishedScandots(observation, rays, offset)
                return Scandots(observation, rays)
            case SplatRgbObservation():
                from nw_eval.sensors.splat_rgb import SplatRgb

                if self._renderer is None:
                    self._renderer = self._make_renderer(self._world.scene)
                return SplatRgb(
                    name,
                    observation,
                    robot,
                    self._world.scene,
                    self._renderer,
                    self._scene_rays,
                )

    def _scene_rays(self) -> RayScene:
        if self._rays is None:
            self._rays = RayScene(self._world.scene.mesh())
        return self._rays


def build_sensors(
    card: Card,
    world: World,
    *,
    rays: RayScene | None = None,
    renderer: Callable[[Scene], Renderer] | None = None,
) -> dict[str, Sensor]:
    """Return the sensors of a card by name, in its order.

    Args:
        card: names the observations.
        world: robot and scene.
        rays: the scene's, if the caller keeps them between trials.
        renderer: makes the renderer of the scene's splat; the CPU renderer if None. It is called
            only if the card names camera images.

    Raises:
        PolicyError: an observation does not fit the robot.
        SceneError: the scene has no splat but the card names camera images.
    """
    kit = SensorKit(world, rays=rays, renderer=renderer)
    return {name: kit.sensor(name, spec, card) for name, spec in card.observations.items()}


def _cpu_renderer(scene: Scene) -> Renderer:
    from nw_eval.splat.render import open_renderer
    from nw_eval.splat.store import open_store

    return open_renderer(open_store(scene.splat_store()), "cpu")
