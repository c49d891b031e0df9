"""Starts confined processes: forked from the fork server where there is a fence, else from nothing.

What has no fence may start processes of its own and use what does not survive a fork, such as CUDA.

A process that runs trials is one of two: the world, which simulates, senses and scores, and the
policy's process, which opens the checkpoint. They meet in numbers only: see
`nw_policies.policy_process`. Neither starts the other; whoever owns them watches both.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import threading
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import Pipe, get_context, resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, Self

from nw_base.confinement import (
    GONE,
    LEFT,
    ForkServer,
    Rules,
    child_environment,
    interrupts_blocked,
    without_script,
)
from nw_base.confinement.family import die_with_parent, environment_of_child
from nw_base.errors import TrialError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Hashable, Sequence

    from nw_base.words import Kernels
    from nw_policies.cards import Card
    from nw_policies.line import PolicyLine

    Line = tuple[Connection, Connection, Connection]

_PRELOAD = "nw_sim.rollout.confined.preload"
_KERNELS = "nw_sim.rollout.confined.kernels"
_LIBRARY = {"onnx": "onnxruntime"}
_NONE = frozenset({"remote", "zero"})
"""Adapters that need no library for their networks; those that are not named need torch."""

_LAST_MOMENTS = 5.0
"""Seconds in which a process that has closed its line, or was killed, must be gone."""

_WARMS = 120.0
"""Seconds in which a process that has been forked says which kernels it has."""

_OURS = ("NW_EVAL_", "PYTEST_")
"""Variables of which no library that the fork server has imported has read any."""

_RIGHTS = ("Umask:", "Uid:", "Gid:", "Groups:", "CapEff:", "NoNewPrivs:", "Cpus_allowed:")
"""Lines of /proc/self/status."""

_lock = threading.Lock()
_fork_server: ForkServer | None = None
_born_in: Hashable = None
"""`_standing` of this process when the fork server was started."""
_with_kernels: ForkServer | None = None
"""The fork server that was told to load kernels."""


class Started(Protocol):
    """A process that was started here."""

    @property
    def pid(self) -> int | None:
        """Its number."""
        ...

    @property
    def sentinel(self) -> int:
        """What is ready when it has ended."""
        ...

    @property
    def exitcode(self) -> int | None:
        """How it ended; negative = signal; None while it runs."""
        ...

    def kill(self) -> None:
        """End it, without waiting."""
        ...

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended, or so many seconds."""
        ...

    def close(self) -> None:
        """Forget it."""
        ...


class WorldAndPolicy:
    """A world's process and its policy's, seen as one: `Started`, but for what is said of both.

    Where the policy's process ends by itself, or is ended, its exit code is that of both.
    """

    def __init__(self, world: Started, policy: Started) -> None:
        self._world = world
        self._policy = policy

    @property
    def both(self) -> tuple[Started, Started]:
        """The world's process, and the policy's."""
        return self._world, self._policy

    @property
    def pid(self) -> int | None:
        """The number of the world's process."""
        return self._world.pid

    @property
    def sentinel(self) -> int:
        """What is ready when the world's process has ended."""
        return self._world.sentinel

    @property
    def exitcode(self) -> int | None:
        """How the first of them ended that did so by itself; None while none has.

        None also where the policy's process has closed its line, or says what cannot be read, and
        goes on.
        """
        world, policy = self._world.exitcode, self._policy.exitcode
        if policy is not None and policy != LEFT:
            return policy
        return None if world == GONE else world

    def kill(self) -> None:
        """End both, without waiting."""
        self._world.kill()
        self._policy.kill()

    def join(self, timeout: float | None = None) -> None:
        """Wait until both have ended, or so many seconds each."""
        self._world.join(timeout)
        if self._world.exitcode is not None:
            self._policy.join(timeout)

    def close(self) -> None:
        """Forget both."""
        for process in self.both:
            if process.exitcode is not None:
                process.close()


