"""Checks a card against its robot and its checkpoint, before any physics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from nw_eval.cards import Card, JointControl, actuator_values, mounted_robot
from nw_eval.cards.inputs import sized
from nw_eval.cards.observations import AnyObservation, ProprioObservation
from nw_eval.errors import NwEvalError, PolicyError, UsageError
from nw_eval.protocol import STRICT
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.build import Maker, Pipeline

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
        if isinstance(observation, ProprioObservation) and not can_move:
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
