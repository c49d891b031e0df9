"""Messages between a policy's process and its caller; this file needs Python and NumPy alone.

A policy lives in a process of its own. Its caller writes observations into memory that both map,
and asks; the answer comes back through a pipe:

    caller                                   process
    {"call": "open", ...}                    {"inputs": [...], ...}
    {"call": "reset", "seed": n}             {"done": true}
    {"call": "board", "arrays": [[name, dtype, shape, offset], ...]}   {"done": true}
    act                                      the action, float64
    {"call": "state"}                        {"state": bytes}
    {"call": "restore", "state": bytes}      {"done": true}
    {"call": "close"}                        {"done": true}
    any                                      {"error": {"kind": ..., "text": ..., "fix": ...}}

A message is a header, a text of JSON, and the bytes of at most one of its values; `act` and its
answer have no text. Nothing that comes from the process is ever unpickled. The process maps the
observations read-only, and the caller never reads them back: what a policy writes stays its own.
"""

from __future__ import annotations

import importlib
import json
import math
import mmap
import os
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

HEADER = struct.Struct("<cBII")
"""Kind of the message, number of the policy, bytes of its text, bytes of its data."""
TELL, ACT = b"t", b"a"
TEXT_LIMIT = 2**20
"""Bytes of a message's text."""
DATA_LIMIT = 2**28
"""Bytes of a message's data: states of policies with stacked images have some 100 kB."""
BOARD = 2**28
"""Bytes of the shared memory, of which untouched pages take none."""
_PIECE = 2**16
_ALIGNED = 64
_NUMBERS = "biufc"

CALLS = "reset", "act", "state", "restore"
"""What any policy answers, wherever it is asked."""


class FaultError(Exception):
    """An error in a policy of third-party code; `kind` names a class of `nw_base.errors`."""

    def __init__(self, kind: str, text: str, *, fix: str | None = None) -> None:
        super().__init__(text)
        self.kind = kind
        self.fix = fix


def as_action(raw: Any, *, joints: int, policy: str) -> NDArray[np.float64]:
    """Return a checkpoint's output as an action, (joints,), of its own memory.

    Raises:
        FaultError: ActionError, the output has another size; NotFiniteError, it is not finite.
    """
    array = np.asarray(raw)
    if array.size != joints or array.shape[-1:] != (joints,):
        raise FaultError(
            "ActionError",
            f"policy {policy!r} returned an action of shape {array.shape}",
            fix=f"the card's robot has {joints} joints: check `output` on the card",
        )
    action = np.array(array.reshape(joints), dtype=np.float64)
    if not all_finite(action):
        index = int(np.argmin(np.isfinite(action)))
        raise FaultError(
            "NotFiniteError",
            f"policy {policy!r} returned {action[index]} for joint {index} of its action",
            fix="check the checkpoint, and the observations' scales on its card",
        )
    return action


def all_finite(values: NDArray[np.float64]) -> bool:
    """Whether no number of a short vector is inf or NaN."""
    # A sum is finite only if all of its parts are; sums of finite numbers overflow hardly ever.
    # Right after a network has run, plain numbers take 2 us here and NumPy's functions 10.
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())


class CodePolicy:
    """An object of somebody's code, with its actions checked.

    Args:
        policy: has `act(observation) -> joints numbers`, and whatever else of `Policy`; a function
            does what `act` would.
        name: of the policy, for errors.
        adapter: what the card calls it, for errors.
        where: where an error says that a card is wrong.
        joints: how many numbers an action has.

    Raises:
        FaultError: it is not a policy.
    """

    def __init__(self, policy: Any, *, name: str, adapter: str, where: str, joints: int) -> None:
        self._policy = policy
        self._name = name
        self._joints = joints
        if not callable(getattr(policy, "act", policy)):
            raise FaultError(
                "CodeError",
                f"{where}: {adapter} has no method `act`",
                fix="write `act(self, observation)`",
            )
        if hasattr(policy, "state") != hasattr(policy, "restore"):
            raise FaultError(
                "CodeError",
                f"{where}: {adapter} has only one of `state` and `restore`",
                fix="write both, or neither if the policy has no memory",
            )

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._call("reset", seed)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Ask the object, which gets copies: it may write into them."""
        copies = {name: np.array(array) for name, array in observation.items()}
        try:
            raw = getattr(self._policy, "act", self._policy)(copies)
        except Exception as error:
            raise self._failed("act", error) from error
        return as_action(raw, joints=self._joints, policy=self._name)

    def state(self) -> bytes:
        """Return the object's memory."""
        state = self._call("state")
        if not isinstance(state, (bytes, type(None))):
            kind = type(state).__name__
            text = f"policy {self._name!r}: state() returned a {kind}, not bytes"
            raise FaultError("TrialError", text)
        return state or b""

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self._call("restore", state)

    def close(self) -> None:
        """Close the object."""
        self._call("close")

    def _call(self, method: str, *arguments: Any) -> Any:
        """Call a method if the object has it."""
        function = getattr(self._policy, method, None)
        if function is None:
            return None
        try:
            return function(*arguments)
        except Exception as error:
            raise self._failed(method, error) from error

    def _failed(self, method: str, error: Exception) -> FaultError:
        if isinstance(error, FaultError):
            return error
        try:
            said = str(error)
        except BaseException as another:  # noqa: BLE001 - It is third-party code, too.
            said = f"its own message cannot be read, because of {type(another).__name__}"
        text = f"policy {self._name!r}: {method} raised {type(error).__name__}: {said}"
        return FaultError("TrialError", text)


