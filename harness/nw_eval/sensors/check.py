"""Checks a card against its robot and its checkpoint, before any physics."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import NwEvalError, PolicyError, UsageError
from nw_eval.policies import (
    Bundle,
    Card,
    InputSpec,
    JointControl,
    Policy,
    actuator_values,
    open_policy,
)
from nw_eval.policies.adapters.fed_policy import FedPolicy
from nw_eval.policies.inputs import shape_problems
from nw_eval.policies.observations import (
    AnyObservation,
    ProprioObservation,
    ScandotsObservation,
)
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.scenes.rays import RayScene
from nw_eval.sensors.measurements import Maker, Pipeline
from nw_eval.sensors.proprio import Proprio

Answer = TypeVar("Answer")


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
            fix="choose a policy for that robot, or another suite",
        )
    problems: list[str] = []
    can_move = True
    try:
        JointControl.from_card(card, own)
        actuator_values(card, own)
    except PolicyError as error:
        can_move = False
        problems.append(str(error))
    # The form of what a policy sees is the same under every protocol.
    maker = Maker(card=card, robot=own, protocol="strict", rays=_no_rays, code_from=code_from)
    specs: list[ObservationSpec] = []
    for name, observation in card.observations.items():
        if isinstance(observation, ProprioObservation) and not can_move:
            continue  # The joints are wrong; that has been said.
        try:
            made = maker.pipeline(name, observation)
        except NwEvalError as error:
            problems.append(str(error))
        else:
            specs.append(_observation_spec(name, observation, made))
    if problems:
        raise PolicyError([f"{place}: {problem}" for problem in problems])
    return tuple(specs)


def check_bundle(
    bundle: Bundle, robot: RobotSpec | None = None, *, allow_code: bool = False
) -> tuple[ObservationSpec, ...]:
    """Check a card against its robot and its files of weights: sizes, and one action on zeros.

    Args:
        bundle: card and checkpoint.
        robot: the robot that the suite runs; None = the card's own.
        allow_code: whether Python code that the card names may be imported.

    Raises:
        PolicyError: as `check_card`; the checkpoint, or a network that feeds it, cannot be loaded,
            wants another number of values than the card makes, or fails on zeros.
    """
    code_from = bundle.folder if allow_code else None
    specs = check_card(bundle.card, robot, where=bundle.card_path, code_from=code_from)
    given = {spec.name: np.zeros(spec.shape, spec.dtype) for spec in specs}
    made = {spec.name: spec.reckoning for spec in specs}
    policy = open_policy(bundle, allow_code=allow_code)
    try:
        policy.reset(0)
        own: Policy = policy
        if isinstance(policy, FedPolicy):
            own = policy.policy
            for feeder in policy.feeders:
                fed = _tried(feeder.bundle, feeder.network.inputs, feeder.run, given, made)
                made |= {name: _sized(name, array.shape) for name, array in fed.items()}
                given |= fed
        _tried(bundle, own.inputs, own.act, given, made)
    finally:
        policy.close()
    return specs


def _tried(
    bundle: Bundle,
    inputs: Sequence[InputSpec],
    run: Callable[[Mapping[str, NDArray[Any]]], Answer],
    given: Mapping[str, NDArray[Any]],
    made: Mapping[str, str],
) -> Answer:
    """Return what a file answers to zeros, or to what zeros made other files answer.

    Args:
        bundle: of the file.
        inputs: what it declares to take.
        run: asks it.
        given: by name, all that it may be given.
        made: how the size of each of them comes about.

    Raises:
        PolicyError: an input wants another number of values, or the file fails.
    """
    used = {name for _, names in bundle.card.input_parts() for name in names}
    sums = "; ".join(text for name, text in made.items() if name in used)
    shapes = {name: array.shape for name, array in given.items()}
    if problems := shape_problems(bundle.card, inputs, shapes):
        raise PolicyError(
            [f"{bundle.where}: {problem}" for problem in problems], fix=f"the card makes {sums}"
        )
    try:
        return run(given)
    except NwEvalError as error:
        if len(used) == 1 and (wanted := _wanted_size(str(error), shapes[min(used)])) is not None:
            raise PolicyError(
                f"{bundle.where}: `{min(used)}` is {shapes[min(used)][0]} numbers; the "
                f"checkpoint's first layer wants {wanted}",
                fix=f"the card makes {sums}",
            ) from None
        raise PolicyError(
            f"{bundle.where}: on an observation of zeros, {error}",
            fix=f"compare with what the card makes: {sums}",
        ) from None


def _wanted_size(text: str, given: tuple[int, ...]) -> int | None:
    """Return how many numbers a checkpoint wants that declares none, if torch's error says it."""
    clash = re.search(r"shapes cannot be multiplied \(1x(\d+) and (\d+)x\d+\)", text)
    if clash is None or given != (int(clash[1]),):
        return None
    return int(clash[2])


def _observation_spec(name: str, observation: AnyObservation, made: Pipeline) -> ObservationSpec:
    spec = made.chain.spec
    size = _sized(name, spec.shape)
    sum_of = ""
    if not observation.wrap:
        if isinstance(observation, ScandotsObservation):
            sum_of = f"{observation.x[2]} x {observation.y[2]}"
        elif isinstance(observation, ProprioObservation) and isinstance(made.measurement, Proprio):
            sum_of = " + ".join(str(part) for part in made.measurement.frame_sizes)
            if observation.history is not None:
                sum_of = f"{observation.history.steps} x ({sum_of})"
    return ObservationSpec(
        name=name,
        sensor=observation.sensor,
        shape=spec.shape,
        dtype=spec.dtype,
        rate=observation.rate,
        reckoning=f"{size} = {sum_of}" if sum_of and sum_of != str(spec.shape[0]) else size,
    )


def _sized(name: str, shape: tuple[int, ...]) -> str:
    return f"`{name}` {' x '.join(str(side) for side in shape)}"


def _no_rays() -> RayScene:
    raise AssertionError("a check casts no rays")
