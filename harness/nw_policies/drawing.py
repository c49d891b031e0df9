"""Policies that may draw noise: torch's generator is the trial's, and part of their state.

Variational estimators and stochastic heads draw from torch's own generator. It is seeded as a trial
begins, so a policy that draws repeats, and a trial that goes on from a state draws what it drew.
"""

from __future__ import annotations

import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from nw_base.confinement import fence_stands
from nw_policies.policy import unfitting

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nw_policies.cards.feeding import InputSpec
    from nw_policies.cards.joint_control import Action
    from nw_policies.policy import Observation, Policy

_MARK = b"nw-eval torch generator\0"
"""What the state of a policy begins with that has drawn."""
_SIZE = 8  # bytes of the length of the generator's state


class DrawingPolicy:
    """A policy that may draw from torch's generator.

    Args:
        policy: as its adapter opened it.
        name: of the policy, for errors.

    Attributes:
        policy: the same.
    """

    def __init__(self, policy: Policy, *, name: str) -> None:
        self.policy = policy
        self._name = name
        self._first = b""
        self._own = b""
        # A policy's process has no other use of the generator.
        self._shares = not fence_stands()

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take."""
        return self.policy.inputs

    @property
    def network_inputs(self) -> dict[str, tuple[InputSpec, ...]]:
        """What the files of its networks declare to take."""
        return getattr(self.policy, "network_inputs", {})

    @property
    def held(self) -> dict[str, NDArray[Any]]:
        """What its networks gave last."""
        return getattr(self.policy, "held", {})

    def reset(self, seed: int) -> None:
        """Begin a trial: seed the generator, then the policy."""
        self._own = self._first = _seeded(seed)
        with self._drawing():
            self.policy.reset(seed)

    def act(self, observation: Observation) -> Action:
        """Ask the policy; raises as that."""
        if not self._shares:
            return self.policy.act(observation)
        with self._drawing():
            return self.policy.act(observation)
        raise AssertionError("no exception vanishes")

    def state(self) -> bytes:
        """Return the policy's state, and the generator's if it has drawn."""
        state = self.policy.state()
        generator = self._own if self._shares else _generator()
        if generator == self._first:
            return state
        return _MARK + len(generator).to_bytes(_SIZE, "little") + generator + state

    def restore(self, state: bytes) -> None:
        """Go back to a `state`.

        Raises:
            TrialError: the state belongs to another policy.
        """
        drawn, own = self._first, state
        if state.startswith(_MARK):
            rest = state[len(_MARK) :]
            end = _SIZE + int.from_bytes(rest[:_SIZE], "little")
            drawn, own = rest[_SIZE:end], rest[end:]
        self.policy.restore(own)
        self._own = drawn
        try:
            if not self._shares:
                _set_generator(drawn)
        except RuntimeError as error:
            raise unfitting(self._name, str(error)) from None

    def close(self) -> None:
        """Close the policy."""
        self.policy.close()

    @contextmanager
    def _drawing(self) -> Generator[None]:
        """Let the policy draw from the trial's generator, and leave the caller's as it was."""
        before = _generator()
        try:
            _set_generator(self._own)
        except RuntimeError as error:
            raise unfitting(self._name, str(error)) from None
        try:
            yield
        finally:
            self._own = _generator()
            if self._shares:
                _set_generator(before)


def _seeded(seed: int) -> bytes:
    """Return the state of torch's generator for a seed; empty if torch is not imported."""
    torch = sys.modules.get("torch")
    if torch is None:
        return b""
    return torch.Generator().manual_seed(seed).get_state().numpy().tobytes()


def _generator() -> bytes:
    torch = sys.modules.get("torch")
    return b"" if torch is None else torch.get_rng_state().numpy().tobytes()


def _set_generator(state: bytes) -> None:
    torch = sys.modules.get("torch")
    if torch is not None and state:
        torch.set_rng_state(torch.frombuffer(bytearray(state), dtype=torch.uint8))
