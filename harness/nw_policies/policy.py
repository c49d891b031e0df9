"""The interface of a running policy of any file format, and the checks of its actions.

In a trial they wait for their latency, and pass through a filter.

A file of weights that runs is a network: numbers in, numbers out, and a memory between. Its inputs
are put together from observations by an `InputAssembler`; a policy that is one network has the
action as one of its outputs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import (
    ActionError,
    CodeError,
    NotFiniteError,
    NwEvalError,
    PolicyError,
    TrialError,
    nearest,
)
from nw_base.memory import Arrays, Memory, unpack
from nw_policies.bundle import Bundle
from nw_policies.cards.card import Card
from nw_policies.cards.control import LowPass
from nw_policies.cards.feeding import InputSpec, resolve_inputs
from nw_policies.cards.joint_control import Action, JointControl
from nw_policies.policy_process import FaultError, all_finite, as_action

__all__ = ["Observation", "Policy", "all_finite", "checked_action", "raised"]

_KINDS = {kind.__name__: kind for kind in (ActionError, CodeError, NotFiniteError, TrialError)}

Observation = Mapping[str, NDArray[Any]]
"""Observation names of the card to arrays, without a batch axis."""


class Policy(Memory[bytes], Protocol):
    """A policy in one trial. It has one thread, batch 1 and no randomness of its own.

    It is used as `reset`, then `act` once for each control step, then `close`. Two policies share
    nothing that changes, so trials do not depend on what ran before them.
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


def checked_action(raw: Any, *, joints: int, policy: str) -> Action:
    """Return a checkpoint's output as an action of its own memory.

    Args:
        raw: the output, (joints,) or with leading axes of length 1.
        joints: how many numbers an action has.
        policy: name of the policy, for errors.

    Raises:
        ActionError: the output has another size or is not finite.
    """
    try:
        return as_action(raw, joints=joints, policy=policy)
    except FaultError as fault:
        raise raised(fault) from None


def raised(fault: FaultError) -> NwEvalError:
    """Return a fault of a policy as the error that it is here."""
    return _KINDS[fault.kind](str(fault), fix=fault.fix)


@contextmanager
def unpacked(state: bytes, policy: str) -> Generator[Arrays]:
    """Give the arrays that `arrays.pack` made a state of, to be taken in the `with` block.

    Raises:
        TrialError: the bytes are no such state, or the block finds that the arrays do not fit.
    """
    try:
        arrays = unpack(state)
    except ValueError as error:
        raise unfitting(policy, str(error)) from None
    forms = {name: (array.shape, array.dtype) for name, array in arrays.items()}
    try:
        yield arrays
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise unfitting(policy, f"{error!r}, it has {forms}") from None


def unfitting(policy: str, reason: str) -> TrialError:
    """Return the error for a state that belongs to something else."""
    return TrialError(
        f"the state does not fit policy {policy!r}: {reason}",
        fix="continue a trial with the checkpoint and card that it was started with",
    )


Array = NDArray[np.float64]


class ActionDelay:
    """Actions on their way to the motors: each is applied `steps` control steps late.

    Until the first one arrives, zeros are applied.
    """

    def __init__(self, steps: int, joints: int = 12) -> None:
        self._steps = steps
        self._joints = joints
        self._waiting: deque[Action] = deque()
        self.reset()

    def reset(self) -> None:
        """Fill the queue with zeros."""
        self._waiting = deque(np.zeros(self._joints) for _ in range(self._steps))

    def push(self, action: Action) -> Action:
        """Queue a new action and return the one to apply now."""
        self._waiting.append(action.copy())
        return self._waiting.popleft()

    def state(self) -> bytes:
        """Return the actions that still wait, oldest first."""
        return b"".join(action.tobytes() for action in self._waiting)

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of a queue of the same length."""
        actions = np.frombuffer(state, dtype=np.float64).reshape(self._steps, self._joints)
        self._waiting = deque(action.copy() for action in actions)


class ActionFilter:
    """A filter of one trial's actions. Made anew for each trial; it starts at rest.

    Args:
        low_pass: from the card.
        rate: actions per second, Hz.
        rest: (12,) the raw action that came before the first one.
        limits: of raw actions, before they are filtered.
    """

    def __init__(
        self, low_pass: LowPass, *, rate: float, rest: Array, limits: tuple[float, float]
    ) -> None:
        b, a = low_pass.coefficients(rate)
        self._first = float(b[0])
        self._b, self._a = b[1:, np.newaxis], a[1:, np.newaxis]
        self._limits = limits
        # Earlier actions and what was made of them, (order, 12) each, the newest first.
        self._x = np.tile(rest, (len(b) - 1, 1))
        self._y = self._x.copy()

    @classmethod
    def from_card(cls, card: Card, control: JointControl) -> ActionFilter | None:
        """Return the filter of a card that is at rest in its default pose; None without one."""
        if card.control.filter is None:
            return None
        rest = np.zeros_like(control.scale)
        absolute = np.array(control.kinds) == "joint_position"
        turned = absolute & (control.scale != 0.0)
        np.divide(control.default_pose, control.scale, out=rest, where=turned)
        return cls(
            card.control.filter,
            rate=card.control.rate,
            rest=rest,
            limits=(control.low, control.high),
        )

    @property
    def output(self) -> Action:
        """The last returned action, (12,)."""
        return self._y[0]

    def push(self, action: Action) -> Action:
        """Take a new raw action, (12,), and return the one to apply."""
        x = np.clip(action, *self._limits)
        past = (self._b * self._x).sum(axis=0) - (self._a * self._y).sum(axis=0)
        self._x = np.vstack([x, self._x[:-1]])
        self._y = np.vstack([self._first * x + past, self._y[:-1]])
        return self.output

    def state(self) -> bytes:
        """Return the last raw actions and the last filtered ones."""
        return np.stack([self._x, self._y]).tobytes()

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of a filter of the same order."""
        self._x, self._y = np.frombuffer(state).reshape(2, *self._x.shape).copy()