def parts_of(process: Started | WorldAndPolicy) -> tuple[Started, ...]:
    """Return the processes that one stands for."""
    return process.both if isinstance(process, WorldAndPolicy) else (process,)


def prepare() -> None:
    """Let the fork server be started, and import what every trial needs, while others plan them."""
    with suppress(OSError):  # Processes are started one by one, then.
        _ = _open_fork_server()


def prepare_for(card: Card) -> None:
    """Let a fork server that there is import what a policy's checkpoint is opened with."""
    fork_server = _fork_server
    if card.is_planned and card.adapters <= {"onnx"}:
        return  # It is read without a library.
    if fork_server is not None and card.adapter not in _NONE:
        fork_server.learn(_LIBRARY.get(card.adapter, "torch"))


def prepare_call(function: Callable[..., Any]) -> None:
    """Let a fork server that there is import the module of a function that will be called."""
    if _fork_server is not None:
        _fork_server.learn(function.__module__)


def prepare_kernels() -> None:
    """Let a fork server that there is load the CPU renderer's kernels, if they have been compiled.

    It takes as long as all else that it imports: what does not draw is forked before.
    """
    if _fork_server is not None:
        _load_kernels(_fork_server)


def has_kernels(wanted: Collection[Kernels]) -> bool:
    """Return whether processes to come have these kernels of the CPU; waits for the fork server."""
    receiver, sender = Pipe(duplex=False)
    with receiver, suppress(OSError, EOFError):
        with sender:
            fork_server = _open_fork_server()
            _load_kernels(fork_server)
            child = fork_server.fork(_tell_warmth, (), (sender,))
        is_told = receiver.poll(_WARMS)
        warmth = receiver.recv_bytes().decode() if is_told else ""
        child.join(_WARMS if is_told else 0.0)
        child.kill()
        return child.exitcode == 0 and set(wanted) <= set(warmth.split())
    return False


def _tell_warmth(sender: Connection) -> None:
    from nw_sim.rollout.confined.kernels import WARM

    sender.send_bytes(" ".join(WARM).encode())


def renew() -> None:
    """Forget the fork server: kernels have been compiled that it does not have."""
    global _fork_server  # noqa: PLW0603 - one a process is the point.
    with _lock:
        _fork_server = None


def start_process(
    function: Callable[..., None],
    arguments: Sequence[Any],
    connections: Sequence[Connection],
    *,
    rules: Rules,
    is_one_of_many: bool,
) -> Started:
    """Return a new process that calls a function.

    Args:
        function: of a module, which confines its process first of all.
        arguments: for it; what `pickle` takes.
        connections: more arguments for it, after the others.
        rules: by which it will confine itself.
        is_one_of_many: whether a fork server is worth it if there is none. One that is not may have
            no processes of its own.

    Raises:
        OSError: no process can be started.
    """
    if not rules.off and (is_one_of_many or _fork_server is not None):
        with suppress(OSError):
            fork_server = _open_fork_server()
            if is_one_of_many:
                _load_kernels(fork_server)
            return fork_server.fork(function, arguments, connections)
    process = get_context("spawn").Process(
        target=function, args=(*arguments, *connections), daemon=not is_one_of_many
    )
    resource_tracker.ensure_running()  # Starting later, it would lift the block.
    atexit.unregister(_let_tracker_end)
    atexit.register(_let_tracker_end)
    with child_environment(fenced=not rules.off), interrupts_blocked(), without_script():
        process.start()
    return process


