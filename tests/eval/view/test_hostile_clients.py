"""The page under slow clients and such as mean harm: it is served on, and nothing is printed."""

from __future__ import annotations

import sys
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from nw_eval.viewing.browser import stop, viser_server

viser = pytest.importorskip("viser")
sys.path.insert(0, str(Path(__file__).parents[2] / "hostile"))

from peers import CLIENTS, crowd, is_dropped  # noqa: E402

SOON = 60.0
DAILY = {"half closed", "a frame of a gigabyte", "invalid msgpack", "TLS"}
# They have said all that they must, and may go on.
WELCOME = {"half a frame", "ten thousand pings", "pieces without an end", "reset"}


@pytest.fixture(scope="module")
def port() -> Any:
    server = viser_server(0, "under siege")
    yield server.get_port()
    stop(server)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in DAILY else pytest.mark.nightly) for n in CLIENTS]
)
def test_the_page_is_served_beside_clients_that_mean_harm(
    port: int, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    more = f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n"
    with crowd(name, port, 20, more=more) as peers:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=SOON) as answer:
            assert answer.status == 200
        if name not in WELCOME:
            assert is_dropped(peers[0], SOON)
    with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=SOON) as answer:
        assert b"<html" in answer.read().lower()
    assert "Traceback" not in capfd.readouterr().err
