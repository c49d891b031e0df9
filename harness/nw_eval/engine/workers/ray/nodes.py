"""The nodes of a cluster as the head knows them: asked what they are, made ready, refused, lost."""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal

from nw_eval.clean import clean
from nw_eval.engine.workers.ray import node as there
from nw_eval.errors import NwEvalError, PrerequisiteError, TrialError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from nw_eval.engine.listener import Listener
    from nw_eval.engine.workers.ray.connection import Joined
    from nw_eval.engine.workers.ray.node import Orders
    from nw_eval.engine.workers.ray.parcels import Outgoing

# Seconds between two looks at which nodes there are, and for which there may be none.
_LOOK, _PATIENCE = 2.0, 60.0
_FAREWELL = 10.0  # s in which nodes tidy up
_PIECE = 2**24  # Bytes of a file that travel at once.
# Times that nothing could be started on a node, after which nothing more is; and seconds between
# them, in which the cluster finds out whether the node is there at all.
_STRIKES, _REST = 3, 5.0


@dataclass(kw_only=True)
class Node:
    """A node that has cores to offer."""

    id: str
    name: str
    """For people: its host, and the first digits of its id."""
    cores: int
    stage: Literal["asked", "listing", "packing", "ready", "refused"]
    awaited: Any = None
    """Ray's reference to the answer to what it was last asked; None = to nothing."""
    strikes: int = 0
    rests_until: float = 0.0


