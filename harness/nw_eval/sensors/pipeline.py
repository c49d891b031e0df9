"""The table of what measures each observation that a card can name, and the chain behind it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import assert_never

from nw_eval.cards import Card, JointControl
from nw_eval.cards.observations import AnyObservation, PluginObservation, ProprioObservation
from nw_eval.cards.observations.cameras import (
    DepthObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_eval.cards.observations.direction import DirectionObservation
from nw_eval.cards.observations.heights import HeightmapObservation, ScandotsObservation
from nw_eval.cards.observations.lidar import LidarObservation
from nw_eval.protocol import EvaluationProtocol
from nw_eval.robots import RobotSpec
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.body.direction import Direction
from nw_eval.sensors.body.proprio import Proprio
from nw_eval.sensors.cameras.depth import Depth
from nw_eval.sensors.cameras.semantics import Semantics
from nw_eval.sensors.ground.heightmap import Heightmap
from nw_eval.sensors.ground.lidar import Lidar
from nw_eval.sensors.ground.published_scandots import PublishedScandots
from nw_eval.sensors.ground.scandots import Scandots
from nw_eval.sensors.measurement import Measurement
from nw_eval.sensors.plugin_sensor import PluginSensor
from nw_eval.sensors.wrappers import Chain, NamedWrapper, Spec, make_wrappers
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
        measurement = self._measurement(name, observation)
        chain = [NamedWrapper(name=observation.sensor, wrapper=form) for form in measurement.form]
        if observation.noise is not None:
            noise = AddNoise(observation.noise, measurement.nothing)
            chain.insert(0, NamedWrapper(name="noise", wrapper=noise))
        chain += make_wrappers(observation.wrap, code_from=self.code_from)
        spec = Spec(measurement.shape, measurement.dtype)
        return Pipeline(measurement=measurement, chain=Chain(name, chain, spec))

    def _measurement(  # noqa: C901 - one line for each sensor.
        self, name: str, observation: AnyObservation
    ) -> Measurement:
        robot, rays = self.robot, self.rays
        match observation:
            case ProprioObservation():
                control = JointControl.from_card(self.card, robot)
                spoils = self.protocol.spoils_first_observation
                command = self.card.command
                return Proprio(name, observation, command, control, spoils_first=spoils)
            case ScandotsObservation():
                if self.protocol.scandots_from_height_image:
                    return PublishedScandots(observation, rays, robot.height_camera_offset)
                return Scandots(observation, rays)
            case HeightmapObservation():
                return Heightmap(observation, rays)
            case SplatRgbObservation():
                from nw_eval.sensors.cameras.splat_rgb import SplatRgb

                return SplatRgb(name, observation, robot)
            case DepthObservation():
                return Depth(name, observation, robot, rays)
            case SemanticsObservation():
                return Semantics(name, observation, robot, rays)
            case LidarObservation():
                return Lidar(observation, rays)
            case DirectionObservation():
                return Direction(observation)
            case PluginObservation():
                return PluginSensor(name, observation, robot, code_from=self.code_from)
            case _:
                assert_never(observation)
