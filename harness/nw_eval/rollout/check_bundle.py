"""Checks a checkpoint against its card, before any physics: sizes, and one action on zeros."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.inputs import InputSpec, shape_problems
from nw_eval.errors import NotFiniteError, NwEvalError, PolicyError
from nw_eval.policies import Bundle, Policy, open_policy
from nw_eval.policies.feeding.fed_policy import FedPolicy
from nw_eval.robots import RobotSpec
from nw_eval.sensors.check import ObservationSpec, check_card, sized

Answer = TypeVar("Answer")


def check_bundle(
    bundle: Bundle,
    robot: RobotSpec | None = None,
    *,
    allow_code: bool = False,
    may_fail: bool = False,
) -> tuple[ObservationSpec, ...]:
    """Check a card against its robot and its files of weights: sizes, and one action on zeros.

    Args:
        bundle: card and checkpoint.
        robot: the robot that the suite runs; None = the card's own.
        allow_code: whether Python code that the card names may be imported.
        may_fail: whether a NaN or inf that it answers to zeros is left to its trials, which fail
            of it: it is the policy's own failure, and no fault of the card.

    Raises:
        PolicyError: as `check_card`; the checkpoint, or a network that feeds it, cannot be loaded,
            wants another number of values than the card makes, or fails on zeros.
    """
    code_from = bundle.folder if allow_code else None
    specs = check_card(bundle.card, robot, where=bundle.card_path, code_from=code_from)
    arrays = {spec.name: np.zeros(spec.shape, spec.dtype) for spec in specs}
    sizes = {spec.name: spec.reckoning for spec in specs}
    policy = open_policy(bundle, allow_code=allow_code)
    try:
        policy.reset(0)
        own: Policy = policy
        if isinstance(policy, FedPolicy):
            own = policy.policy
            for feeder in policy.feeders:
                fed = _tried(feeder.bundle, feeder.network.inputs, feeder.run, arrays, sizes)
                sizes |= {name: sized(name, array.shape) for name, array in fed.items()}
                arrays |= fed
        _tried(bundle, own.inputs, own.act, arrays, sizes)
    except PolicyError as error:
        if not (may_fail and isinstance(error.__cause__, NotFiniteError)):
            raise
    finally:
        policy.close()
    return specs


def _tried(
    bundle: Bundle,
    inputs: Sequence[InputSpec],
    run: Callable[[Mapping[str, NDArray[Any]]], Answer],
    arrays: Mapping[str, NDArray[Any]],
    sizes: Mapping[str, str],
) -> Answer:
    """Return what a file answers to zeros, or to what zeros made other files answer.

    Args:
        bundle: of the file.
        inputs: what it declares to take.
        run: asks it.
        arrays: by name, all that it may take.
        sizes: how the size of each of them comes about.

    Raises:
        PolicyError: an input wants another number of values, or the file fails.
    """
    used = {name for _, names in bundle.card.input_parts() for name in names}
    sums = "; ".join(text for name, text in sizes.items() if name in used)
    shapes = {name: array.shape for name, array in arrays.items()}
    if problems := shape_problems(bundle.card, inputs, shapes):
        raise PolicyError(
            [f"{bundle.where}: {problem}" for problem in problems], fix=f"the card makes {sums}"
        )
    try:
        return run(arrays)
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
        ) from error


def _wanted_size(text: str, shape: tuple[int, ...]) -> int | None:
    """Return how many numbers a checkpoint wants that declares none, if torch's error says it."""
    clash = re.search(r"shapes cannot be multiplied \(1x(\d+) and (\d+)x\d+\)", text)
    if clash is None or shape != (int(clash[1]),):
        return None
    return int(clash[2])
