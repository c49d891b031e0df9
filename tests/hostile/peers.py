"""Peers on the loopback address that mean harm, or are slow: for tests of servers and of clients.

A client of `CLIENTS` connects, does its deed and holds its sockets until it is let go. A server of
`SERVERS` accepts one connection, and does its deed with it.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import threading
import time
from base64 import b64encode
from collections.abc import Iterator
from hashlib import sha1

MOST = 40
"""Connections of one client at a time."""
UPGRADE = (
    "GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n{more}\r\n"
)


def frame(opcode: int, data: bytes, *, last: bool = True, claims: int | None = None) -> bytes:
    """Return a frame as clients send it, masked by zeros."""
    size = len(data) if claims is None else claims
    head = bytes([(0x80 if last else 0) | opcode])
    if size < 126:
        head += bytes([0x80 | size])
    elif size < 2**16:
        head += bytes([0x80 | 126]) + struct.pack(">H", size)
    else:
        head += bytes([0x80 | 127]) + struct.pack(">Q", size)
    return head + bytes(4) + data


def plain(opcode: int, data: bytes, **how) -> bytes:
    """Return a frame as servers send it."""
    masked = frame(opcode, data, **how)
    end = len(masked) - len(data)
    return masked[:1] + bytes([masked[1] & 0x7F]) + masked[2 : end - 4] + data


def request(more: str = "") -> bytes:
    return UPGRADE.format(more=more).encode()


def _sent(peer: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        peer.sendall(data)


def _upgraded(peer: socket.socket, more: str, *frames: bytes) -> None:
    _sent(peer, request(more))
    with contextlib.suppress(OSError):
        peer.recv(4096)
    for each in frames:
        _sent(peer, each)


def _half_closed(peer: socket.socket, more: str) -> None:
    _sent(peer, request(more)[:40])
    with contextlib.suppress(OSError):
        peer.shutdown(socket.SHUT_WR)


def _reset(peer: socket.socket, more: str) -> None:
    _sent(peer, request(more))
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()


CLIENTS = {
    "says nothing": lambda *_: None,
    "half a request": lambda peer, _: _sent(peer, b"GET / HTTP/1.1\r\nHost: local"),
    "half closed": _half_closed,
    "reset": _reset,
    "a line of a megabyte": lambda peer, _: _sent(peer, b"GET /" + b"x" * 2**20),
    "a header of a megabyte": lambda peer, more: _sent(
        peer, request(f"X-Long: {'y' * 2**20}\r\n{more}")
    ),
    "ten thousand headers": lambda peer, more: _sent(
        peer, request("".join(f"X-{n}: y\r\n" for n in range(10_000)) + more)
    ),
    "TLS": lambda peer, _: _sent(peer, b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc" + bytes(500)),
    "HTTP/2": lambda peer, _: _sent(peer, b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(99)),
    "SSH": lambda peer, _: _sent(peer, b"SSH-2.0-OpenSSH_9.6\r\n"),
    "a form": lambda peer, _: _sent(
        peer, b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000000\r\n\r\nx"
    ),
    "a frame of 2^63 bytes": lambda peer, more: _upgraded(
        peer, more, frame(2, b"x", claims=2**63 - 1)
    ),
    "a frame of a gigabyte": lambda peer, more: _upgraded(peer, more, frame(2, b"x", claims=2**30)),
    "half a frame": lambda peer, more: _upgraded(peer, more, frame(2, b"x" * 9, claims=90)),
    "pieces without an end": lambda peer, more: _upgraded(
        peer, more, frame(2, b"x", last=False), *[frame(0, b"x" * 999, last=False)] * 2000
    ),
    "no mask": lambda peer, more: _upgraded(peer, more, plain(2, b"xyz")),
    "a reserved opcode": lambda peer, more: _upgraded(peer, more, frame(11, b"xyz")),
    "a long ping": lambda peer, more: _upgraded(peer, more, frame(9, b"x" * 500)),
    "ten thousand pings": lambda peer, more: _upgraded(peer, more, frame(9, b"") * 10_000),
    "messages that nobody reads the answers of": lambda peer, more: _upgraded(
        peer, more, frame(2, b"\x81\xa4call\xa5state") * 20_000
    ),
    "invalid msgpack": lambda peer, more: _upgraded(peer, more, frame(2, b"\xc1\xff\xff")),
    "a text that is no UTF-8": lambda peer, more: _upgraded(peer, more, frame(1, b"\xff\xfe")),
    "a close of no code": lambda peer, more: _upgraded(peer, more, frame(8, b"\x00")),
}  # fmt: skip


@contextlib.contextmanager
def crowd(name: str, port: int, count: int, *, more: str = "") -> Iterator[list[socket.socket]]:
    """Let some clients of a kind do their deed, and give their sockets.

    Args:
        name: of the kind.
        port: of the server.
        count: how many.
        more: headers of a request to become a websocket.
    """
    peers: list[socket.socket] = []

    def one(peer: socket.socket) -> None:
        with contextlib.suppress(OSError):
            CLIENTS[name](peer, more)

    try:
        for _ in range(min(count, MOST)):
            peer = socket.create_connection(("127.0.0.1", port), timeout=5.0)
            peers.append(peer)  # Those that there are close whatever the next comes to.
        deeds = [threading.Thread(target=one, args=(peer,), daemon=True) for peer in peers]
        for deed in deeds:
            deed.start()
        for deed in deeds:
            deed.join(1.0)
        yield peers
    finally:
        for peer in peers:
            peer.close()


def is_dropped(peer: socket.socket, seconds: float) -> bool:
    """Whether the other end closes a connection in time."""
    end = time.monotonic() + seconds
    peer.settimeout(1.0)
    while time.monotonic() < end:
        try:
            if not peer.recv(2**16):
                return True
        except TimeoutError:
            continue
        except OSError:
            return True
    return False


def accepted(head: bytes) -> bytes:
    """Return the answer to a client that wants a websocket."""
    lines = head.decode().split("\r\n")
    [key] = [line.split(": ")[1] for line in lines if line.lower().startswith("sec-websocket-key")]
    token = b64encode(sha1(key.encode() + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest())
    return (
        b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Accept: " + token + b"\r\n\r\n"
    )


def _dripped(data: bytes):
    def deed(peer: socket.socket, head: bytes) -> None:
        start, rest = (accepted(head), data) if data.startswith(b"\x82") else (b"", data)
        peer.sendall(start)
        for place in range(len(rest)):
            peer.sendall(rest[place : place + 1])
            time.sleep(0.05)

    return deed


def _framed(*frames: bytes):
    def deed(peer: socket.socket, head: bytes) -> None:
        peer.sendall(accepted(head))
        for each in frames:
            peer.sendall(each)
        time.sleep(30.0)

    return deed


def _raw(data: bytes):
    def deed(peer: socket.socket, _: bytes) -> None:
        peer.sendall(data)
        time.sleep(30.0)

    return deed


SERVERS = {
    "says nothing": _raw(b""),
    "drips its headers": _dripped(b"HTTP/1.1 101 Switching Protocols\r\nX: " + b"y" * 5000),
    "drips its greeting": _dripped(plain(2, b"x" * 5000)),
    "a header of a megabyte": _raw(b"HTTP/1.1 101 Switching Protocols\r\nX: " + b"y" * 2**20),
    "ten thousand headers": _raw(b"HTTP/1.1 101 S\r\n" + b"X: y\r\n" * 10_000 + b"\r\n"),
    "a body without an end": _raw(b"HTTP/1.1 200 OK\r\n\r\n" + b"x" * 2**22),
    "no HTTP": _raw(os.urandom(3000)),
    "SSH": _raw(b"SSH-2.0-OpenSSH_9.6\r\n"),
    "a frame of 2^63 bytes": _framed(plain(2, b"x", claims=2**63 - 1)),
    "a frame of a gigabyte": _framed(plain(2, b"x" * 1000, claims=2**30)),
    "pieces without an end": _framed(
        plain(2, b"x", last=False), *[plain(0, b"x" * 2**16, last=False)] * 2000
    ),
    "pings alone": _framed(plain(9, b"ping") * 2000),
    "invalid msgpack": _framed(plain(2, b"\xc1\xff")),
    "msgpack that is deep": _framed(plain(2, b"\x91" * 100_000)),
    "msgpack of 2^32 entries": _framed(plain(2, b"\xdf\xff\xff\xff\xff")),
    "a text": _framed(plain(1, b"hello")),
    "a masked frame": _framed(frame(2, b"xyz")),
    "closes at once": _framed(plain(8, b"\x03\xe8" + b"z" * 100)),
}


@contextlib.contextmanager
def hostile_server(name: str) -> Iterator[int]:
    """Give the port of a server of a kind."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            with contextlib.suppress(OSError):
                peer, _ = listener.accept()
                with peer:
                    SERVERS[name](peer, peer.recv(4096))

        threading.Thread(target=serve, daemon=True).start()
        yield listener.getsockname()[1]