Wanted = Sequence[str | int | None]
"""Outputs of a file, by name or by index among those that feed no state; None = the first one."""


class OpenNetwork(Memory[bytes], Protocol):
    """A file of weights in one trial, on one thread, with batch 1 and without randomness."""

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the file declares to take; empty where its format does not say."""
        ...

    def reset(self, seed: int) -> None:
        """Begin a trial with the memory that the file holds."""
        ...

    def run(self, observation: Observation) -> tuple[NDArray[Any], ...]:
        """Return the outputs that it was opened for; they may change with the next call.

        Args:
            observation: by the names that the card's `inputs` have, without a batch axis.

        Raises:
            TrialError: it failed.
        """
        ...

    def close(self) -> None:
        """Free what it holds. Closing twice is allowed."""
        ...


def place_of(wanted: str | int | None, names: Sequence[str], bundle: Bundle) -> int:
    """Return which of the outputs of a file is meant.

    Raises:
        PolicyError: there is no such output.
    """
    if isinstance(wanted, str) and wanted in names:
        return names.index(wanted)
    place = 0 if wanted is None else wanted
    if isinstance(place, int) and place < len(names):
        return place
    raise PolicyError(
        f"{bundle.where}: the checkpoint has no output {wanted!r}", fix=nearest(str(wanted), names)
    )


class ActingNetwork:
    """A network that was opened for one output, whose numbers are checked as an action."""

    def __init__(self, network: OpenNetwork, *, joints: int, policy: str) -> None:
        self.network = network
        self._joints = joints
        self._policy = policy

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take; empty where its format does not say."""
        return self.network.inputs

    @property
    def remembers(self) -> bool:
        """Whether the network has a memory, or may have one."""
        return getattr(self.network, "remembers", True)

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self.network.reset(seed)

    def act(self, observation: Observation) -> Action:
        """Run the network once.

        Raises:
            ActionError: the output is no action.
            TrialError: the network failed.
        """
        (raw,) = self.network.run(observation)
        return self.action(raw)

    def action(self, raw: NDArray[Any]) -> Action:
        """Return the network's output as an action.

        Raises:
            ActionError: the output is not a valid action.
        """
        return checked_action(raw, joints=self._joints, policy=self._policy)

    def state(self) -> bytes:
        """Return the network's memory."""
        return self.network.state()

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self.network.restore(state)

    def close(self) -> None:
        """Free the network."""
        self.network.close()


class InputAssembler:
    """Joins, casts and batches observations. Made once for a policy, called at every step."""

    def __init__(self, card: Card, specs: Sequence[InputSpec]) -> None:
        """Resolve the card's inputs against those of a checkpoint.

        Args:
            card: names inputs and the observations that they are made of.
            specs: inputs of the checkpoint in its order; empty if its format does not say.

        Raises:
            PolicyError: the card and the checkpoint name other inputs.
        """
        # Inputs, with the names of the observations that make them.
        self.parts = resolve_inputs(card, specs)

    def __call__(self, observation: Observation) -> dict[str, NDArray[Any]]:
        """Return the inputs of a checkpoint that declares them, by name, with a batch axis of 1.

        Each has memory of its own, which no other input, step or log shares: networks normalise
        their inputs in place (`obs.clamp_(...)`), and a sensor shows one sample at several steps.
        """
        return {spec.name: _joined(spec, names, observation) for spec, names in self.parts}

    def in_order(self, observation: Observation) -> list[NDArray[Any] | list[NDArray[Any]]]:
        """Return the same for one that declares none, in the card's order, and lists as lists."""
        return [
            [_joined(spec, (name,), observation) for name in names]
            if spec.is_list
            else _joined(spec, names, observation)
            for spec, names in self.parts
        ]


def _joined(spec: InputSpec, names: Sequence[str], observation: Observation) -> NDArray[Any]:
    if len(names) == 1:
        joined = np.array(observation[names[0]], dtype=spec.dtype, order="C")
    else:
        joined = np.concatenate([observation[name] for name in names], dtype=spec.dtype)
    if len(spec.shape) != joined.ndim:
        joined = joined[np.newaxis]
    return np.ascontiguousarray(joined)