class Message(NamedTuple):
    """One message as it was received."""

    kind: bytes
    policy: int
    words: dict[str, Any]
    data: bytes


class MessageLine:
    """Two pipes: one to write into, and one to read from.

    Args:
        reads: file descriptor to read from; it remains the caller's.
        writes: to write into, as above.
    """

    def __init__(self, reads: int, writes: int) -> None:
        self.reads, self.writes = reads, writes

    def tell(self, words: Mapping[str, Any], *, policy: int = 0) -> None:
        """Send a message; one of its values may be bytes.

        Raises:
            OSError: the other end is closed.
        """
        data, plain = b"", dict(words)
        for key, value in words.items():
            if isinstance(value, bytes):
                data, plain[key], plain["bytes"] = value, None, key
        text = json.dumps(plain).encode()
        self.send(TELL, policy, text, data)

    def send(self, kind: bytes, policy: int, text: bytes = b"", data: bytes = b"") -> None:
        """Send a header and what follows it; raises as `tell`."""
        rest = memoryview(HEADER.pack(kind, policy, len(text), len(data)) + text + data)
        while rest:
            rest = rest[os.write(self.writes, rest) :]

    def receive(self) -> Message:
        """Return the next message.

        Raises:
            EOFError: the other end is closed.
            ValueError: it is none.
        """
        return self.rest_of(os.read(self.reads, _PIECE))

    def rest_of(self, piece: bytes) -> Message:
        """Return the message that begins with a piece that was read; raises as `receive`."""
        heard = bytearray(piece)
        self._fill(heard, HEADER.size)
        kind, policy, text, data = HEADER.unpack_from(heard)
        if kind not in {TELL, ACT} or text > TEXT_LIMIT or data > DATA_LIMIT:
            raise ValueError("its answer is not a message")
        end = HEADER.size + text
        self._fill(heard, end + data)
        if len(heard) != end + data:
            raise ValueError("its answer is longer than asked")
        words = json.loads(heard[HEADER.size : end] or b"{}")
        if not isinstance(words, dict):
            raise ValueError("its answer is not a message")  # noqa: TRY004 - one error for all.
        if isinstance(key := words.pop("bytes", None), str):
            words[key] = bytes(heard[end:])
        return Message(kind, policy, words, bytes(heard[end:]))

    def _fill(self, heard: bytearray, size: int) -> None:
        while len(heard) < size:
            piece = os.read(self.reads, min(size - len(heard), 2**20))
            if not piece:
                raise EOFError
            heard += piece


Place = tuple[str, str, list[int], int]
"""Of one array of the shared memory: name, dtype, shape, offset in bytes."""


