"""What a running policy is, whatever file it came from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.inputs import InputSpec
from nw_eval.cards.joint_control import Action
from nw_eval.errors import ActionError, NotFiniteError
from nw_eval.memory import Memory

Observation = Mapping[str, NDArray[Any]]
"""Observation names of the card to arrays, without a batch axis."""


class Policy(Memory[bytes], Protocol):
    """A policy in one trial. It has one thread, batch 1 and no randomness of its own.

    It is used as `reset`, then `act` once for each control step, then `close`. Two policies share
    nothing, so trials do not depend on what ran before them.
    """

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take; empty where its format does not say."""
        ...

    def reset(self, seed: int) -> None:
        """Begin a trial: forget the last one, and seed whatever is random."""
        ...

    def act(self, observation: Observation) -> Action:
        """Return the raw action for an observation.

        Raises:
            ActionError: the action has another shape, inf or NaN.
            ServerError: the policy's server could not be asked, which is no failure of the policy.
            TrialError: the checkpoint failed otherwise.
        """
        ...

    def close(self) -> None:
        """Free what the policy holds. Closing twice is allowed."""
        ...


def all_finite(values: NDArray[np.float64]) -> bool:
    """Whether no number of a short vector is inf or NaN."""
    # A sum is finite only if all of its parts are; sums of finite numbers overflow hardly ever.
    # Right after a network has run, plain numbers take 2 us here and NumPy's functions 10.
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())


def checked_action(raw: Any, *, joints: int, policy: str) -> Action:
    """Return a checkpoint's output as an action of its own memory.

    Args:
        raw: the output, (joints,) or with leading axes of length 1.
        joints: how many numbers an action has.
        policy: name of the policy, for errors.

    Raises:
        ActionError: the output has another size or is not finite.
    """
    array = np.asarray(raw)
    if array.size != joints or array.shape[-1:] != (joints,):
        raise ActionError(
            f"policy {policy!r} returned an action of shape {array.shape}",
            fix=f"the card's robot has {joints} joints: check `output` on the card",
        )
    action = np.array(array.reshape(joints), dtype=np.float64)
    if not all_finite(action):
        index = int(np.argmin(np.isfinite(action)))
        raise NotFiniteError(
            f"policy {policy!r} returned {action[index]} for joint {index} of its action",
            fix="check the checkpoint, and the observations' scales on its card",
        )
    return action
