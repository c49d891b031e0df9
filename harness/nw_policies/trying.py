"""Tries a checkpoint before any physics: the sizes of its inputs, and one action on zeros."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.reduction import ForkingPickler
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import NotFiniteError, NwEvalError, PolicyError
from nw_policies.bundle import Bundle
from nw_policies.cards.feeding import InputSpec, shape_problems, sized
from nw_policies.drawing import DrawingPolicy
from nw_policies.fed_policy import FedPolicy
from nw_policies.line import current_line
from nw_policies.opening import open_policy
from nw_policies.planned import PlannedPolicy, leave
from nw_policies.planning import InProcess

Answer = TypeVar("Answer")


class ShownInput(NamedTuple):
    """One observation that a card makes."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    reckoning: str
    """How the shape comes about."""


def try_bundle(
    bundle: Bundle,
    shown: Sequence[ShownInput],
    *,
    allow_code: bool,
    may_fail: bool,
    seconds: int | None = None,
) -> None:
    """Open the files of a bundle and ask them once: in the policy's process, where there is one.

    Args:
        bundle: card and files.
        shown: the observations that the card makes.
        allow_code: as for `open_policy`.
        may_fail: whether a NaN or inf that it answers to zeros is no fault.
        seconds: of processor time that it may take there; None = as many as there are.

    Raises:
        PolicyError: a file cannot be opened, wants another number of values than the card makes, or
            fails on zeros.
    """
    _ = bundle.joints  # The policy's process may not read the robot's files.
    arguments: dict[str, Any] = {
        "bundle": bundle,
        "shown": tuple(shown),
        "allow_code": allow_code,
        "may_fail": may_fail,
    }
    line = current_line()
    if line is None or bundle.card.python is not None:  # Another interpreter knows no `try`.
        try_on_zeros(**arguments)
    else:
        words = {"call": "try", "arguments": bytes(ForkingPickler.dumps((arguments, seconds)))}
        if operator := line.ask(words).get("operator"):
            leave(bundle, clean(str(operator), at_most=200))


def try_on_zeros(
    *, bundle: Bundle, shown: Sequence[ShownInput], allow_code: bool, may_fail: bool
) -> None:
    """As `try_bundle`, in this process."""
    arrays: dict[str, NDArray[Any]] = {
        one.name: np.zeros(one.shape, np.dtype(one.dtype)) for one in shown
    }
    sizes = {one.name: one.reckoning for one in shown}
    policy = open_policy(bundle, allow_code=allow_code)
    try:
        policy.reset(0)
        planned = policy if isinstance(policy, PlannedPolicy) else None
        own: Any = policy if planned is None else planned.policy
        fed_by = own.policy if isinstance(own, DrawingPolicy | InProcess) else own
        fed_by = fed_by.policy if isinstance(fed_by, DrawingPolicy) else fed_by
        own = fed_by
        if isinstance(fed_by, FedPolicy):
            own = fed_by.policy
            for feeder in fed_by.feeders:
                fed = _tried(feeder.bundle, feeder.network.inputs, feeder.run, arrays, sizes)
                sizes |= {name: sized(name, array.shape) for name, array in fed.items()}
                arrays |= fed
        _tried(bundle, own.inputs, own.act, arrays, sizes)
        if planned is not None:
            planned.act({one.name: arrays[one.name] for one in shown})
    except PolicyError as error:
        if not (may_fail and isinstance(error.__cause__, NotFiniteError)):
            raise
    finally:
        policy.close()


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
