"""Remote policies: a real server on this machine, the same bits, and clear faults."""

from __future__ import annotations

import hashlib
import io
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from websockets.sync.server import serve

from nw_base.errors import PolicyError, TrialError, UsageError
from nw_policies import Bundle, Policy, load_bundle, open_policy
from nw_policies.bundle import NOTHING
from nw_policies.remote import ask_server, decode, encode
from nw_policies.serve import serving

OBSERVATIONS = """\
observations:
  body: {sensor: proprio, layout: parkour53}
  rgb: {sensor: splat_rgb, camera: ego, width: 16, height: 9, axes: chw}
"""
LOCAL = (
    """\
nw-policy: 1
name: recurrent
robot: go1
adapter: torch-export
checkpoint: {file: policy.pt2, sha256: SHA256}
control: {action: joint_position_offset, scale: 0.25}
inputs: {obs: [body], image: [rgb]}
"""
    + OBSERVATIONS
)
REMOTE = (
    """\
nw-policy: 1
name: recurrent-remote
robot: go1
adapter: remote
options: {url: URL, timeout: 60.0, connect_timeout: 60.0}
control: {action: joint_position_offset, scale: 0.25}
"""
    + OBSERVATIONS
)

HELLO = {"protocol": 2, "policy": "x", "joints": 12}


class Recurrent(nn.Module):
    """Image and body to actions, with a hidden state; fails on bodies of inf."""

    def __init__(self) -> None:
        super().__init__()
        self.rnn = nn.GRU(53 + 432, 16)
        self.head = nn.Linear(16, 12)
        self.register_buffer("hidden", torch.zeros(1, 1, 16))

    def forward(self, obs, image):
        seen = torch.cat([obs, image.to(torch.float32).flatten(1) / 255], dim=1)
        output, hidden = self.rnn(seen[None], self.hidden)
        self.hidden.copy_(hidden)
        return self.head(output[0])


@pytest.fixture(scope="module")
def local(tmp_path_factory) -> Bundle:
    folder = tmp_path_factory.mktemp("local")
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = Recurrent().eval()
    example = torch.zeros(1, 53), torch.zeros(1, 3, 9, 16, dtype=torch.uint8)
    buffer = io.BytesIO()
    torch.export.save(torch.export.export(network, example), buffer)
    (folder / "policy.pt2").write_bytes(buffer.getvalue())
    digest = hashlib.sha256(buffer.getvalue()).hexdigest()
    (folder / "policy.yaml").write_text(LOCAL.replace("SHA256", digest))
    return load_bundle(folder)


@pytest.fixture(scope="module")
def url(local) -> Iterator[str]:
    with serving(local) as address:
        yield address.url


def remote(folder: Path, url: str, card: str = REMOTE) -> Bundle:
    (folder / "policy.yaml").write_text(card.replace("URL", url))
    return load_bundle(folder)


def observations(count: int) -> list[dict[str, np.ndarray]]:
    rng = np.random.default_rng(0)
    return [
        {
            "body": rng.normal(size=53).astype(np.float32),
            "rgb": rng.integers(0, 256, (3, 9, 16), dtype=np.uint8),
        }
        for _ in range(count)
    ]


def play(policy: Policy, count: int = 20) -> tuple[list[np.ndarray], bytes]:
    """A trial with a snapshot in the middle."""
    policy.reset(7)
    actions, state = [], b""
    for step, observation in enumerate(observations(count)):
        if step == count // 2:
            state = policy.state()
        actions.append(policy.act(observation))
    return actions, state


def test_actions_and_states_are_those_of_the_local_policy_bit_for_bit(local, url, tmp_path):
    here, there = open_policy(local), open_policy(remote(tmp_path, url))
    expected, state = play(here)
    actions, remote_state = play(there)
    np.testing.assert_array_equal(actions, expected)
    assert actions[0].dtype == np.float64
    assert remote_state == state
    there.restore(state)
    continued = [there.act(observation) for observation in observations(20)[10:]]
    np.testing.assert_array_equal(continued, expected[10:])
    there.close()
    there.close()
    with pytest.raises(TrialError, match="closed"):
        there.act({})


