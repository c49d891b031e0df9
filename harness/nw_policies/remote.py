"""Policies in another process, over a websocket: for stacks that cannot share this environment.

The card has no checkpoint; its `options` say where the server is. Observations travel by the names
that the card gives them, and the action comes back bit for bit.

Messages are msgpack, with arrays as plain maps: an array is
`{"__ndarray__": true, "dtype": "<f4", "shape": [1, 3], "data": bytes}`, C order. Only numbers and
booleans travel; nothing is unpickled.

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
import socket
from collections.abc import Mapping
from contextlib import ExitStack, closing
from itertools import count
from time import monotonic
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from nw_base.clean import clean
from nw_base.errors import PolicyError, PrerequisiteError, ServerError, TrialError
from nw_policies.asked import AskedPolicy, Served
from nw_policies.bundle import NOTHING, Bundle, read_options
from nw_policies.cards.feeding import InputSpec
from nw_policies.cards.model import CardModel

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


try:
    from websockets.exceptions import (
        InvalidHandshake,
        InvalidStatus,
        InvalidURI,
        WebSocketException,
    )
    from websockets.sync.client import ClientConnection, connect
    from websockets.uri import parse_uri
except ImportError:
    raise PrerequisiteError(
        "remote policies need msgpack and websockets, which are not installed",
        fix="pip install 'nw-eval[remote]'",
    ) from None

_START = "start it: nw-eval policies serve BUNDLE"


class RemoteOptions(CardModel):
    """Where the policy runs."""

    url: Annotated[str, Field(pattern=r"^wss?://[^\s/]+(/\S*)?$", max_length=2000)]
    """ws://host:port"""
    timeout: float = Field(default=5.0, gt=0.0, le=600.0)
    """Longest wait for one answer, s."""
    connect_timeout: float = Field(default=10.0, gt=0.0, le=600.0)
    """Longest wait for the connection and its greeting, s."""
    digest: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    """What the server must say that it serves. null = anything; a run records what it is, and
    keeps to it."""


def ask_server(bundle: Bundle) -> Served:
    """Connect briefly and return the description of the served policy.

    Raises:
        PolicyError: as `RemotePolicy`.
    """
    joints = bundle.joints
    with closing(RemotePolicy(bundle, joints=joints)) as policy:
        assert policy.served is not None, "it was asked"
        return policy.served


class RemotePolicy(AskedPolicy):
    """A connection to a policy of its own on a server."""

    inputs: tuple[InputSpec, ...] = ()
    """The server checks shapes, on its first observation."""

    def __init__(self, bundle: Bundle, *, joints: int) -> None:
        """Connect.

        Raises:
            PolicyError: there is no server, it speaks another protocol, serves another policy,
                wants observations that the card does not name, or its card has another `control`.
        """
        super().__init__(bundle.name, joints=joints)
        self._options = read_options(bundle, RemoteOptions)
        self._cleanup = ExitStack()
        self._connection: ClientConnection | None = _connect(bundle, self._options, self._cleanup)
        try:
            hello = self._receive(self._options.connect_timeout)
            self.served = _check(hello, bundle, self._options, joints)
        except TrialError as error:
            self.close()
            raise PolicyError(f"{bundle.where}: {error}", fix=_START) from None
        except PolicyError:
            self.close()
            raise
        except (TypeError, ValueError, OverflowError) as error:  # Arrays in place of words, say.
            self.close()
            raise PolicyError(
                f"{bundle.where}: cannot read the greeting of {self._options.url}: {error}",
                fix="implement the protocol of nw_policies.remote",
            ) from None

    def no_state(self) -> ServerError:
        """Return the error for an answer that holds no state."""
        return ServerError(
            f"policy {self._name!r}: the server at {self._options.url} has no state",
            fix="answer `state` with bytes, empty for a policy without memory",
        )

    def close(self) -> None:
        """End the connection, and with it the policy on the server."""
        self._connection = None
        self._cleanup.close()

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        """Send a message and return its answer."""
        if self._connection is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        try:
            self._connection.send(encode(message))
        except (WebSocketException, OSError) as error:
            raise self._lost(error) from error
        answer = self._receive(self._options.timeout)
        if "error" in answer:
            raise TrialError(
                f"policy {self._name!r} failed on the server at {self._options.url}: "
                f"{clean(answer['error'], at_most=300)}"
            )
        return answer

    def _receive(self, timeout: float) -> dict[str, Any]:
        if self._connection is None:
            raise TrialError(f"policy {self._name!r} is closed", fix="open it again")
        try:
            return decode(self._connection.recv(timeout=timeout))
        except TimeoutError:
            # A late answer would be taken for that of the next question.
            self.close()
            raise ServerError(
                f"policy {self._name!r}: no answer from {self._options.url} within {timeout:g} s",
                fix="check the server, or raise `options.timeout` on the card",
            ) from None
        except ValueError as error:
            self.close()
            raise ServerError(
                f"policy {self._name!r}: cannot read what {self._options.url} sends: {error}",
                fix="implement the protocol of nw_policies.remote",
            ) from None
        except (WebSocketException, OSError) as error:
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> ServerError:
        self.close()
        return ServerError(
            f"policy {self._name!r}: the connection to {self._options.url} is lost: {error}",
            fix="check the server: its policy may have crashed",
        )


