"""Policies in a process of their own, as the process that asks them sees them.

`open_policy` comes here where this process has a line to one, which `line_to` gives it; see
`rollout.confined.start`, which starts both. What goes over the line is in `policy_process`.
Everything that comes back is bounded and checked: the process may be a hostile file's by now.
"""

from __future__ import annotations

import mmap
import os
import resource
import signal
import tempfile
from collections.abc import Callable, Generator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from multiprocessing.reduction import ForkingPickler
from typing import TYPE_CHECKING, Any, NoReturn
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from nw_eval import errors
from nw_eval.cards.networks import InputSpec
from nw_eval.clean import message_of
from nw_eval.confinement import GONE, LEFT, Rules, confine, fence_stands, processor_time
from nw_eval.errors import NwEvalError, ServerError, TrialError
from nw_eval.memory import pack, unpack
from nw_eval.policies.planned import (
    listed,
    operator_of,
    packed,
    plan_policy,
    read_planned,
    read_specs,
)
from nw_eval.policies.policy import Observation, checked_action
from nw_eval.policies.policy_process import ACT, BOARD, HEADER, MessageLine, Server, layout, views

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from nw_eval.cards.joint_control import Action
    from nw_eval.policies.bundle import Bundle
    from nw_eval.policies.planned import PlannedFile
    from nw_eval.policies.policy import Policy

_PIECE = 2**16
_LINES = 100
_MOST = 256
"""Policies at once, a byte of each message."""
_SEALS = 0x1 | 0x2 | 0x4  # F_SEAL_SEAL, F_SEAL_SHRINK, F_SEAL_GROW of fcntl(2)
_ADD_SEALS = 1033

_KINDS = {
    kind.__name__: kind
    for kind in (
        errors.UsageError,
        errors.PolicyError,
        errors.CodeError,
        errors.PrerequisiteError,
        errors.TrialError,
        errors.ActionError,
        errors.NotFiniteError,
        errors.StoreError,
    )
}
"""What a policy's process may say that went wrong."""


def shared_memory() -> int:
    """Return the file descriptor of new memory for observations, which cannot be truncated.

    Raises:
        OSError: there is none to be had.
    """
    if not hasattr(os, "memfd_create"):  # macOS
        with tempfile.TemporaryFile() as file:
            memory = os.dup(file.fileno())
        os.ftruncate(memory, BOARD)
        return memory
    import fcntl

    memory = os.memfd_create("nw-eval observations", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))  # It is no file of the user's.
    try:
        os.ftruncate(memory, BOARD)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))
    # Its reader could make a writer end with SIGBUS otherwise.
    fcntl.fcntl(memory, _ADD_SEALS, _SEALS)
    return memory


class PolicyLine:
    """A line to a policy's process, which opens any number of policies.

    Args:
        answers: what it says.
        questions: what it is asked.
        memory: for observations.
        lost: called when it is gone, or says what cannot be read.
    """

    def __init__(
        self,
        answers: Connection,
        questions: Connection,
        memory: Connection,
        *,
        lost: Callable[[], NoReturn],
    ) -> None:
        self._held = answers, questions
        _lines.add(self)
        self.line = MessageLine(answers.fileno(), questions.fileno())
        self.lost = lost
        self.board = mmap.mmap(memory.fileno(), BOARD)
        memory.close()
        self._free = list(range(1, _MOST))[::-1]

    def number(self) -> int:
        """Return the number of a new policy."""
        if not self._free:
            raise TrialError(f"{_MOST} policies are open already", fix="close some")
        return self._free.pop()

    def forget(self, number: int) -> None:
        """Let a number be another policy's."""
        self._free.append(number)

    def ask(
        self, words: Mapping[str, Any], *, policy: int = 0, has_server: bool = False
    ) -> dict[str, Any]:
        """Send a message and return its answer.

        Args:
            words: of the message.
            policy: which one is asked.
            has_server: whether it may be a server's fault that there is no answer.

        Raises:
            NwEvalError: what the process says that went wrong, if it is of this program.
            Exception: as above, of the name that the policy's own exception has.
        """
        try:
            self.line.tell(words, policy=policy)
            answer = self.line.receive().words
        except (OSError, EOFError, ValueError, RecursionError):
            self.lost()
        if "error" in answer:
            raise _raised(answer["error"], has_server=has_server)
        return answer

    def close(self) -> None:
        """Let the process end."""
        for connection in self._held:
            connection.close()


_lines: WeakSet[PolicyLine] = WeakSet()


def _cut_lines() -> None:
    """Let a copy that a sensor's code made of this process have no word with the policy's."""
    for each in _lines:
        each.line = MessageLine(-1, -1)


os.register_at_fork(after_in_child=_cut_lines)

_line: ContextVar[PolicyLine | None] = ContextVar("line", default=None)


@contextmanager
def line_to(line: PolicyLine | None) -> Generator[None]:
    """Let policies that are opened in the `with` block be opened over a line; None = here."""
    token = _line.set(line)
    try:
        yield
    finally:
        _line.reset(token)


def use_line(*connections: Connection) -> None:
    """Open policies over a line from now on: in a confined process that has nothing else to do.

    It ends with `GONE` when the other process is gone, and whoever started both sees why.

    Args:
        *connections: of `PolicyLine`; none = open them here.
    """
    if connections:
        _line.set(PolicyLine(*connections, lost=_end))


