"""What hits a run on a Ray cluster: three nodes of this machine, of which one is lost."""

import signal
import sys
from importlib.util import find_spec
from pathlib import Path

from aftermath import that_stay
from case import MARK, SESSION, send, stat_of
from hits import begin

sys.path.append(str(Path(__file__).parents[2] / "eval" / "engine" / "ray"))

from raylets import empty_cluster

NODES = 3


def has_ray():
    return find_spec("ray") is not None


def lost_raylet(case, origin):
    """Kill one of three raylets, but not the head's, once it has workers; see what they leave."""
    environment = {
        MARK: case.mark,
        "TMPDIR": str(case.work / "tmp"),
        "NW_EVAL_CACHE": str(case.work / "cache"),
    }
    with empty_cluster(**environment) as cluster:
        for _ in range(NODES):
            cluster.start()
        words = ("--engine", "ray", "--address", cluster.address, "--workers", NODES)
        begin(case, origin, *words, environment=cluster.env)
        node = case.draw.randrange(1, NODES)
        case.wait_until(lambda: cluster.agent(node), every=0.1)
        case.sleep(0.2)
        send([cluster.raylet(node)], signal.SIGKILL)
        case.run.end()
        sessions = {str(node.pid) for node in cluster.nodes}
        workers = that_stay(lambda: _outside(case, sessions))
        if workers:
            case.wrong.append(f"{len(workers)} workers left on nodes")


def _outside(case, sessions):
    """Return the living processes of a case that are none of Ray's own."""
    return [pid for pid in case.relatives() if _session(pid) not in {*sessions, None}]


def _session(pid):
    try:
        return stat_of(pid)[SESSION]
    except OSError:
        return None
