"""Who a served policy answers, what it takes from them, and where a client goes."""

from __future__ import annotations

import contextlib
import http.server
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgpack
import numpy as np
import pytest
from websockets.exceptions import InvalidStatus, WebSocketException
from websockets.sync.client import connect
from websockets.sync.server import serve as fake_serve

from nw_base.errors import PolicyError, TrialError
from nw_policies import Bundle, load_bundle, open_policy
from nw_policies import serve as server_module
from nw_policies.remote import decode, encode
from nw_policies.serve import Address, answer, serving

CARD = """\
nw-policy: 1
name: still
robot: go1
adapter: zero
control: {action: joint_position_offset, scale: 0.25}
"""
REMOTE = """\
nw-policy: 1
name: far
robot: go1
adapter: remote
options: {url: "URL", timeout: 60.0, connect_timeout: 60.0}
control: {action: joint_position_offset, scale: 0.25}
observations:
  body: {sensor: proprio, layout: parkour53}
"""
HELLO = {"protocol": 2, "policy": "x", "joints": 12}
EVIL = "sorry\n::error::owned\x1b[2J\u202e" + "y" * 5000


@pytest.fixture(scope="module")
def still(tmp_path_factory) -> Bundle:
    folder = tmp_path_factory.mktemp("still")
    (folder / "policy.yaml").write_text(CARD)
    return load_bundle(folder)


@pytest.fixture
def address(still) -> Iterator[Address]:
    with serving(still) as where:
        yield where


def remote(folder: Path, url: str) -> Bundle:
    (folder / "policy.yaml").write_text(REMOTE.replace("URL", url))
    return load_bundle(folder)


def greeting(url: str, **how):
    with connect(url, proxy=None, compression=None, **how) as connection:
        return decode(connection.recv(timeout=60))


def test_a_web_page_is_turned_away_whatever_its_origin(address):
    for origin in ("https://evil.example", f"http://{address.host}:{address.port}", "null"):
        with pytest.raises(InvalidStatus) as refused:
            greeting(address.url, origin=origin)
        assert refused.value.response.status_code == 403
    assert greeting(address.url)["policy"] == "still"


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_whoever_asks_for_another_host_is_turned_away(address, host):
    """A page can let its own name point to this machine, and is of the same origin then."""
    assert _status(address, f"Host: {host}\r\n") == 421


def test_whoever_asks_for_no_host_or_two_is_turned_away(address):
    assert _status(address, "") == 421
    assert _status(address, "Host: localhost\r\nHost: evil.example\r\n") in {400, 421}
    for host in ("localhost", "127.0.0.1:5", "[::1]:5"):
        assert _status(address, f"Host: {host}\r\n") == 101


