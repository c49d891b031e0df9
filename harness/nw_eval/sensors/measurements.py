"""From an observation of a card to what measures it, and what a measurement passes through."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import assert_never

from nw_eval.cards import Card, JointControl
from nw_eval.cards.observations import (
    AnyObservation,
    DepthObservation,
    DirectionObservation,
    HeightmapObservation,
    LidarObservation,
    PluginObservation,
    ProprioObservation,
    ScandotsObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_eval.protocol import EvaluationProtocol
from nw_eval.robots import RobotSpec
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.body.direction import Direction
from nw_eval.sensors.body.proprio import Proprio
from nw_eval.sensors.cameras.depth import Depth, DepthForm
from nw_eval.sensors.cameras.semantics import Semantics
from nw_eval.sensors.cameras.splat_image import Arrange
from nw_eval.sensors.ground.heightmap import Heightmap
from nw_eval.sensors.ground.lidar import Lidar, LidarForm
from nw_eval.sensors.ground.published_scandots import PublishedScandots
from nw_eval.sensors.ground.scandots import Scandots
from nw_eval.sensors.plugin_sensor import PluginSensor
from nw_eval.sensors.sampled import Measurement
from nw_eval.sensors.wrappers import Chain, Link, Named, Spec, make_wrappers
from nw_eval.sensors.wrappers.values import AddNoise


@dataclass(frozen=True, kw_only=True)
class Pipeline:
    """What measures an observation, and the chain behind it."""

    measurement: Measurement
    chain: Chain


@dataclass(frozen=True, kw_only=True)
class Maker:
    """Makes pipelines for the observations of one card. Needs no world, so it serves checks too.

    Attributes:
        card: whose observations they are.
        robot: what carries the sensors.
        protocol: says which sensors are the published ones.
        rays: gives the scene's static geometry; called when a sensor first measures.
        code_from: folder of the card, whose modules may be imported; None = no code of the card's.
    """

    card: Card
    robot: RobotSpec
    protocol: EvaluationProtocol
    rays: Callable[[], RayScene]
    code_from: Path | None

    def pipeline(self, name: str, observation: AnyObservation) -> Pipeline:
        """Return measurement and chain of an observation.

        Raises:
            PolicyError: it does not fit the robot, or a plug-in cannot be used.
        """
        measurement, links, nothing = self._measurement(name, observation)
        named = [Named(name=observation.sensor, link=link) for link in links]
        if observation.noise is not None:
            noise = AddNoise(observation.noise, nothing)
            named.insert(0, Named(name="noise", link=noise))
        named += make_wrappers(observation.wrap, code_from=self.code_from)
        spec = Spec(measurement.shape, measurement.dtype)
        return Pipeline(measurement=measurement, chain=Chain(name, named, spec))

    def _measurement(  # noqa: C901 - one short case for each sensor.
        self, name: str, observation: AnyObservation
    ) -> tuple[Measurement, list[Link], float]:
        """Return what measures, the links that give it its form, and what it reads for nothing."""
        robot, rays = self.robot, self.rays
        match observation:
            case ProprioObservation():
                control = JointControl.from_card(self.card, robot)
                proprio = Proprio(name, observation, self.card.command, control)
                spoils = self.protocol.spoils_first_observation
                return proprio, [*proprio.frame_links(published=spoils)], 0.0
            case ScandotsObservation():
                if self.protocol.scandots_from_height_image:
                    offset = robot.height_camera_offset
                    return PublishedScandots(observation, rays, offset), [], 0.0
                return Scandots(observation, rays), [], 0.0
            case HeightmapObservation():
                return Heightmap(observation, rays), [], 0.0
            case SplatRgbObservation():
                from nw_eval.sensors.cameras.splat_rgb import SplatRgb

                return SplatRgb(name, observation, robot), [Arrange(observation)], 0.0
            case DepthObservation():
                return Depth(name, observation, robot, rays), [DepthForm(observation)], math.inf
            case SemanticsObservation():
                return Semantics(name, observation, robot, rays), [], 0.0
            case LidarObservation():
                return Lidar(observation, rays), [LidarForm(observation)], math.inf
            case DirectionObservation():
                return Direction(observation), [], 0.0
            case PluginObservation():
                plugin = PluginSensor(name, observation, robot, code_from=self.code_from)
                return plugin, [], 0.0
            case _:
                assert_never(observation)
