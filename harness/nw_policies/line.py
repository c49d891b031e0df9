"""A line to a process that opens policies, and whether there is one.

`open_policy` opens policies over the line that `line_to` gives it; `nw_sim.rollout.confined.start`
starts both processes. What goes over the line is in `policy_process`. All that comes back is
bounded and checked: the process may be a hostile file's by now.
"""

from __future__ import annotations

import mmap
import os
import resource
import tempfile
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NoReturn
from weakref import WeakSet

from nw_base import errors
from nw_base.confinement import GONE, fence_stands
from nw_base.errors import ServerError, TrialError
from nw_policies.policy_process import BOARD, MessageLine

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from nw_policies.bundle import Bundle

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
        OSError: no shared memory can be allocated.
    """
    if not hasattr(os, "memfd_create"):  # macOS
        with tempfile.TemporaryFile() as file:
            memory = os.dup(file.fileno())
        os.ftruncate(memory, BOARD)
        return memory
    import fcntl

    memory = os.memfd_create("nw-eval observations", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))  # It is not a file of the user's.
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
        answers: line of the policy's answers.
        questions: line of the requests to it.
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
            raise raised_there(answer["error"], has_server=has_server)
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


def raised_there(fault: Any, *, has_server: bool) -> Exception:
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