def start_pair(
    function: Callable[..., None],
    arguments: Sequence[Any],
    connections: Sequence[Connection],
    *,
    rules: Rules,
    policy: Rules | None,
    is_one_of_many: bool,
    output: Connection | None = None,
) -> Started | WorldAndPolicy:
    """Return a new process that calls a function, and beside it one for the policies that it opens.

    Args:
        function: as for `start_process`, and so are `arguments`, `connections`, `rules` and
            `is_one_of_many`. After its connections it is given those of the line to the other
            process, for `use_line`.
        arguments: see there.
        connections: see there.
        rules: see there.
        policy: by which the policy's process will confine itself; None = there is none, and
            policies are opened by the function.
        is_one_of_many: see there.
        output: where what the policy prints goes; None = nowhere.

    Raises:
        OSError: no process can be started.
    """
    if policy is None:
        return start_process(
            function, arguments, connections, rules=rules, is_one_of_many=is_one_of_many
        )
    with open_policy_process(policy, is_one_of_many=is_one_of_many, output=output) as opened:
        process, line = opened
        try:
            world = start_process(
                function,
                arguments,
                (*connections, *line),
                rules=rules,
                is_one_of_many=is_one_of_many,
            )
        except BaseException:
            process.kill()
            raise
    return WorldAndPolicy(world, process)


@contextmanager
def open_policy_process(
    rules: Rules, *, is_one_of_many: bool, output: Connection | None = None
) -> Generator[tuple[Started, Line]]:
    """Start a policy's process, and give it with the line to it, which is closed afterwards.

    Args:
        rules: by which it will confine itself.
        is_one_of_many: as for `start_process`.
        output: where what it prints goes; None = nowhere.

    Raises:
        OSError: it cannot be started.
    """
    # It knows cards and NumPy, for which the fork server does not wait.
    from nw_policies.line import shared_memory
    from nw_policies.served import serve_policies

    with ExitStack() as closing:
        questions, ask = map(closing.enter_context, Pipe(duplex=False))
        hear, answers = map(closing.enter_context, Pipe(duplex=False))
        memory = closing.enter_context(Connection(shared_memory()))
        printed = () if output is None else (output,)
        process = start_process(
            serve_policies if rules.python is None else _be_interpreter,
            (rules,),
            (questions, answers, memory, *printed),
            rules=rules,
            is_one_of_many=is_one_of_many,
        )
        questions.close()
        answers.close()
        yield process, (hear, ask, memory)


_PROGRAM = """
import json, os, sys, types
orders = json.loads(sys.argv[1])
for name in "nw_base", "nw_base.files", "nw_policies":  # They are not installed here.
    package = types.ModuleType(name)
    package.__path__ = [os.path.join(orders["root"], *name.split("."))]
    sys.modules[name] = package
from pathlib import Path
from nw_base.confinement import LEFT, Rules, confine
from nw_base.confinement.family import set_parent
set_parent(os.getppid())
reads = tuple(map(Path, orders["reads_files"]))
reads += Path(sys.executable).parents[1],  # Its environment, which `site` has not found yet.
rules = Rules(reads=reads, network=orders["network"], memory=orders["bytes"])
confine(rules, output=orders["output"])
import site
site.main()
from nw_policies.policy_process import run_program
try:
    run_program(orders)
except (OSError, ValueError):
    pass
os._exit(LEFT)
"""
"""What another interpreter runs: it takes the fence and the protocol from this program's files.

What its environment runs by itself (`.pth` files, `sitecustomize`) runs behind the fence: `-S`
keeps `site` from running before."""


def _be_interpreter(
    rules: Rules,
    questions: Connection,
    answers: Connection,
    memory: Connection,
    output: Connection | None = None,
) -> NoReturn:
    """Become a policy's process with an interpreter of its own, which confines itself.

    Args:
        rules: by which it does so, before it imports the policy.
        questions: what it is asked.
        answers: what it says.
        memory: for observations.
        output: where what it prints goes; None = nowhere.
    """
    from nw_policies.policy_process import MessageLine

    die_with_parent(has_children=False)  # The system remembers it over `exec`.
    passed = {"reads": questions, "writes": answers, "memory": memory, "output": output}
    handles = {name: end.fileno() for name, end in passed.items() if end is not None}
    for handle in handles.values():
        os.set_inheritable(handle, True)
    orders = {
        "output": None,
        **handles,
        "root": str(Path(__file__).resolve().parents[3]),
        "reads_files": [str(path) for path in rules.reads],
        "network": rules.network,
        "bytes": rules.memory,
    }
    program = [str(rules.python), "-I", "-S", "-B", "-c", _PROGRAM, json.dumps(orders)]
    try:
        os.execve(program[0], program, environment_of_child())  # noqa: S606  # The caller allowed it.
    except OSError as error:
        said = f"{rules.python} cannot be started: {error.strerror or error}"
        fault = {"kind": "PolicyError", "lines": [said], "fix": "correct `python` on the card"}
        line = MessageLine(questions.fileno(), answers.fileno())
        with suppress(OSError, EOFError, ValueError):  # It has no reader.
            line.receive()
            line.tell({"error": fault})
        os._exit(LEFT)


