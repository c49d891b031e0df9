"""What a policy's process and its caller say to each other; this file needs Python and NumPy alone.

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

import json
import math
import mmap
import os
import struct
from collections.abc import Callable, Mapping, Sequence
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
"""Bytes of the shared memory, of which what nobody touches takes none."""
_PIECE = 2**16
_ALIGNED = 64
_NUMBERS = "biufc"

CALLS = "reset", "act", "state", "restore"
"""What any policy answers, wherever it is asked."""


class Message(NamedTuple):
    """One message as it was received."""

    kind: bytes
    policy: int
    words: dict[str, Any]
    data: bytes


class Line:
    """Two pipes: one to write into, and one to read from.

    Args:
        reads: file descriptor to read from; it remains the caller's.
        writes: to write into, likewise.
    """

    def __init__(self, reads: int, writes: int) -> None:
        self.reads, self.writes = reads, writes

    def tell(self, words: Mapping[str, Any], *, policy: int = 0) -> None:
        """Send a message; one of its values may be bytes.

        Raises:
            OSError: nobody is there to hear it.
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
            EOFError: nobody is there to send any more.
            ValueError: it is none.
        """
        return self.rest_of(os.read(self.reads, _PIECE))

    def rest_of(self, piece: bytes) -> Message:
        """Return the message that begins with a piece that was read; raises as `receive`."""
        heard = bytearray(piece)
        self._fill(heard, HEADER.size)
        kind, policy, text, data = HEADER.unpack_from(heard)
        if kind not in {TELL, ACT} or text > TEXT_LIMIT or data > DATA_LIMIT:
            raise ValueError("what it says is no message")
        end = HEADER.size + text
        self._fill(heard, end + data)
        if len(heard) != end + data:
            raise ValueError("it says more than it was asked")
        words = json.loads(heard[HEADER.size : end] or b"{}")
        if not isinstance(words, dict):
            raise ValueError("what it says is no message")  # noqa: TRY004 - one error for all.
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
    """Return a policy's answer to one message, whoever sent it; what it raises goes on.

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
        told: says of an exception what the caller is told.
    """

    def __init__(
        self,
        line: Line,
        memory: int,
        *,
        opened: Callable[[Mapping[str, Any]], tuple[Any, dict[str, Any]]],
        others: Mapping[str, Callable[[Any, Mapping[str, Any]], dict[str, Any]]],
        told: Callable[[BaseException], dict[str, Any]],
    ) -> None:
        self._line = line
        self._memory = mmap.mmap(memory, BOARD, prot=mmap.PROT_READ)
        self._opened = opened
        self._others = others
        self._told = told
        self._policies: dict[int, Any] = {}
        self._boards: dict[int, dict[str, NDArray[Any]]] = {}

    def serve(self) -> None:
        """Answer until the caller is gone.

        Raises:
            OSError: it goes while it is answered.
            ValueError: it says what is no message.
        """
        reads = self._line.reads
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
                data = np.asarray(action, np.float64).tobytes()
            except BaseException as error:  # noqa: BLE001 - the caller hears what a policy raises.
                self._line.tell({"error": self._told(error)}, policy=number)
            else:
                self._line.send(ACT, number, data=data)

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
            return {"error": self._told(error)}
        return {"done": True}
