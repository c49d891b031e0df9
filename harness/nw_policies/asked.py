"""Policies that are asked in messages: those in a process of their own, and what all have."""

from __future__ import annotations

import os
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from multiprocessing.reduction import ForkingPickler
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_base import errors
from nw_base.errors import NwEvalError, TrialError
from nw_base.memory import unpack
from nw_policies.cards.feeding import InputSpec
from nw_policies.line import PolicyLine, raised_there
from nw_policies.planned import read_planned, read_specs
from nw_policies.policy import Observation, checked_action
from nw_policies.policy_process import ACT, HEADER, layout, views

if TYPE_CHECKING:
    from nw_policies.bundle import Bundle, PlannedFile
    from nw_policies.cards.joint_control import Action

_PIECE = 2**16


@dataclass(frozen=True, kw_only=True)
class Served:
    """Description of the policy that a server serves, in the server's words."""

    digest: str
    """Hex SHA-256 of all that can change an action; `NOTHING` if the server gives none."""
    shapes: Mapping[str, tuple[int, ...]] = field(default_factory=dict[str, tuple[int, ...]])
    """Shapes of observations by name, where the server says them."""


class AskedPolicy:
    """A policy that is asked in messages: in a process here, or on a server."""

    served: Served | None = None
    """What its server serves, where it has one."""

    def __init__(self, name: str, *, joints: int) -> None:
        self._name = name
        self._joints = joints

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        """Send a message and return its answer.

        Raises:
            ServerError: there is none.
            TrialError: the policy failed.
        """
        raise NotImplementedError

    def no_state(self) -> NwEvalError:
        """Return the error for an answer that holds no state."""
        return TrialError(f"policy {self._name!r}: its state is not bytes")

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self.ask({"call": "reset", "seed": seed})

    def act(self, observation: Observation) -> Action:
        """Ask for an action.

        Raises:
            ServerError: no answer in time, or the connection is gone.
            TrialError: the policy failed there, or its action is none.
        """
        arrays = {name: np.ascontiguousarray(array) for name, array in observation.items()}
        answer = self.ask({"call": "act", "observation": arrays})
        return checked_action(answer.get("action"), joints=self._joints, policy=self._name)

    def state(self) -> bytes:
        """Return the policy's state."""
        state = self.ask({"call": "state"}).get("state")
        if not isinstance(state, bytes):
            raise self.no_state()
        return state

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self.ask({"call": "restore", "state": state})


def files_over(line: PolicyLine, bundle: Bundle) -> dict[str, PlannedFile]:
    """Return what the ONNX files of a bundle were planned into by the process behind a line.

    Raises:
        PolicyError: a file cannot be planned.
    """
    number = line.number()
    try:
        return _planned_by(line, {"call": "plan", "bundle": pickled(bundle)}, number)
    finally:
        line.forget(number)


def _planned_by(line: PolicyLine, words: Mapping[str, Any], number: int) -> dict[str, PlannedFile]:
    try:
        return read_planned(line.ask(words, policy=number)["files"])
    except (KeyError, TypeError, ValueError):
        line.lost()