def _connect(bundle: Bundle, options: RemoteOptions, cleanup: ExitStack) -> ClientConnection:
    try:
        address = parse_uri(options.url)
        began = monotonic()
        # With a connection made here, to where the card says, there is none to where an answer
        # redirects; and what was waited for it is not waited for again.
        opened = socket.create_connection(
            (address.host, address.port), timeout=options.connect_timeout
        )
        opened.settimeout(None)  # From here on websockets watches the time.
        cleanup.callback(opened.close)
        connection = connect(
            options.url,
            sock=opened,
            open_timeout=max(options.connect_timeout - (monotonic() - began), 0.1),
            compression=None,
            max_size=MESSAGE_LIMIT,
            max_queue=WAITING,
            proxy=None,
        )
        cleanup.enter_context(connection)
    except (InvalidURI, InvalidStatus, ValueError) as error:
        refusal = error if isinstance(error, InvalidStatus) else error.__cause__
        if isinstance(refusal, InvalidStatus):
            status = refusal.response.status_code
            moved = "redirects are not followed: name the server itself"
            raise PolicyError(
                f"{bundle.where}: what answers at {options.url} is not a websocket: HTTP {status}",
                fix=moved if 300 <= status < 400 else _START,
            ) from None
        raise PolicyError(
            f"{bundle.where}: {options.url} is not an address: {error}",
            fix="write `options: {url: ws://host:port}`",
        ) from None
    except TimeoutError:
        raise PolicyError(
            f"{bundle.where}: no policy server answers at {options.url} within "
            f"{options.connect_timeout:g} s",
            fix=_START,
        ) from None
    except InvalidHandshake as error:
        raise PolicyError(
            f"{bundle.where}: what answers at {options.url} is not a websocket: {error}",
            fix=_START,
        ) from None
    except OSError as error:
        raise PolicyError(
            f"{bundle.where}: no policy server at {options.url}: {error.strerror or error}",
            fix=_START,
        ) from None
    return connection


def _check(hello: Mapping[str, Any], bundle: Bundle, options: RemoteOptions, joints: int) -> Served:
    """Compare what the server says of itself with the card, and return it."""
    where = f"{bundle.where}: the server at {options.url}"
    if "error" in hello:
        raise PolicyError(f"{where} says: {clean(hello['error'], at_most=300)}", fix=_START)
    if hello.get("protocol") != PROTOCOL:
        raise PolicyError(
            f"{where} speaks protocol {hello.get('protocol')!r}, not {PROTOCOL}",
            fix="run the same nw-eval version on both sides",
        )
    if hello.get("joints") != joints:
        raise PolicyError(
            f"{where} serves a policy of {hello.get('joints')!r} joints, the robot "
            f"{bundle.card.robot!r} has {joints}",
            fix="serve a policy for this robot",
        )
    if options.digest is not None and hello.get("digest") != options.digest:
        raise PolicyError(
            f"{where} serves the digest {str(hello.get('digest'))[:64]}, that on the card is "
            f"{options.digest}",
            fix="serve the policy that is meant, or correct `options.digest`",
        )
    digest = hello.get("digest") or NOTHING
    if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
        raise PolicyError(
            f"{where} gives the digest {str(digest)[:64]!r}",
            fix="give the SHA-256 of what is served in hex, or none",
        )
    sizes, control = (_map(hello, key, where) for key in ("observations", "control"))
    absent = [name for name in sizes if name not in bundle.card.observations]
    if absent:
        raise PolicyError(
            f"{where} wants the observation {', '.join(absent)}, which the card does not name",
            fix="copy `observations` from the served card",
        )
    own = bundle.card.control.model_dump(mode="json")
    for key, value in control.items():
        if own.get(key, value) != value:
            raise PolicyError(
                f"{where} serves a card whose `control.{key}` is {str(value)[:200]}, on this card "
                f"it is {own[key]}",
                fix="copy `control` from the served card",
            )
    known = {name: shape for name, shape in sizes.items() if shape is not None}
    shapes = {name: tuple(int(side) for side in shape) for name, shape in known.items()}
    return Served(digest=digest, shapes=shapes)


def _map(hello: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    value = hello.get(key) or {}
    if not isinstance(value, dict):
        raise PolicyError(
            f"{where} greets with {key!r} as a {type(value).__name__}, not a map",
            fix="implement the protocol of nw_policies.remote",
        )
    return value
