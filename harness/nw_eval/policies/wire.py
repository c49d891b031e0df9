"""Messages between a remote policy and its server: msgpack, with arrays as plain maps.

An array is `{"__ndarray__": true, "dtype": "<f4", "shape": [1, 3], "data": bytes}`, C order. Only
numbers and booleans travel; nothing is unpickled.

    server, on connection   {"protocol": 2, "policy": name, "digest": hex, "joints": 12,
                             "observations": {name: [sizes]}, "control": {as on the card}}
    client                  server
    {"call": "reset", "seed": n}                    {"done": true}
    {"call": "act", "observation": {name: array}}   {"action": array of 12 float64}
    {"call": "state"}                               {"state": bytes}
    {"call": "restore", "state": bytes}             {"done": true}
    any                                             {"error": text}

Each connection has a policy of its own; closing the connection closes it. `digest` is the SHA-256
of all that can change an action; runs record it. A server may leave out `digest`, `observations`,
`control` and keys of it, and give null for sizes: what it does not say is not compared.
"""

from __future__ import annotations

import math
import re
from itertools import count
from typing import Any

import numpy as np

from nw_eval.errors import PrerequisiteError

try:
    import msgpack
except ImportError:
    raise PrerequisiteError(
        "remote policies need msgpack and websockets, which are not installed",
        fix="pip install 'nw-eval[remote]'",
    ) from None

PROTOCOL = 2
MESSAGE_LIMIT = 2**26
"""Bytes of one message: 64 MiB, some 16 full camera images."""
WAITING = 1
"""Messages that wait to be read: each is answered before the next is sent."""
_ENTRIES = 4096  # of one map or list, and maps and lists of one message
_TEXT = 2**16  # bytes
_NUMBERS = re.compile(r"[<|](b1|[iuf][1248])")
_MARK = "__ndarray__"


def encode(message: dict[str, Any]) -> bytes:
    """Return a message as bytes.

    Raises:
        TypeError: it holds something that does not travel.
    """
    packed = msgpack.packb(message, default=_as_map, use_bin_type=True)
    if packed is None:
        raise TypeError("the message is empty")
    return packed


def decode(data: bytes | str) -> dict[str, Any]:
    """Return the message in `data`.

    Raises:
        ValueError: it is no message of this protocol.
    """
    if isinstance(data, str):
        raise ValueError("it is text, not bytes")  # noqa: TRY004 - one error for all faults.
    entries = count(1)

    def counted(value: Any) -> Any:
        # A byte can be an empty list of 60 bytes: what a message may unpack to is limited, too.
        if next(entries) > _ENTRIES:
            raise ValueError(f"it holds more than {_ENTRIES} maps and lists")
        return _from_map(value) if isinstance(value, dict) else value

    try:
        message = msgpack.unpackb(
            data,
            object_hook=counted,
            list_hook=counted,
            strict_map_key=True,
            max_map_len=_ENTRIES,
            max_array_len=_ENTRIES,
            max_str_len=_TEXT,
        )
    except (msgpack.exceptions.UnpackException, TypeError, KeyError, OverflowError) as error:
        raise ValueError(f"it is not msgpack: {error or type(error).__name__}") from None
    if not isinstance(message, dict):
        raise ValueError(f"it is a {type(message).__name__}, not a map")  # noqa: TRY004 - as above.
    return message


def _as_map(value: Any) -> dict[str, Any]:
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            raise TypeError(f"an array of {array.dtype} does not travel")
        return {
            _MARK: True,
            "dtype": array.dtype.newbyteorder("<").str,
            "shape": list(array.shape),
            "data": array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes(),
        }
    raise TypeError(f"a {type(value).__name__} does not travel")


def _from_map(value: dict[str, Any]) -> Any:
    if _MARK not in value:
        return value
    name, data = str(value["dtype"]), value["data"]
    if not _NUMBERS.fullmatch(name) or not isinstance(data, bytes):
        raise ValueError(f"it holds an array of {name[:40]!r}")
    dtype = np.dtype(name)
    shape = tuple(int(size) for size in value["shape"])
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"it holds an array of shape {shape} in {len(data)} bytes")
    return np.frombuffer(data, dtype=dtype).reshape(shape).copy()