def current_line() -> PolicyLine | None:
    """Return the line that policies are opened over; None = they are opened here."""
    return _line.get()


_trusts: ContextVar[bool] = ContextVar("trusts", default=False)


@contextmanager
def trusting(*, all_: bool = True) -> Generator[None]:
    """Let checkpoints that are programs be opened in this process, in the `with` block, or not."""
    token = _trusts.set(all_)
    try:
        yield
    finally:
        _trusts.reset(token)


def trusts() -> bool:
    """Return whether checkpoints that are programs may be opened here: see `trusting`."""
    return _trusts.get()


def check_program(bundle: Bundle, *, allow_code: bool) -> None:
    """Refuse to open a checkpoint that is a program where nothing would hold it.

    Raises:
        PolicyError: this process has no fence, and the caller does not allow code.
    """
    if not (fence_stands() or allow_code or trusts()):
        raise errors.PolicyError(
            f"{bundle.where}: `{bundle.card.adapter}` files are programs, and the system offers no "
            "fence to run one behind",
            fix="add --allow-code if you trust it, or export it to ONNX",
        )


def _end() -> NoReturn:
    os._exit(GONE)


@dataclass(frozen=True, kw_only=True)
class Served:
    """What a server says that it serves."""

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
        """Send a message to the process and return its answer; what it raised is raised."""
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
        raise _raised(fault, has_server=self._is_remote)

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


def _raised(fault: Any, *, has_server: bool) -> Exception:
    """Return the exception that a policy's process tells of."""
    fault = fault if isinstance(fault, dict) else {}
    kind = str(fault.get("kind"))
    lines, fix = fault.get("lines"), fault.get("fix")
    if isinstance(lines, list):
        is_server = has_server and kind == ServerError.__name__
        of = ServerError if is_server else _KINDS.get(kind, TrialError)
        return of([str(line) for line in lines[:_LINES]], fix=None if fix is None else str(fix))
    text = str(fault.get("text"))
    if kind == MemoryError.__name__:
        return MemoryError(text)
    name = kind if kind.isidentifier() and len(kind) <= _LINES else "Exception"
    return type(name, (Exception,), {})(text)


# Inside of the policy's process.


def serve_policies(
    rules: Rules,
    questions: Connection,
    answers: Connection,
    memory: Connection,
    output: Connection | None = None,
) -> NoReturn:
    """Confine this process, and serve policies: the main function of a policy's process.

    Args:
        rules: what it may do.
        questions: what it is asked.
        answers: what it says.
        memory: for observations.
        output: where what it prints goes; None = nowhere.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    confine(rules, output=None if output is None else output.fileno())
    if output is not None:
        output.close()
    line = MessageLine(questions.fileno(), answers.fileno())
    others = {"held": _held, "plan": _plan, "try": _try}
    with suppress(OSError, ValueError):  # The answer has no reader, or the request makes no sense.
        Server(line, memory.fileno(), opened=_opened, others=others, describe=_described).serve()
    os._exit(LEFT)


def _opened(words: Mapping[str, Any]) -> tuple[Policy, dict[str, Any]]:
    from nw_eval.policies.opening import open_policy

    bundle, allow_code = _loaded(words["bundle"])
    policy = open_policy(bundle, allow_code=allow_code)
    networks: dict[str, tuple[InputSpec, ...]] = getattr(policy, "network_inputs", {})
    answer = {
        "inputs": listed(policy.inputs),
        "networks": {name: listed(specs) for name, specs in networks.items()},
        "remembers": getattr(policy, "remembers", True),
        "digest": getattr(getattr(policy, "served", None), "digest", ""),
    }
    return policy, answer


def pickled(value: Any) -> bytes:
    """Return a value as `_loaded` reads it in the policy's process."""
    return bytes(ForkingPickler.dumps(value))


def _loaded(data: bytes) -> Any:
    """Return what the caller has sent, whom this process trusts, and not the other way round."""
    loads: Callable[[bytes], Any] = vars(ForkingPickler)["loads"]
    return loads(data)


def _held(policy: Any, _: Mapping[str, Any]) -> dict[str, Any]:
    return {"arrays": pack(policy.held)}


def _plan(policy: Any, words: Mapping[str, Any]) -> dict[str, Any]:
    if policy is not None:
        shown = {name: np.zeros(shape, dtype) for name, dtype, shape, _ in words["shown"]}
        return {"files": packed(plan_policy(policy, shown))}
    from nw_eval.policies.onnx import planned_file

    bundle: Bundle = _loaded(words["bundle"])
    alone = {"": bundle} | {name: bundle.of_network(name) for name in bundle.networks}
    return {"files": packed({name: planned_file(each) for name, each in alone.items()})}


def _try(_: Any, words: Mapping[str, Any]) -> dict[str, Any]:
    from nw_eval.policies.trying import try_on_zeros

    arguments, seconds = _loaded(words["arguments"])
    if seconds is None:
        try_on_zeros(**arguments)
    else:
        with processor_time(seconds):
            try_on_zeros(**arguments)
    return {"operator": operator_of(arguments["bundle"])}


def _described(error: BaseException) -> dict[str, Any]:
    """Return an exception in words."""
    error = errors.not_installed(error) or error
    kind = type(error).__name__
    if isinstance(error, NwEvalError):
        return {"kind": kind, "lines": error.message.split("\n"), "fix": error.fix}
    return {"kind": kind, "text": message_of(error)}