def test_connections_share_no_state(local, url, tmp_path):
    bundle = remote(tmp_path, url)
    expected, _ = play(open_policy(local))
    results: dict[int, list[np.ndarray]] = {}

    def trial(number: int) -> None:
        policy = open_policy(bundle)
        results[number] = play(policy)[0]
        policy.close()

    threads = [threading.Thread(target=trial, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(results) == [0, 1, 2, 3]
    for actions in results.values():
        np.testing.assert_array_equal(actions, expected)


def test_a_failure_on_the_server_is_reported_and_the_connection_survives(url, tmp_path):
    policy = open_policy(remote(tmp_path, url))
    good = observations(1)[0]
    with pytest.raises(
        TrialError, match=r"failed on the server at ws://.*returned nan for joint 0"
    ):
        policy.act({**good, "body": np.full(53, np.nan, np.float32)})
    with pytest.raises(TrialError, match=r"failed on the server.*KeyError: 'rgb'"):
        policy.act({"body": good["body"]})
    policy.reset(0)
    assert policy.act(good).shape == (12,)


def test_the_served_digest_can_be_pinned(local, url, tmp_path):
    pinned = REMOTE.replace("timeout: 60.0,", f"digest: {local.digest}, timeout: 60.0,", 1)
    open_policy(remote(tmp_path, url, pinned)).close()
    wrong = REMOTE.replace("timeout: 60.0,", f"digest: {'f' * 64}, timeout: 60.0,", 1)
    with pytest.raises(
        PolicyError, match=f"serves the digest {local.digest}, that on the card is fff"
    ):
        open_policy(remote(tmp_path, url, wrong))


@pytest.mark.parametrize("fake", [(encode(HELLO), None)], indirect=True)
def test_a_server_that_says_little_of_itself_is_not_compared(fake, tmp_path):
    served = ask_server(remote(tmp_path, fake))
    assert (served.digest, served.shapes) == (NOTHING, {})


def test_a_card_without_the_served_observations_is_refused(url, tmp_path):
    card = REMOTE.replace(
        "  rgb: {sensor: splat_rgb, camera: ego, width: 16, height: 9, axes: chw}\n", ""
    )
    with pytest.raises(
        PolicyError, match="wants the observation rgb, which the card does not name"
    ):
        open_policy(remote(tmp_path, url, card))


def test_no_server_is_a_policy_error_that_says_how_to_start_one(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"ws://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(
            PolicyError, match=r"no policy server at ws.*start it: nw-eval policies serve BUNDLE"
        ):
            open_policy(remote(tmp_path, url))
    for bad in ("http://127.0.0.1:1", "127.0.0.1:1"):
        with pytest.raises(PolicyError, match="option 'url'"):
            open_policy(remote(tmp_path, bad))


def test_a_taken_port_is_a_usage_error(local):
    with (
        serving(local) as address,
        pytest.raises(UsageError, match="cannot listen on"),
        serving(local, port=address.port),
    ):
        pass


@pytest.mark.parametrize(
    ("host", "port"), [("127.0.0.1", 99999), ("127.0.0.1", -5), ("é..x", 0), ("256.0.0.1", 0)]
)
def test_an_address_that_cannot_be_is_a_usage_error(local, host, port):
    with pytest.raises(UsageError, match=r"cannot listen on .*choose another --host or --port"):
        serving(local, host=host, port=port).__enter__()


@pytest.fixture
def fake(request) -> Iterator[str]:
    """A server that greets with `hello` and answers everything with `reply`."""
    hello, reply = request.param
    released = threading.Event()

    def handle(connection):
        if hello is None:
            released.wait(60)
            return
        connection.send(hello)
        for _ in connection:
            if reply is None:
                released.wait(60)
            elif reply == "close":
                return
            else:
                connection.send(reply)

    with serve(handle, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        released.set()
        server.shutdown()
        thread.join()


def hurried(option: str, reason: str) -> str:
    """Return a card that waits for little time where no answer comes, and enough where one does."""
    return REMOTE.replace(f" {option}: 60.0", f" {option}: {0.3 if 'within' in reason else 60.0}")


@pytest.mark.parametrize(
    ("fake", "reason"),
    [
        ((None, None), "no answer from ws://.* within 0.3 s"),
        ((b"\xc1", None), "cannot read what ws://.* sends: it is not msgpack"),
        (("hello", None), "it is text, not bytes"),
        ((encode({**HELLO, "protocol": 1}), None), "speaks protocol 1, not 2"),
        ((encode({**HELLO, "digest": "v7"}), None), "gives the digest 'v7'; give the SHA-256"),
        ((encode({**HELLO, "joints": np.zeros(3)}), None), "cannot read the greeting of ws://"),
        ((encode({**HELLO, "observations": {"rgb": 5}}), None), "cannot read the greeting of ws"),
        ((encode({**HELLO, "observations": 5}), None), "'observations' as a int, not a map"),
        (
            (encode({**HELLO, "control": {"scale": 0.5}}), None),
            "`control.scale` is 0.5, on this card it is 0.25; copy `control` from the served card",
        ),
        ((encode({**HELLO, "joints": 8}), None), "a policy of 8 joints, the robot 'go1' has 12"),
    ],
    indirect=["fake"],
)
def test_a_wrong_greeting_is_a_policy_error(fake, reason, tmp_path):
    with pytest.raises(PolicyError, match=reason):
        open_policy(remote(tmp_path, fake, hurried("connect_timeout", reason)))


@pytest.mark.parametrize(
    ("fake", "reason"),
    [
        ((encode(HELLO), None), "no answer from ws://.* within 0.3 s; check the server"),
        ((encode(HELLO), "close"), "the connection to ws://.* is lost"),
        ((encode(HELLO), b"\xff\xff"), "cannot read what"),
        ((encode(HELLO), encode({"action": np.zeros(7)})), r"an action of shape \(7,\)"),
        ((encode(HELLO), encode({"action": None})), r"an action of shape \(\)"),
        (
            (encode(HELLO), encode({"error": "out of memory"})),
            "failed on the server.*out of memory",
        ),
        (
            (encode(HELLO), encode({"action": {"__ndarray__": True, "dtype": "O"}})),
            "cannot read what",
        ),
    ],
    indirect=["fake"],
)
def test_a_wrong_answer_is_a_trial_error(fake, reason, tmp_path):
    policy = open_policy(remote(tmp_path, fake, hurried("timeout", reason)))
    with pytest.raises(TrialError, match=reason):
        policy.act(observations(1)[0])
    policy.close()


@pytest.mark.parametrize("dtype", ["f4", "f8", "f2", "u1", "i8", "?"])
def test_arrays_travel_bit_for_bit(dtype):
    array = np.random.default_rng(0).normal(size=(3, 4, 2)).astype(dtype)[:, ::2]
    sent = decode(encode({"a": {"b": [array]}, "n": 3}))
    np.testing.assert_array_equal(sent["a"]["b"][0], array)
    assert sent["a"]["b"][0].dtype == array.dtype
    assert sent["a"]["b"][0].flags.writeable
    with pytest.raises(TypeError, match="object does not travel"):
        encode({"a": np.array([object()])})


def test_an_array_that_claims_100_gb_takes_no_memory():
    forged = {"__ndarray__": True, "dtype": "<f4", "shape": [25_000_000_000], "data": b"\0" * 4}
    with pytest.raises(ValueError, match=r"shape .25000000000,. in 4 bytes"):
        decode(encode({"action": forged}))


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)]
)
@pytest.mark.nightly
def test_the_command_serves_until_it_is_interrupted(local, tmp_path, number):
    served = ["-c", "from nw_eval.cli import main; main()", "policies", "serve"]
    command = [sys.executable, *served, str(local.folder), "--port", "0"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ.copy()
    )
    try:
        line = process.stdout.readline()
        found = re.search(r"serving recurrent at (ws://127\.0\.0\.1:\d+)", line)
        assert found, line + process.stderr.read()
        policy = open_policy(remote(tmp_path, found[1]))
        expected, _ = play(open_policy(local))
        np.testing.assert_array_equal(play(policy)[0], expected)
        policy.close()
        process.send_signal(number)
        assert process.wait(60) == 0
    finally:
        process.kill()
        process.wait()
    missing = subprocess.run(
        [*command[:5], "no-such-policy"], capture_output=True, text=True, check=False
    )
    assert missing.returncode == 2
    assert "unknown policy 'no-such-policy'" in missing.stderr