def _status(address: Address, host: str) -> int:
    request = (
        f"GET / HTTP/1.1\r\n{host}Upgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    with socket.create_connection((address.host, address.port), timeout=60) as plain:
        plain.sendall(request.encode())
        head = plain.recv(4000)
    assert b"Server:" not in head
    return int(head.split()[1])


def test_one_client_too_many_is_told_so_and_the_next_is_served(address, tmp_path):
    with contextlib.ExitStack() as crowd:
        for _ in range(server_module.CONNECTIONS):
            one = crowd.enter_context(connect(address.url, proxy=None, compression=None))
            one.recv(timeout=60)
        with pytest.raises(PolicyError, match="says: 64 clients are connected already"):
            open_policy(remote(tmp_path, address.url))
    # A place is free again when its thread has seen the client leave.
    until = time.monotonic() + 60.0
    while "error" in greeting(address.url):
        assert time.monotonic() < until, "nobody is served any more"
        time.sleep(0.05)


def test_sockets_that_say_nothing_are_limited_too(still, monkeypatch):
    monkeypatch.setattr(server_module, "_SOCKETS", 3)
    with serving(still) as where, contextlib.ExitStack() as crowd:
        for _ in range(3):
            silent = socket.create_connection((where.host, where.port), timeout=60)
            crowd.enter_context(silent)
        with pytest.raises((WebSocketException, OSError, EOFError)):
            greeting(where.url)


def test_an_error_of_the_policy_is_one_short_line():
    class Angry:
        def reset(self, _seed):
            raise RuntimeError(EVIL)

    told = answer(Angry(), encode({"call": "reset", "seed": 1}))["error"]  # type: ignore[arg-type]
    assert told.startswith("RuntimeError: sorry ::error::owned\\x1b[2J\\u202eyyy")
    assert "\n" not in told
    assert len(told) < 400


@pytest.mark.parametrize(
    "data",
    [
        b"\xdd\x00\x01\x00\x00" + b"\x90" * 0x10000,  # A list of 65,536 lists.
        b"\x81\xa1a" + b"\x91" * 300 + b"\xdc\x13\x88" + b"\x80" * 5000,
        b"\x81\xa1a\xdc\x0f\xff" + (b"\xdc\x00\x02\x90\x90") * 4095,  # 12,285 lists.
        msgpack.packb({"a": "x" * 100_000}),
        msgpack.packb({"a": {"__ndarray__": True, "dtype": "<f4", "shape": [1e400], "data": b""}}),
        msgpack.packb({"a": {"__ndarray__": True, "dtype": "<f4", "shape": [0, 10**18, 10**18],
                             "data": b""}}),
        msgpack.packb({"a": {"__ndarray__": True, "dtype": "(9,9)f4", "shape": [0], "data": b""}}),
        b"\x91" * 5000,
    ],
)  # fmt: skip
def test_a_message_that_unpacks_to_more_than_it_is_gets_refused(data):
    with pytest.raises(ValueError, match=r"it is|it holds|exceeds|too big"):
        decode(data)


@contextlib.contextmanager
def redirecting(to: str) -> Iterator[str]:
    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self):
            self.send_response(302)
            self.send_header("Location", to)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"ws://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_client_follows_no_redirect(address, tmp_path):
    served = address.url
    with (
        redirecting(served) as url,
        pytest.raises(PolicyError, match="HTTP 302; redirects are not followed"),
    ):
        open_policy(remote(tmp_path, url))


@contextlib.contextmanager
def impostor(hello: dict, reply: dict) -> Iterator[str]:
    def handle(connection):
        connection.send(encode(hello))
        for _ in connection:
            connection.send(encode(reply))

    with fake_serve(handle, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"ws://bob:secret@127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join()


def test_what_a_server_says_is_one_harmless_line_without_the_password(tmp_path):
    with impostor(HELLO, {"error": EVIL}) as url:
        policy = open_policy(remote(tmp_path, url))
        with pytest.raises(TrialError) as told:
            policy.act({"body": np.zeros(53, np.float32)})
        policy.close()
    with (
        impostor({"error": EVIL}, {}) as url,
        pytest.raises(PolicyError) as greeted,
    ):
        open_policy(remote(tmp_path, url))
    for text in (str(told.value), str(greeted.value)):
        assert "sorry ::error::owned\\x1b[2J" in text
        assert "ws://127.0.0.1:" in text
        assert "secret" not in text
        assert "\n" not in text
        assert len(text) < 1000


def test_an_idle_client_is_not_cut_off_when_the_time_to_connect_has_passed(address, tmp_path):
    card = REMOTE.replace("connect_timeout: 60.0", "connect_timeout: 0.5")
    (tmp_path / "policy.yaml").write_text(card.replace("URL", address.url))
    bundle, policy = load_bundle(tmp_path), None
    while policy is None:
        with contextlib.suppress(PolicyError):  # A busy machine may take longer to connect.
            policy = open_policy(bundle)
    time.sleep(0.6)
    policy.reset(3)
    assert policy.act({"body": np.zeros(53, np.float32)}).shape == (12,)
    policy.close()
