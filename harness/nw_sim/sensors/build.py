"""Checks a card against its robot, and makes the sensors that it names, and no others.

The table of what measures each observation that a card can name, the chain behind it, and rate and
latency: which sample of a measurement the policy sees at which control step.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, assert_never

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import NwEvalError, PolicyError, UsageError
from nw_base.memory import Arrays, pack, read_only, unpack
from nw_base.protocol import STRICT, EvaluationProtocol
from nw_policies.cards import (
    Card,
    JointControl,
    actuator_values,
    motor_groups,
    mounted_robot,
)
from nw_policies.cards.feeding import sized
from nw_policies.cards.model import CONTROL_RATE
from nw_policies.cards.observations import (
    AnyObservation,
    DepthObservation,
    DirectionObservation,
    HeightmapObservation,
    LidarObservation,
    PluginObservation,
    ProprioObservation,
    ReferenceObservation,
    ScandotsObservation,
    SemanticsObservation,
    SplatRgbObservation,
)
from nw_scenes import Scene
from nw_scenes.rays import RayScene
from nw_scenes.robots import RobotSpec, get_robot
from nw_scenes.scene import Nearness
from nw_sim.physics import World
from nw_sim.sensors.heights import Heightmap, PublishedScandots, Scandots
from nw_sim.sensors.plugins import PluginSensor
from nw_sim.sensors.proprio import Direction, Proprio
from nw_sim.sensors.ray_sensors import Depth, Lidar, Semantics
from nw_sim.sensors.reference import ReferenceRows
from nw_sim.sensors.sensor import CLEAR, Air, Measurement, SceneView, Sensor, Spec, StepContext
from nw_sim.sensors.wrappers import AddNoise, Chain, NamedWrapper, make_wrappers

if TYPE_CHECKING:
    from nw_splat.render import Renderer


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
        renderer: makes the renderer of the scene's splat (default: the CPU renderer). It is called
            at most once, and only if a sensor needs images of the splat.
        code_from: the card's folder, if its `module:Class` plug-ins may be imported from there;
            None = a card that names one is an error.
        air: through which cameras see the scene.

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

    place = SceneView(
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
            control_rate=world.control_rate,
            latency=observation.latency,
            chain=pipeline.chain,
            first_step=first_step,
        )
    return sensors


def _cpu_renderer(scene: Scene) -> Renderer:
    from nw_splat.render import open_renderer
    from nw_splat.store import open_store

    return open_renderer(open_store(scene.splat_store()), "cpu")


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
                return Proprio(name, observation, command, control, robot.feet, spoils_first=spoils)
            case ReferenceObservation():
                control = JointControl.from_card(self.card, robot)
                return ReferenceRows(name, observation, control)
            case ScandotsObservation():
                if self.protocol.scandots_from_height_image:
                    return PublishedScandots(observation, rays, robot.height_camera_offset)
                return Scandots(observation, rays)
            case HeightmapObservation():
                return Heightmap(observation, rays)
            case SplatRgbObservation():
                from nw_sim.sensors.splat_rgb import SplatRgb

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


class Sampled:
    """A sensor: a measurement taken at a rate, wrapped, and delivered after a latency.

    Samples are taken at steps 0, p, 2p, ... with p = control_rate / rate. At a step the policy sees
    the newest sample that is at least `latency` old; until there is one, the first sample.

    Args:
        name: the observation's, on the card.
        measurement: what is sampled.
        rate: Hz.
        control_rate: control steps per second, Hz.
        latency: s.
        chain: what a measurement passes through; None = nothing.
        first_step: the control step from which on there is something to see. Whatever was read
            before it is forgotten then.
    """

    def __init__(
        self,
        name: str,
        measurement: Measurement,
        *,
        rate: float = CONTROL_RATE,
        control_rate: float = CONTROL_RATE,
        latency: float = 0.0,
        chain: Chain | None = None,
        first_step: int = 0,
    ) -> None:
        spec = Spec(measurement.shape, measurement.dtype)
        self._chain = Chain(name, (), spec) if chain is None else chain
        self._is_wrapped = bool(self._chain)
        self.name = name
        self.rate = rate
        self.shape = self._chain.spec.shape
        self.dtype = self._chain.spec.dtype
        self.unit = measurement.unit
        self.is_image = measurement.is_image
        self.fresh = False
        self._measurement = measurement
        self._period = round(control_rate / rate)
        # A latency that an axis adds may lie between two control steps.
        self._delay = math.ceil(latency * control_rate - 1e-3)
        self._first_step = first_step
        self._seed = 0
        # Samples with their steps: the one that is shown now, then those on their way.
        self._samples: deque[tuple[int, NDArray[Any]]] = deque()

    @property
    def coverage(self) -> float | None:
        """Share of the newest camera image that the splat covers, 0..1; None without an image."""
        return self._measurement.coverage

    @property
    def nearness(self) -> Nearness | None:
        """How far the newest camera image was taken from the nearest capture camera; or None."""
        return self._measurement.nearness

    def reset(self, seed: int) -> None:
        """Begin a trial; noise and wrappers draw from `seed` alone."""
        self._seed = seed
        self._samples.clear()
        self._measurement.reset()
        self._chain.reset(seed)
        self.fresh = False

    def read(self, moment: StepContext) -> NDArray[Any]:
        """Return the sample that the policy sees at this step."""
        step = moment.step
        if self._first_step and step == self._first_step:
            self.reset(self._seed)
        samples = self._samples
        first = not samples
        self.fresh = first
        if first or step % self._period == 0:
            sample = self._measurement.measure(moment)
            if self._is_wrapped:
                sample = self._chain(sample, moment)
            sample = read_only(sample)  # It is shown at several steps, and logged.
            if not self._delay:
                samples.clear()
                self.fresh = True
            samples.append((step, sample))
        while len(samples) > 1 and samples[1][0] + self._delay <= step:
            samples.popleft()
            self.fresh = True
        return samples[0][1]

    def state(self) -> bytes:
        """Return the samples on their way, and what measurement and wrappers remember."""
        arrays: Arrays = {}
        memory = self._measurement.state()
        if len(self._samples) == 1 and not memory and not self._is_wrapped:
            step, sample = self._samples[0]  # As it mostly is.
            if sample.dtype.str[0] != ">":
                return _packed_sample(step, sample)
        if memory:
            arrays = {f"memory.{key}": value for key, value in memory.items()}
        if self._is_wrapped:
            arrays |= {f"chain.{key}": value for key, value in self._chain.state().items()}
        arrays["steps"] = np.array([step for step, _ in self._samples], dtype=np.int64)
        if len(self._samples) == 1:  # A view costs a third of an array.
            arrays["samples"] = self._samples[0][1][np.newaxis]
        elif self._samples:
            arrays["samples"] = np.array([sample for _, sample in self._samples])
        return pack(arrays)

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of the same trial, with the seed of the last `reset`."""
        arrays = unpack(state)
        steps = arrays.pop("steps").tolist()
        samples = read_only(arrays.pop("samples")) if steps else ()
        self._samples = deque(zip(steps, samples, strict=True))
        self._measurement.restore(_under("memory.", arrays))
        self._chain.restore(_under("chain.", arrays))
        self.fresh = False


