"""Serves a bundle to remote policies; `nw-eval policies serve` does it on the command line.

It is the reference for servers in other stacks: `wire` says what is exchanged. Whoever can connect
can use the policy, so it listens on this machine only unless told otherwise, and turns web pages
away: a browser names the page's origin, and asks for a host that the page chose.
"""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from nw_base.clean import clean
from nw_base.errors import NwEvalError, PrerequisiteError, UsageError
from nw_policies.bundle import Bundle
from nw_policies.line import trusting, trusts
from nw_policies.opening import open_policy
from nw_policies.policy import Policy
from nw_policies.policy_process import CALLS, respond
from nw_policies.remote import MESSAGE_LIMIT, PROTOCOL, WAITING, decode, encode

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import Server, ServerConnection

CONNECTIONS = 64
"""Policies at once: one for each worker of a large machine. Each holds a network of its own."""
_SOCKETS = 4 * CONNECTIONS  # of those that said nothing yet, too
_OPENING = 5.0  # s until a client must have said what it wants
_ERROR = 300  # characters
# Who fails to connect is told so; here a scan of ports would fill the screen with tracebacks.
_SILENT = logging.getLogger(__name__)
_SILENT.setLevel(logging.CRITICAL + 1)


@dataclass(frozen=True, kw_only=True)
class Address:
    """Where a server listens."""

    host: str
    port: int

    @property
    def url(self) -> str:
        """URL for a card's `options.url`."""
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
        from websockets.sync.server import serve
    except ImportError:
        raise PrerequisiteError(
            "serving a policy needs websockets, which is not installed",
            fix="pip install 'nw-eval[remote]'",
        ) from None

    is_trusted = trusts()  # Each client has a thread, which does not know.

    def opened() -> Policy:
        with trusting(all_=is_trusted):
            return open_policy(bundle, allow_code=allow_code)

    opened().close()
    hello = {
        "protocol": PROTOCOL,
        "policy": bundle.name,
        "digest": bundle.digest,
        "joints": bundle.joints,
        "observations": {name: (shapes or {}).get(name) for name in bundle.card.observations},
        "control": bundle.card.control.model_dump(mode="json"),
    }

    open_now = threading.BoundedSemaphore(CONNECTIONS)

    def handle(connection: ServerConnection) -> None:
        if not open_now.acquire(blocking=False):
            connection.send(encode({"error": f"{CONNECTIONS} clients are connected already"}))
            return
        try:
            attend(connection)
        finally:
            open_now.release()

    def attend(connection: ServerConnection) -> None:
        try:
            policy = opened()
        except Exception as error:  # noqa: BLE001 - the client is told, the others are served on.
            connection.send(encode(_fault(error)))
            return
        try:
            connection.send(encode(hello))
            for data in connection:
                connection.send(encode(answer(policy, data)))
        finally:
            policy.close()

    try:
        server = serve(
            handle,
            host,
            port,
            compression=None,
            max_size=MESSAGE_LIMIT,
            max_queue=WAITING,
            open_timeout=_OPENING,
            origins=[None],  # Whoever names one is a browser.
            process_request=lambda connection, request: _turned_away(connection, request, host),
            server_header=None,
            logger=_SILENT,
        )
    except (OSError, OverflowError, TypeError, UnicodeError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise UsageError(
            f"cannot listen on {host}:{port}: {reason}", fix="choose another --host or --port"
        ) from None
    _limit_sockets(server)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield Address(host=host, port=server.socket.getsockname()[1])
    finally:
        server.shutdown()
        thread.join()


def answer(policy: Policy, data: bytes | str) -> dict[str, Any]:
    """Return the answer to one message; faults of the policy or the message are answers too."""
    try:
        message = decode(data)
        if message.get("call") not in CALLS:
            return {"error": f"unknown call {message.get('call')!r}; known: {', '.join(CALLS)}"}
        return respond(policy, message)
    except Exception as error:  # noqa: BLE001 - whatever the policy raises is told to the client.
        return _fault(error)


def _fault(error: Exception) -> dict[str, Any]:
    """Return an error as a client may know it: a line, and nothing of this machine's stack."""
    kind = "" if isinstance(error, NwEvalError) else f"{type(error).__name__}: "
    return {"error": kind + clean(error, at_most=_ERROR)}


def _turned_away(connection: ServerConnection, request: Request, host: str) -> Response | None:
    """Return a refusal for a client that asks for another host than this machine, else None.

    A page can have its own host's name point here (DNS rebinding); whoever listens for other
    machines goes by names that are not known here.
    """
    hosts = request.headers.get_all("Host")
    if not _is_here(host) or (len(hosts) == 1 and _is_here(_host_of(hosts[0]))):
        return None
    return connection.respond(421, "ask for localhost\n")


def _host_of(header: str) -> str:
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def _is_here(host: str) -> bool:
    """Return whether a host's name or address can mean this machine only."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _limit_sockets(server: Server) -> None:
    """Close what connects beyond `_SOCKETS` at once: every connection takes a thread."""
    accepted, slots = server.handler, threading.BoundedSemaphore(_SOCKETS)

    def handler(sock: socket.socket, address: Any) -> None:
        has_slot = slots.acquire(blocking=False)
        try:
            if not has_slot:
                with suppress(OSError):
                    sock.shutdown(socket.SHUT_RDWR)
            accepted(sock, address)  # Cleans up behind one that is shut, too.
        finally:
            if has_slot:
                slots.release()

    server.handler = handler