class ApartPolicy(AskedPolicy):
    """A policy in a process of its own.

    Args:
        bundle: of the policy.
        line: to the process.
        joints: how many numbers an action has.
        allow_code: as for `open_policy`.

    Attributes:
        inputs: what the checkpoint declares to take.
        network_inputs: what the files of the networks declare that feed it, by name.
        served: for a remote policy, what its server serves.

    Raises:
        PolicyError: as `open_policy`.
    """

    def __init__(self, bundle: Bundle, line: PolicyLine, *, joints: int, allow_code: bool) -> None:
        super().__init__(bundle.name, joints=joints)
        self._line, self._number = line, line.number()
        self._is_remote = bundle.card.adapter == "remote"
        self._names: AbstractSet[str] = frozenset()
        self._board: list[tuple[str, NDArray[Any], tuple[int, ...], np.dtype[Any]]] = []
        self._question = HEADER.pack(ACT, self._number, 0, 0)
        self._answer = HEADER.pack(ACT, self._number, 0, 8 * joints)
        self._is_open = True
        try:
            opened = self.ask({"call": "open", **_meant(bundle, joints, allow_code=allow_code)})
        except BaseException:
            line.forget(self._number)
            raise
        try:
            self.inputs = read_specs(opened["inputs"])
            networks = {str(name): read_specs(specs) for name, specs in opened["networks"].items()}
            self.network_inputs: dict[str, tuple[InputSpec, ...]] = networks
            self._remembers = opened["remembers"] is not False
            if self._is_remote:
                self.served = Served(digest=str(opened["digest"]))
        except (KeyError, TypeError, ValueError, AttributeError):
            line.lost()

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        """Send a message to the process and return its answer, or raise its exception."""
        if not self._is_open:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        return self._line.ask(message, policy=self._number, has_server=self._is_remote)

    def act(self, observation: Observation) -> Action:
        """Show the process an observation, and return its action, which is not checked yet.

        Raises:
            TrialError: the policy failed there.
        """
        try:
            if self._names != observation.keys():
                self._lay_out(observation)
            for name, view, shape, dtype in self._board:
                array = observation[name]
                if array.shape != shape or array.dtype != dtype:
                    self._lay_out(observation)
                    return self.act(observation)
                view[...] = array
        except ValueError as error:
            raise TrialError(f"policy {self._name!r}: {error}") from None
        line = self._line.line
        try:
            if not self._is_open:
                raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
            os.write(line.writes, self._question)
            heard = os.read(line.reads, _PIECE)
            if heard.startswith(self._answer) and len(heard) == HEADER.size + 8 * self._joints:
                return np.frombuffer(heard, np.float64, offset=HEADER.size).copy()
            fault = line.rest_of(heard).words["error"]
        except (OSError, EOFError, ValueError, KeyError, RecursionError):
            self._line.lost()
        raise raised_there(fault, has_server=self._is_remote)

    def state(self) -> bytes:
        """Return the policy's state; one that remembers nothing is not asked."""
        return super().state() if self._remembers else b""

    @property
    def held(self) -> dict[str, NDArray[Any]]:
        """What the networks gave last that feed the policy, by name."""
        if not self.network_inputs:
            return {}
        try:
            return unpack(self.ask({"call": "held"})["arrays"])
        except (KeyError, TypeError, ValueError):
            self._line.lost()

    def planned(self, shown: Observation) -> dict[str, PlannedFile]:
        """Return what its files are planned into for observations of these sizes.

        Raises:
            PolicyError: a file cannot be planned.
        """
        words = {"call": "plan", "shown": layout(shown)}
        return _planned_by(self._line, words, self._number)

    def close(self) -> None:
        """Close the policy; the process lives on for others."""
        if self._is_open:
            try:
                self.ask({"call": "close"})
            finally:
                self._is_open = False
                self._line.forget(self._number)

    def _lay_out(self, observation: Observation) -> None:
        """Agree on where observations of these names, shapes and types lie."""
        places = layout(observation)
        self.ask({"call": "board", "arrays": places})
        arrays = views(self._line.board, places)
        self._names = arrays.keys()
        self._board = [(name, view, view.shape, view.dtype) for name, view in arrays.items()]


def _meant(bundle: Bundle, joints: int, *, allow_code: bool) -> dict[str, Any]:
    """Return what a policy's process is to open, as our own or another interpreter reads it.

    Raises:
        PolicyError: code that another one runs is not allowed.
    """
    card = bundle.card
    if card.python is None:
        return {"bundle": pickled((bundle, allow_code))}
    if not allow_code:
        raise code_refused(bundle)
    return {
        "adapter": card.adapter,
        "name": bundle.name,
        "where": bundle.where,
        "folder": str(bundle.folder.resolve()),
        "checkpoint": None if bundle.checkpoint is None else str(bundle.checkpoint.resolve()),
        "options": card.options,
        "joints": joints,
    }


def code_refused(bundle: Bundle) -> errors.PolicyError:
    """Return the error for code that the caller does not allow."""
    return errors.PolicyError(
        f"{bundle.where}: `{bundle.card.adapter}` imports and runs Python code",
        fix="add --allow-code if you trust it, or use `remote` and run it elsewhere",
    )


def pickled(value: Any) -> bytes:
    """Return a value as `_loaded` reads it in the policy's process."""
    return bytes(ForkingPickler.dumps(value))
