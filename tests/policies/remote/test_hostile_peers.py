"""A policy server under clients that mean harm, and a client against servers that do."""

from __future__ import annotations

import resource
import sys
import threading
import time
from pathlib import Path

import pytest
from websockets.sync.client import connect

from nw_base.errors import NwEvalError
from nw_policies import load_bundle, open_policy
from nw_policies.remote import decode
from nw_policies.serve import serving

sys.path.insert(0, str(Path(__file__).parents[2] / "hostile"))

from peers import CLIENTS, SERVERS, crowd, hostile_server, is_dropped

STILL = """\
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
options: {url: "ws://127.0.0.1:PORT", timeout: 2.0, connect_timeout: 2.0}
control: {action: joint_position_offset, scale: 0.25}
observations: {body: {sensor: proprio, layout: parkour53}}
"""
# They are clients that have said all that they must, and may go on.
WELCOME = {"invalid msgpack", "half a frame", "ten thousand pings", "pieces without an end"}
WELCOME |= {"messages that nobody reads the answers of"}
DAILY = {"half a request", "half closed", "TLS", "half a frame", "pieces without an end"}
DAILY |= {"drips its headers", "a frame of a gigabyte"}
SOON = 60.0
MEMORY = 600_000_000


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    folder = tmp_path_factory.mktemp("still")
    (folder / "policy.yaml").write_text(STILL)
    with serving(load_bundle(folder)) as where:
        yield where


def greeted(url):
    with connect(url, proxy=None, compression=None, open_timeout=SOON) as connection:
        return decode(connection.recv(timeout=SOON))["policy"]


def some_by_day(names):
    return [pytest.param(n, marks=() if n in DAILY else pytest.mark.nightly) for n in names]


@pytest.mark.parametrize("name", some_by_day(CLIENTS))
def test_an_honest_client_is_served_beside_clients_that_mean_harm(address, name, capfd):
    threads = threading.active_count()
    with crowd(name, address.port, 20) as peers:
        assert greeted(address.url) == "still"
        if name not in WELCOME | {"reset"}:
            assert is_dropped(peers[0], SOON)
    assert greeted(address.url) == "still"
    until = time.monotonic() + SOON
    while threading.active_count() > threads + 4 and time.monotonic() < until:
        time.sleep(0.1)
    assert threading.active_count() <= threads + 4
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("name", some_by_day(SERVERS))
def test_a_client_gives_up_on_a_server_that_means_harm(name, tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    with hostile_server(name) as port:
        (tmp_path / "policy.yaml").write_text(REMOTE.replace("PORT", str(port)))
        began = time.monotonic()
        with pytest.raises(NwEvalError) as error:
            open_policy(load_bundle(tmp_path))
        assert time.monotonic() - began < SOON / 2
    text = str(error.value)
    assert "\n" not in text
    assert text.isprintable()
    assert len(text) < 2000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before < MEMORY