def _packed_sample(step: int, sample: NDArray[Any]) -> bytes:
    """Return one sample as `pack` does: what stands before its numbers is the same every time."""
    return _head(sample.dtype.str, sample.shape) + step.to_bytes(8, "little") + sample.tobytes()


@lru_cache(maxsize=64)
def _head(kind: str, shape: tuple[int, ...]) -> bytes:
    """Return what `pack` puts before the step and the numbers of one little-endian sample."""
    steps, samples = np.zeros(1, np.int64), np.zeros((1, *shape), kind)
    return pack({"steps": steps, "samples": samples})[: -steps.nbytes - samples.nbytes]


def _under(prefix: str, arrays: Arrays) -> Arrays:
    return {
        key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)
    }


Answer = TypeVar("Answer")


@dataclass(frozen=True, kw_only=True)
class ObservationSpec:
    """What an observation of a card comes to on a robot."""

    name: str
    sensor: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    rate: float
    """Hz."""
    reckoning: str
    """How the shape comes about: `48 = 3 + 3 + 3 + ...`."""


def check_card(
    card: Card,
    robot: RobotSpec | None = None,
    *,
    where: Path | None = None,
    code_from: Path | None = None,
) -> tuple[ObservationSpec, ...]:
    """Check everything that a card says about a robot, without its checkpoint.

    Wrappers are tried on a sample of ones.

    Args:
        card: valid in itself.
        robot: the robot that the suite runs; None = the card's own.
        where: the card's file, for errors; None = they say the policy's name.
        code_from: as for `build_sensors`.

    Returns:
        One entry for each observation, in the order of the card.

    Raises:
        PolicyError: all problems, one line each: another robot, unknown joints or cameras, lists
            of wrong lengths, wrappers that do not fit, plug-ins that cannot be used.
    """
    place = f"card {card.name!r}" if where is None else str(where)
    try:
        own = get_robot(card.robot)
    except UsageError as error:
        raise PolicyError(f"{place}: {error}") from None
    if robot is not None and robot.name != card.robot:
        raise PolicyError(
            f"policy {card.name!r} drives the robot {card.robot!r}, the suite runs {robot.name!r}",
            fix=f"give --robot {card.robot}, or choose a policy for {robot.name}",
        )
    problems: list[str] = []
    can_move = True
    try:
        JointControl.from_card(card, own)
        actuator_values(card, own)
        motor_groups(card, own)
    except PolicyError as error:
        can_move = False
        problems.append(str(error))
    try:
        own = mounted_robot(own, card)
    except PolicyError as error:
        problems.append(str(error))
    # The form of what a policy sees is the same under every protocol.
    maker = Maker(card=card, robot=own, protocol=STRICT, rays=_no_rays, code_from=code_from)
    specs: list[ObservationSpec] = []
    for name, observation in card.observations.items():
        if isinstance(observation, ProprioObservation | ReferenceObservation) and not can_move:
            continue  # The joints are wrong; that has been said.
        try:
            pipeline = maker.pipeline(name, observation)
        except NwEvalError as error:
            problems.append(str(error))
        else:
            specs.append(_observation_spec(name, observation, pipeline))
    if problems:
        raise PolicyError([f"{place}: {problem}" for problem in problems])
    return tuple(specs)


def _observation_spec(
    name: str, observation: AnyObservation, pipeline: Pipeline
) -> ObservationSpec:
    spec = pipeline.chain.spec
    size = sized(name, spec.shape)
    sum_of = "" if observation.wrap else pipeline.measurement.sum_of
    return ObservationSpec(
        name=name,
        sensor=observation.sensor,
        shape=spec.shape,
        dtype=spec.dtype,
        rate=observation.rate,
        reckoning=f"{size} = {sum_of}" if sum_of and sum_of != str(spec.shape[0]) else size,
    )


def _no_rays() -> RayScene:
    raise AssertionError("a check casts no rays")