class PolicyProcess:
    """A policy's process of a caller that is not confined itself; a context manager.

    It is started when it is first needed, and again after it has ended.

    Args:
        rules: by which it confines itself.
    """

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._cleanup = ExitStack()
        self._process: Started | None = None
        self._line: PolicyLine | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._cleanup.close()

    @property
    def line(self) -> PolicyLine:
        """The line to it, for `line_to`.

        Raises:
            OSError: it cannot be started.
        """
        if self._line is None or self._process is None or self._process.exitcode is not None:
            self._cleanup.close()
            opened = open_policy_process(self._rules, is_one_of_many=True)
            self._process, line = self._cleanup.enter_context(opened)
            self._cleanup.callback(self._end, self._process)
            from nw_policies.line import PolicyLine

            self._line = PolicyLine(*line, lost=self._lost)
        return self._line

    @property
    def pid(self) -> int | None:
        """Its number; None while it is not needed."""
        return None if self._process is None else self._process.pid

    def _end(self, process: Started) -> None:
        process.kill()
        process.join(_LAST_MOMENTS)
        if process.exitcode is not None:
            process.close()
        self._process = self._line = None

    def _lost(self) -> NoReturn:
        process = self._process
        if process is not None:
            process.join(_LAST_MOMENTS)
        code = None if process is None else process.exitcode
        how = "says what cannot be read" if code is None else f"ended with exit code {code}"
        raise TrialError(f"the policy's process {how}", fix="run it on its own")


def _let_tracker_end() -> None:
    """Continue `multiprocessing`'s helper, should somebody have stopped it.

    It is waited for at the end of this process, and has its standard output.
    """
    process = getattr(vars(resource_tracker).get("_resource_tracker"), "_pid", None)
    if process is not None:
        with suppress(OSError):
            os.kill(process, signal.SIGCONT)


def _open_fork_server() -> ForkServer:
    """Return the fork server of this process, a new one if its settings are outdated.

    Raises:
        OSError: there can be none.
    """
    global _fork_server, _born_in
    standing = _standing()
    with _lock:
        if _fork_server is None or not _fork_server.is_alive or _born_in != standing:
            _fork_server, _born_in = ForkServer(), standing
            _fork_server.learn(_PRELOAD)
        return _fork_server


def _load_kernels(fork_server: ForkServer) -> None:
    """Let a fork server load kernels, once, without waiting for it."""
    global _with_kernels  # noqa: PLW0603 - one a process is the point.
    with _lock:
        if fork_server is not _with_kernels:
            fork_server.learn(_KERNELS)
            _with_kernels = fork_server


def _standing() -> Hashable:
    """Return what of this process its children have from their start on.

    Libraries read the environment once (`engine.machine`); limits, rights and cores are the
    system's to know.
    """
    environment = frozenset(
        (name, value) for name, value in os.environ.items() if not name.startswith(_OURS)
    )
    limits, status = (
        Path(f"/proc/self/{name}").read_text(encoding="utf-8") for name in ("limits", "status")
    )
    lines = status.splitlines()
    rights = tuple(line for line in lines if line.startswith(_RIGHTS))
    return environment, limits, rights, Path("/proc/self/ns/mnt").readlink(), os.nice(0)
