"""Ray clusters of this machine: a head, more raylets, and an end to all of their processes."""

import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

RAY = "from ray.scripts.scripts import main; main()"
STORE = 80 * 10**6  # bytes; Ray takes no less than 75 MiB
PATIENCE = 120.0  # s


@contextmanager
def empty_cluster(**environment):
    """Yield a cluster without nodes; end all that it has in the end.

    Args:
        environment: of its nodes, beside this process's.
    """
    token = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    quiet = {"RAY_USAGE_STATS_ENABLED": "0", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory(prefix="nw-", ignore_cleanup_errors=True) as folder:
        cluster = Cluster(Path(folder), token | quiet | environment)
        try:
            yield cluster
        finally:
            cluster.kill()


def until(condition, what):
    """Wait until a condition holds, and return what it came to."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.2)
    raise AssertionError(f"{what}: not within {PATIENCE:.0f} s")


@dataclass
class Cluster:
    """Nodes of a cluster, each `ray start --block` in a session of its own."""

    folder: Path
    env: dict
    nodes: list = field(default_factory=list)

    @property
    def address(self):
        return (self.folder / "ray_current_cluster").read_text().strip()

    def start(self, *, env=None):
        """Start one more node with one core: the head, if it is the first."""
        own = ["--num-cpus=1", f"--object-store-memory={STORE}", "--dashboard-agent-listen-port=0"]
        if self.nodes:
            own += [f"--address={self.address}"]
        else:
            own += ["--head", "--port=0", "--include-dashboard=false"]
            own += [f"--temp-dir={self.folder}", f"--ray-client-server-port={_free_port()}"]
        self.nodes.append(
            subprocess.Popen(
                [sys.executable, "-c", RAY, "start", "--block", *own],
                env=os.environ | self.env | (env or {}),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        )
        until(lambda: self.raylet(-1) or self.nodes[-1].poll() is not None, "a raylet")
        until((self.folder / "ray_current_cluster").exists, "the head's address")

    def raylet(self, node):
        """The process id of a node's raylet; None while it has none."""
        return self._process(node, "/raylet --raylet_socket_name")

    def agent(self, node):
        """The process id of what has a node's workers; None while it has none."""
        return self._process(node, "ray::NodeAgent")

    def control(self):
        """The process id of the head's control service."""
        return self._process(0, "/gcs_server --")

    def _process(self, node, mark):
        found = _processes(self.nodes[node].pid)
        return next((process for process, line in found if mark in line), None)

    def kill(self):
        """End every process of every node."""
        for node in self.nodes:
            while found := _processes(node.pid):
                for process, _ in found:
                    with suppress(ProcessLookupError):
                        os.kill(process, signal.SIGKILL)
                node.poll()
                time.sleep(0.05)


def _free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def _processes(session):
    """Processes of a session that have not ended, with their command lines."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                state, _, _, own = (folder / "stat").read_text().rpartition(") ")[2].split()[:4]
                if int(own) == session and state != "Z":
                    line = (folder / "cmdline").read_bytes().replace(b"\0", b" ")
                    found.append((int(folder.name), line.decode(errors="replace")))
    return found
