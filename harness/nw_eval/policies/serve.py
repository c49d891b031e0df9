"""Serves a bundle to remote policies; `nw-eval policies serve` does it on the command line.

It is the reference for servers in other stacks: `wire` says what is exchanged. Whoever can connect
can use the policy, so it listens on this machine only unless told otherwise.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from nw_eval.errors import NwEvalError, PrerequisiteError, UsageError
from nw_eval.policies.adapters import open_policy
from nw_eval.policies.bundle import Bundle
from nw_eval.policies.policy import Policy
from nw_eval.policies.wire import MESSAGE_LIMIT, PROTOCOL, decode, encode
from nw_eval.robots import get_robot


@dataclass(frozen=True, kw_only=True)
class Address:
    """Where a server listens."""

    host: str
    port: int

    @property
    def url(self) -> str:
        """What a card's `options.url` must be."""
        return f"ws://{self.host}:{self.port}"


@contextmanager
def serving(
    bundle: Bundle,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    allow_code: bool = False,
    shapes: Mapping[str, tuple[int, ...]] | None = None,
) -> Generator[Address]:
    """Serve a bundle in threads of this process, and give the address.

    Args:
        bundle: from `load_bundle`. It is opened once before anybody connects.
        host: address to listen on.
        port: 0 for a free one.
        allow_code: as `open_policy`.
        shapes: of the card's observations by name, for clients to compare theirs with.

    Raises:
        PolicyError: the bundle cannot be opened.
        UsageError: the address is taken or is not this machine's.
        PrerequisiteError: websockets is not installed.
    """
    try:
        from websockets.sync.server import ServerConnection, serve
    except ImportError:
        raise PrerequisiteError(
            "serving a policy needs websockets, which is not installed",
            fix="pip install 'nw-eval[remote]'",
        ) from None

    def opened() -> Policy:
        return open_policy(bundle, allow_code=allow_code)

    opened().close()
    hello = {
        "protocol": PROTOCOL,
        "policy": bundle.name,
        "digest": bundle.digest,
        "joints": len(get_robot(bundle.card.robot).joints),
        "observations": {name: (shapes or {}).get(name) for name in bundle.card.observations},
        "control": bundle.card.control.model_dump(mode="json"),
    }

    def handle(connection: ServerConnection) -> None:
        policy = opened()
        try:
            connection.send(encode(hello))
            for data in connection:
                connection.send(encode(answer(policy, data)))
        finally:
            policy.close()

    try:
        server = serve(handle, host, port, compression=None, max_size=MESSAGE_LIMIT)
    except (OSError, OverflowError, TypeError, UnicodeError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise UsageError(
            f"cannot listen on {host}:{port}: {reason}", fix="choose another --host or --port"
        ) from None
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield Address(host=host, port=server.socket.getsockname()[1])
    finally:
        server.shutdown()
        thread.join()


def answer(policy: Policy, data: bytes | str) -> dict[str, Any]:
    """Return the answer to one message; faults of the policy or the message are answers too."""
    calls: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
        "reset": lambda message: _done(policy.reset(int(message["seed"]))),
        "act": lambda message: {"action": policy.act(message["observation"])},
        "state": lambda _: {"state": policy.state()},
        "restore": lambda message: _done(policy.restore(message["state"])),
    }
    try:
        message = decode(data)
        call = calls.get(str(message.get("call")))
        if call is None:
            return {"error": f"unknown call {message.get('call')!r}; known: {', '.join(calls)}"}
        return call(message)
    except NwEvalError as error:
        return {"error": str(error)}
    except Exception as error:  # noqa: BLE001 - whatever the policy raises is told to the client.
        return {"error": f"{type(error).__name__}: {error}"}


def _done(_: None) -> dict[str, Any]:
    return {"done": True}
