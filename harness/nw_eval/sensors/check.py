"""Checks a card against its robot and its checkpoint, before any physics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nw_eval.errors import NwEvalError, PolicyError, UsageError, nearest
from nw_eval.policies import Bundle, Card, JointControl, actuator_values, open_policy
from nw_eval.policies.inputs import shape_problems
from nw_eval.policies.observations import (
    AnyObservation,
    ProprioObservation,
    ScandotsObservation,
    SplatRgbObservation,
)
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.sensors.proprio import Proprio
from nw_eval.sensors.scandots import grid
from nw_eval.sensors.splat_image import image_shape


@dataclass(frozen=True, kw_only=True)
class ObservationSpec:
    """What an observation of a card comes to on a robot."""

    name: str
    sensor: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    rate: int
    """Hz."""
    reckoning: str
    """How the shape comes about: `48 = 3 + 3 + 3 + ...`."""


def check_card(card: Card, robot: RobotSpec | None = None) -> tuple[ObservationSpec, ...]:
    """Check everything that a card says about a robot, without its checkpoint.

    Args:
        card: valid in itself.
        robot: the robot that the suite runs; None = the card's own.

    Returns:
        One entry for each observation, in the order of the card.

    Raises:
        PolicyError: all problems, one line each: another robot, unknown joints or cameras, lists
            of wrong lengths.
    """
    try:
        own = get_robot(card.robot)
    except UsageError as error:
        raise PolicyError(f"card {card.name!r}: {error}") from None
    if robot is not None and robot.name != card.robot:
        raise PolicyError(
            f"policy {card.name!r} drives the robot {card.robot!r}, the suite runs {robot.name!r}",
            fix="choose a policy for that robot, or another suite",
        )
    problems: list[str] = []
    control: JointControl | None = None
    try:
        control = JointControl.from_card(card, own)
        actuator_values(card, own)
    except PolicyError as error:
        problems.append(str(error))
    specs: list[ObservationSpec] = []
    for name, observation in card.observations.items():
        try:
            spec = _observation_spec(name, observation, card, own, control)
        except NwEvalError as error:
            problems.append(str(error))
        else:
            specs.extend([spec] if spec is not None else [])
    if problems:
        raise PolicyError("\n".join(f"card {card.name!r}: {problem}" for problem in problems))
    return tuple(specs)


def check_bundle(bundle: Bundle, robot: RobotSpec | None = None) -> tuple[ObservationSpec, ...]:
    """Check a card against its robot and its checkpoint: sizes, and one action on zeros.

    Raises:
        PolicyError: as `check_card`; the checkpoint cannot be loaded; an input wants another
            number of values than the card makes; the checkpoint fails on an observation of zeros.
    """
    specs = check_card(bundle.card, robot)
    shapes = {spec.name: spec.shape for spec in specs}
    policy = open_policy(bundle)
    try:
        problems = shape_problems(bundle.card, policy.inputs, shapes)
        if problems:
            sums = "; ".join(spec.reckoning for spec in specs)
            raise PolicyError(
                "\n".join(f"{bundle.card_path}: {problem}" for problem in problems),
                fix=f"the card makes {sums}",
            )
        policy.reset(0)
        try:
            policy.act({spec.name: np.zeros(spec.shape, spec.dtype) for spec in specs})
        except NwEvalError as error:
            sums = "; ".join(spec.reckoning for spec in specs)
            raise PolicyError(
                f"{bundle.card_path}: on an observation of zeros, {error}",
                fix=f"compare with what the card makes: {sums}",
            ) from None
    finally:
        policy.close()
    return specs


def _observation_spec(
    name: str,
    observation: AnyObservation,
    card: Card,
    robot: RobotSpec,
    control: JointControl | None,
) -> ObservationSpec | None:
    shape: tuple[int, ...]
    match observation:
        case ProprioObservation():
            if control is None:
                return None  # The joints are wrong; that has been said.
            proprio = Proprio(name, observation, card.command, control)
            shape, dtype = proprio.shape, proprio.dtype
            sizes = " + ".join(str(size) for size in proprio.frame_sizes)
            if observation.history is not None:
                sizes = f"{observation.history.steps} x ({sizes})"
            equation = f" = {sizes}" if sizes != str(shape[0]) else ""
            reckoning = f"`{name}` {shape[0]}{equation}"
        case ScandotsObservation():
            shape, dtype = (len(grid(observation)),), np.dtype(np.float32)
            reckoning = f"`{name}` {shape[0]} = {observation.x[2]} x {observation.y[2]}"
        case SplatRgbObservation():
            if observation.camera not in robot.cameras:
                raise PolicyError(
                    f"`{name}`: {robot.name} has no camera {observation.camera!r}",
                    fix=nearest(observation.camera, robot.cameras),
                )
            shape, dtype = image_shape(observation), np.dtype(observation.dtype)
            reckoning = f"`{name}` {' x '.join(str(side) for side in shape)}"
    return ObservationSpec(
        name=name,
        sensor=observation.sensor,
        shape=shape,
        dtype=dtype,
        rate=observation.rate,
        reckoning=reckoning,
    )