def layout(arrays: Mapping[str, NDArray[Any]]) -> list[Place]:
    """Return where arrays go.

    Raises:
        ValueError: they are not of numbers, or too large together.
    """
    places: list[Place] = []
    end = 0
    for name, array in arrays.items():
        if array.dtype.kind not in _NUMBERS:
            raise ValueError(f"`{name}` is an array of {array.dtype}, not of numbers")
        places.append((name, array.dtype.str, list(array.shape), end))
        end += -(-array.nbytes // _ALIGNED) * _ALIGNED
    if end > BOARD:
        raise ValueError(f"the observations have {end} bytes, more than {BOARD}")
    return places


def views(board: mmap.mmap, places: Sequence[Place]) -> dict[str, NDArray[Any]]:
    """Return the arrays that lie in shared memory."""
    return {
        name: np.frombuffer(board, np.dtype(dtype), math.prod(shape), offset).reshape(shape)
        for name, dtype, shape, offset in places
    }


def respond(policy: Any, message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a policy's answer to one message; exceptions of the policy are passed on.

    Raises:
        ValueError: there is no such call.
    """
    call = message.get("call")
    if call == "reset":
        policy.reset(int(message["seed"]))
    elif call == "act":
        return {"action": policy.act(message["observation"])}
    elif call == "state":
        return {"state": policy.state()}
    elif call == "restore":
        policy.restore(message["state"])
    else:
        raise ValueError(f"unknown call {call!r}; known: {', '.join(CALLS)}")
    return {"done": True}


class Server:
    """Serves policies to a caller.

    Args:
        line: to the caller.
        memory: file descriptor of the shared memory, `BOARD` bytes.
        opened: returns the policy that an `open` means, and what to say of it.
        others: by name, further calls; each is given the policy, None if there is none.
        describe: says of an exception what the caller is told.
    """

    def __init__(
        self,
        line: MessageLine,
        memory: int,
        *,
        opened: Callable[[Mapping[str, Any]], tuple[Any, dict[str, Any]]],
        others: Mapping[str, Callable[[Any, Mapping[str, Any]], dict[str, Any]]],
        describe: Callable[[BaseException], dict[str, Any]],
    ) -> None:
        self._line = line
        self._memory = mmap.mmap(memory, BOARD, prot=mmap.PROT_READ)
        self._opened = opened
        self._others = others
        self._describe = describe
        self._policies: dict[int, Any] = {}
        self._boards: dict[int, dict[str, NDArray[Any]]] = {}

    def serve(self) -> None:
        """Answer until the caller is gone.

        Raises:
            OSError: it goes while it is answered.
            ValueError: a received message is invalid.
        """
        reads, writes = self._line.reads, self._line.writes
        policies, boards = self._policies, self._boards
        while True:
            piece = os.read(reads, _PIECE)
            if len(piece) != HEADER.size or piece[:1] != ACT:
                try:
                    _, number, words, _ = self._line.rest_of(piece)
                except EOFError:
                    return
                self._line.tell(self._answer(number, words), policy=number)
                continue
            number = piece[1]
            try:
                action = policies[number].act(boards[number])
                data: bytes = np.asarray(action, np.float64).tobytes()
            except BaseException as error:  # noqa: BLE001 - the caller receives what a policy raises.
                self._line.tell({"error": self._describe(error)}, policy=number)
            else:
                os.write(writes, HEADER.pack(ACT, number, 0, len(data)) + data)  # All, or none.

    def _answer(self, number: int, words: Mapping[str, Any]) -> dict[str, Any]:
        call = str(words.get("call"))
        try:
            if call == "open":
                self._policies[number], answer = self._opened(words)
                return answer
            if call == "board":
                self._boards[number] = views(self._memory, words["arrays"])
            elif call == "close":
                self._boards.pop(number, None)
                if number in self._policies:
                    self._policies.pop(number).close()
            elif call in self._others:
                return self._others[call](self._policies.get(number), words)
            else:
                return respond(self._policies[number], words)
        except BaseException as error:  # noqa: BLE001 - as above.
            return {"error": self._describe(error)}
        return {"done": True}


# The program of a policy's process with an interpreter of its own.


def run_program(orders: Mapping[str, Any]) -> None:
    """Serve the policy of a card in this process, which is confined already.

    Args:
        orders: file descriptors `reads`, `writes` and `memory`.
    """
    line = MessageLine(orders["reads"], orders["writes"])
    Server(line, orders["memory"], opened=_opened, others={}, describe=_described).serve()


def _opened(words: Mapping[str, Any]) -> tuple[CodePolicy, dict[str, Any]]:
    """Import the class that a card names, and make the policy of it."""
    adapter, folder, where = (str(words[key]) for key in ("adapter", "folder", "where"))
    module, _, name = adapter.partition(":")[2].partition(":")
    sys.dont_write_bytecode = True
    sys.path.insert(0, folder)
    checkpoint = words["checkpoint"]
    bundle = SimpleNamespace(
        name=words["name"],
        folder=Path(folder),
        checkpoint=None if checkpoint is None else Path(checkpoint),
        card=SimpleNamespace(options=words["options"]),
    )
    try:
        policy = getattr(importlib.import_module(module), name)(bundle)
    except Exception as error:  # noqa: BLE001 - the user's code may raise anything.
        raise FaultError(
            "CodeError",
            f"{where}: {adapter} cannot be opened: {type(error).__name__}: {error}",
            fix=f"the module must lie in {folder} or be installed for the card's `python`, and "
            "the class take the bundle",
        ) from None
    if not callable(getattr(policy, "act", None)):
        policy = SimpleNamespace(act=None)
    opened = CodePolicy(
        policy, name=str(words["name"]), adapter=adapter, where=where, joints=int(words["joints"])
    )
    return opened, {"inputs": [], "networks": {}, "digest": "", "remembers": True}


def _described(error: BaseException) -> dict[str, Any]:
    if isinstance(error, FaultError):
        return {"kind": error.kind, "lines": [str(error)], "fix": error.fix}
    return {"kind": type(error).__name__, "text": str(error)}