class Nodes:
    """All nodes of the cluster, for one run.

    Args:
        joined: the cluster.
        orders: what nodes make ready.
        outgoing: the files that they may lack.
        question: the arguments of `node.facts`.
        listener: hears of nodes that are refused or lost.
    """

    def __init__(
        self,
        joined: Joined,
        orders: Orders,
        outgoing: Outgoing,
        question: Mapping[str, Any],
        listener: Listener,
    ) -> None:
        self._joined = joined
        self._orders = orders
        self._outgoing = outgoing
        self._question = dict(question)
        self._listener = listener
        self._facts = there.facts(**self._question)
        self._nodes: dict[str, Node] = {}
        self._refused: dict[str, str] = {}  # Why, by id.
        self._pieces: dict[str, list[Any]] = {}  # References to them, by sha256 of their file.
        self._next_look = 0.0
        self._last_hope = monotonic()

    @property
    def ready(self) -> Iterator[Node]:
        """Nodes on which workers can be started."""
        now = monotonic()
        nodes = self._nodes.values()
        return (node for node in nodes if node.stage == "ready" and now >= node.rests_until)

    def look(self) -> None:
        """Take in what nodes have answered, which came and which are gone; wait for nothing.

        Raises:
            PrerequisiteError: all nodes are refused.
            TrialError: there has been none for a minute, or the head of the cluster is lost.
        """
        if monotonic() >= self._next_look:
            if self._joined.check():
                self._count()
            self._next_look = monotonic() + _LOOK
        pending = {each.awaited: each for each in self._nodes.values() if each.awaited is not None}
        if pending:
            answered, _ = self._joined.ray.wait(list(pending), num_returns=len(pending), timeout=0)
            for reference in answered:
                self._hear(pending[reference])
        if not any(each.stage == "packing" for each in self._nodes.values()):
            self._pieces.clear()
        self._check_hope()

    def strike(self, node: Node, error: Exception) -> None:
        """Note that nothing could be started on a node."""
        node.strikes += 1
        node.rests_until = monotonic() + _REST
        if node.strikes >= _STRIKES and node.stage != "refused":
            self._refuse(node, reason_of(error))

    def refuse(self, node: Node, error: Exception) -> None:
        """Use a node no more, since workers cannot be kept alive there."""
        self._refuse(node, reason_of(error))

    def tidy(self) -> None:
        """Have nodes remove what the run left there; wait some seconds at most."""
        ray, token = self._joined.ray, self._orders.token
        if not self._joined.answers:
            return
        pending = [self._ask(each, there.tidy, token) for each in self._nodes.values()]
        if pending:
            ray.wait(pending, num_returns=len(pending), timeout=_FAREWELL)

    def _count(self) -> None:
        """Ask nodes that are new; forget those that are gone."""
        alive = {
            each["NodeID"]: each
            for each in self._joined.ray.nodes()
            if each["Alive"] and each["Resources"].get("CPU", 0) >= 1
        }
        for name in [name for name in self._nodes if name not in alive]:
            self._listener.message(f"node {self._nodes.pop(name).name} is lost")
        for name, each in alive.items():
            if name not in self._nodes:
                node = Node(
                    id=name,
                    name=f"{clean(each['NodeManagerHostname'], at_most=60)} {name[:8]}",
                    cores=int(each["Resources"]["CPU"]),
                    stage="asked",
                )
                self._nodes[name] = node
            node = self._nodes[name]
            if node.stage == "asked" and node.awaited is None and monotonic() >= node.rests_until:
                node.awaited = self._ask(node, there.facts, **self._question)

    def _hear(self, node: Node) -> None:
        """Take in an answer, and ask what comes next."""
        reference, node.awaited = node.awaited, None
        try:
            answer = self._joined.ray.get(reference)
            if node.stage == "asked":
                if differences := _differences(answer, self._facts):
                    self._refuse(node, differences)
                    return
                node.stage = "listing"
                node.awaited = self._ask(node, there.lacking, self._orders.parcels)
            elif node.stage == "listing":
                node.stage = "packing"
                pieces = {sha256: self._cut(sha256) for sha256 in answer}
                node.awaited = self._ask(node, there.make_ready, self._orders, pieces)
            else:
                node.stage = "ready"
        except self._joined.ray.exceptions.RayError as error:
            if getattr(error, "cause", None) is not None:
                self._refuse(node, reason_of(error))
                return
            # A process of Ray's is lost, or all of the node, which the next look will find missing.
            node.stage = "asked"
            self.strike(node, error)

    def _ask(self, node: Node, question: Any, *arguments: Any, **options: Any) -> Any:
        # What compiles kernels holds much memory: its process ends with it.
        once = question is there.make_ready
        return self._joined.on(node.id, question, cores=0, once=once).remote(*arguments, **options)

    def _cut(self, sha256: str) -> list[Any]:
        """Return references to the pieces of a file, which each node fetches once."""
        if sha256 not in self._pieces:
            with self._outgoing.sources[sha256].open("rb") as file:
                pieces = iter(lambda: file.read(_PIECE), b"")
                self._pieces[sha256] = [self._joined.ray.put(piece) for piece in pieces]
        return self._pieces[sha256]

    def _refuse(self, node: Node, reason: str) -> None:
        node.stage, node.awaited = "refused", None
        self._refused[node.id] = f"{node.name}: {reason}"
        self._listener.message(f"node {node.name} is refused: {reason}")

    def _check_hope(self) -> None:
        present: Sequence[Node] = tuple(self._nodes.values())
        if any(node.stage != "refused" for node in present):
            self._last_hope = monotonic()
        elif present:
            raise PrerequisiteError(
                f"no node of the cluster can be used: {self._refused[present[0].id]}"
                + (f" (and {len(present) - 1} more)" if len(present) > 1 else ""),
                fix=f"install nw-eval {self._facts['nw-eval']} there as it is here, under the same "
                "Python and libraries, on the same kind of processor",
            )
        elif monotonic() > self._last_hope + _PATIENCE:
            raise TrialError(
                f"the cluster has had no node with a core to offer for {_PATIENCE:.0f} s",
                fix="look at `ray status`; --resume goes on with the run",
            )


def reason_of(error: Exception) -> str:
    """Return what happened on a node, in one line."""
    cause: Any = getattr(error, "cause", None) or error
    if isinstance(cause, NwEvalError):
        return str(cause)
    lines = [line.strip() for line in str(cause).splitlines() if line.strip()]
    return clean(lines[-1] if lines else repr(cause), at_most=300)


def _differences(theirs: Mapping[str, str], ours: Mapping[str, str]) -> str:
    """Return in words what a node has otherwise than this machine; empty = nothing."""
    found = (
        f"{name} {clean(theirs.get(name, 'none'), at_most=80)}, here {ours.get(name, 'none')}"
        for name in sorted(set(theirs) | set(ours))
        if theirs.get(name) != ours.get(name)
    )
    return "; ".join(found)
