"""Builds what all workers will need, once, before the first of them starts.

The splats of built-in scenes are built in processes of their own (`SplatBuilders`), while others do
other things: kernels are compiled, and trials run in the scenes that are built. Each process
takes the next scene of one queue: one that somebody waits for, or else the next in the order in
which trials need them. What they write is what one process would have written, to the byte.

A policy that sees no splat has one only in the log of a trial that failed. For it nothing is built
ahead, but for what an idle core can build while kernels are compiled; a trial that has failed waits
for its scene, and a scene that no trial waits for is not built.

What a process cannot build, for whatever reason, is built by `repair` in this one, which says what
is wrong with it.

The end of this file runs inside the processes.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from select import select
from time import perf_counter
from typing import IO, TYPE_CHECKING, Self

from nw_base.confinement.family import environment_of_child
from nw_base.errors import NwEvalError, UsageError
from nw_base.words import KERNELS
from nw_eval.engine.listener import Listener, NullListener
from nw_places.entry import BuiltInSplat
from nw_scenes.scene import HeightField, Triangles
from nw_sim.rollout.confined.progress import Progress
from nw_sim.rollout.confined.start import has_kernels, renew

if TYPE_CHECKING:
    from collections.abc import Collection, Generator, Iterable

    from nw_base.words import Backend, Kernels, Record
    from nw_policies.cards import Card
    from nw_scenes import Scene

_WORTH_SAYING = 3.0  # s
_LOOK = 1.0  # s between two looks at a process that builds


def needs_splats(card: Card, record: Record) -> bool:
    """Return whether any trial may render: for the policy's eyes or for the log."""
    return bool(card.splat_images) or record in {"all", "failures"}


def check_splats(card: Card, scenes: Iterable[Scene]) -> None:
    """Refuse scenes without a splat to a policy that must see one.

    Raises:
        UsageError: naming the scenes, and what of the card cannot be made there.
    """
    names, without = card.splat_images, [s.name for s in scenes if s.splat is None]
    if names and without:
        raise UsageError(
            f"{', '.join(without)}: no splat, which policy {card.name!r} needs images: "
            f"{', '.join(f'`{name}`' for name in names)}",
            fix="use a policy that sees no splat, or add a splat file to the scene folder",
        )


def open_backend(
    render: Backend,
    listener: Listener,
    *,
    is_fenced: bool,
    surfaces: bool = False,
    kernels: Collection[Kernels] = KERNELS,
    beside: AbstractContextManager[None] | None = None,
) -> None:
    """Compile the renderer once for all workers, or find out that it is missing.

    Args:
        render: the splat renderer.
        listener: receives what took long.
        is_fenced: whether workers are forked, with kernels if there are any.
        surfaces: whether rays meet splats, which has kernels of its own.
        kernels: which of the CPU's are needed.
        beside: entered where anything has to be compiled, and left when it has been.

    Raises:
        PrerequisiteError: the backend's packages or device are missing.
    """
    if is_fenced and render == "cpu" and has_kernels(kernels) and not surfaces:
        return
    from nw_sim.warmup import kernel_note, warmup

    with beside or nullcontext():
        seconds = warmup(render, surfaces=surfaces, kernels=kernels)
    if is_fenced:  # No worker of another run is forked, and who draws pages loads kernels itself.
        renew()
    note = kernel_note() if render == "cpu" else None
    if note is not None:
        listener.message(note)
    elif seconds > _WORTH_SAYING:
        listener.message(f"compiled the renderer in {seconds:.0f} s; next time it is in the cache")


def ready_scans(scenes: Iterable[Scene], listener: Listener) -> None:
    """Compile what collides with scans, once for all workers, if any scene is one.

    Raises:
        PrerequisiteError: this build of MuJoCo is not laid out as any that is known.
    """
    if not any(isinstance(s, HeightField | Triangles) for scene in scenes for s in scene.solids):
        return
    from nw_scenes.narrowphase.install import use_own_collisions

    began = perf_counter()
    use_own_collisions()
    seconds = perf_counter() - began
    if seconds > _WORTH_SAYING:
        listener.message(f"compiled contacts in {seconds:.0f} s; next time they are in the cache")


def needs_splats_first(card: Card, record: Record) -> bool:
    """Return whether trials draw as they run: otherwise only those that failed do, at their end."""
    return bool(card.splat_images) or card.meets_splat or record == "all"


def build_splats(scenes: Iterable[Scene], listener: Listener) -> None:
    """Make the compiled splat of every scene that has one and that the cache does not hold yet.

    Raises:
        SceneError: a splat cannot be made.
    """
    for scene in scenes:
        if scene.splat is not None or scene.props:
            name = scene.name

            def progress(_stage: str, fraction: float, name: str = name) -> None:
                listener.scene(name, fraction)

            scene.splat_stores(progress)


_WORTH = 2
"""Scenes from which on a process of its own, which takes half a second to start, is worth it."""

_DONE, _FAILED = b"done\n", b"failed\n"


class SplatBuilders:
    """Processes that build splats; a context manager, whose end is theirs.

    Args:
        scenes: in the order in which they are needed; those that are built, or are no built-in
            ones, are left out.
        count: how many builds at a time, at most.
        on_demand: whether a trial can begin before its scene is built.
        listener: receives how far each is, in threads, one at a time.
    """

    def __init__(
        self,
        scenes: Iterable[Scene],
        *,
        count: int,
        on_demand: bool = False,
        listener: Listener | None = None,
    ) -> None:
        missing = {
            scene.name: scene for scene in scenes if _is_ours(scene) and not _is_built(scene)
        }
        is_worth_it = len(missing) >= (1 if on_demand else _WORTH)
        self.on_demand = on_demand
        self._missing = missing if is_worth_it else {}
        self._queue = list(self._missing)
        self._wanted: list[str] = []
        self._failed: list[str] = []
        self._most = min(count, len(self._missing))
        self._allowed = 0 if on_demand else self._most
        self._is_ahead = not on_demand
        self._running = 0
        self._is_over = False
        self._listener = listener or NullListener()
        self._lock = threading.Condition()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._threads = [threading.Thread(target=self._feed) for _ in range(self._most)]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._is_over = True
            self._lock.notify_all()
            for process in self._processes:
                process.kill()
        for thread in self._threads:
            thread.join()
        for process in self._processes:
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with suppress(OSError):  # It may hold a name that is not read any more.
                        pipe.close()

    @property
    def missing(self) -> Collection[str]:
        """The scenes, by name, that are still to be built here."""
        return self._missing.keys()

    @property
    def has_more(self) -> bool:
        """Whether there is a build that could begin, if it were allowed to."""
        with self._lock:
            return self._following() is not None

    def want(self, scene: str) -> None:
        """Build a scene, by name, before others: somebody waits for it."""
        with self._lock:
            if scene in self._queue and scene not in self._wanted:
                self._wanted.append(scene)
                self._lock.notify_all()

    def allow(self, count: int) -> None:
        """Begin no further build while so many run."""
        with self._lock:
            if self._allowed != min(count, self._most):
                self._allowed = min(count, self._most)
                self._lock.notify_all()

    @contextmanager
    def beside_compiler(self) -> Generator[None]:
        """Leave one core to this process inside the `with` block, and keep the others busy."""
        before = self._allowed, self._is_ahead
        self._set(max(self._most - 1, min(self._most, 1)), is_ahead=True)
        try:
            yield
        finally:
            self._set(*before)

    def wait(self) -> None:
        """Return when none of them has anything left to build, of all that was missing."""
        self._set(self._most, is_ahead=True)
        for thread in self._threads:
            thread.join()

    def repair(self) -> None:
        """Build here what no process could build, if there is any: one scene.

        Raises:
            SceneError, StoreError: it cannot be built.
        """
        with self._lock:
            name = self._failed.pop(0) if self._failed else None
        if name is not None:
            self._missing[name].splat_store(lambda _, share: self._say(name, share))
            with self._lock:
                del self._missing[name]

    def _set(self, allowed: int, is_ahead: bool) -> None:
        with self._lock:
            self._allowed, self._is_ahead = allowed, is_ahead
            self._lock.notify_all()

    def _say(self, name: str, share: float) -> None:
        with self._lock:
            self._listener.scene(name, share)

    def _following(self) -> str | None:
        """Return what is to be built next; None if nothing is, for now."""
        if self._wanted:
            return self._wanted[0]
        return self._queue[0] if self._queue and self._is_ahead else None

    def _take(self) -> str | None:
        """Wait for a build that may begin; return its scene, or None if there will be none."""
        with self._lock:
            while self._queue and not self._is_over:
                name = self._following()
                if name is None or self._running >= self._allowed:
                    self._lock.wait()
                    continue
                self._queue.remove(name)
                if name in self._wanted:
                    self._wanted.remove(name)
                if _is_built(self._missing[name]):  # By another run.
                    del self._missing[name]
                    continue
                self._running += 1
                return name
            self._lock.notify_all()
            return None

    def _feed(self) -> None:
        """Have one scene after the other built, until there is none."""
        process: subprocess.Popen[bytes] | None = None
        while (name := self._take()) is not None:
            is_built = False
            with suppress(OSError, ValueError):
                process = process or self._started()
                is_built = self._build(process, name)
            if process is not None and process.poll() is not None:
                process = None
            with self._lock:
                self._running -= 1
                if is_built:
                    del self._missing[name]
                elif not self._is_over:
                    self._failed.append(name)
                self._lock.notify_all()
        if process is not None and process.stdin is not None:
            with suppress(OSError):
                process.stdin.close()

    def _started(self) -> subprocess.Popen[bytes]:
        start = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        with self._lock:
            if self._is_over:
                raise OSError
            process = subprocess.Popen(  # noqa: S603  # Our own module, no shell.
                [sys.executable, "-P", "-c", start],
                bufsize=0,  # A line that were read ahead would be waited for.
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment_of_child(),
            )
            self._processes.append(process)
        return process

    def _build(self, process: subprocess.Popen[bytes], name: str) -> bool:
        """Have a process build a scene; return whether it has."""
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{name}\n".encode())
        process.stdin.flush()
        progress = Progress(process.pid, waits=True)
        while line := _next_line(process.stdout, progress):
            if line in {_DONE, _FAILED}:
                return line == _DONE
            self._say(name, float(line))
        process.kill()  # It has closed its pipe, or is stopped.
        process.wait()
        return False


def _next_line(pipe: IO[bytes], progress: Progress) -> bytes:
    """Return a process's next line; none where it has ended, or a signal has stopped it."""
    while not select([pipe], [], [], _LOOK)[0]:
        if progress.look():
            return b""
    return pipe.readline()


def _is_ours(scene: Scene) -> bool:
    return isinstance(scene.splat, BuiltInSplat) and not scene.props


def _is_built(scene: Scene) -> bool:
    return isinstance(scene.splat, BuiltInSplat) and scene.splat.path.is_file()


def serve() -> None:
    """Build the splats of the scenes that are named, one a line, until there is no line.

    Ctrl-C is the parent's business.
    """
    from nw_sim.catalogue import open_scene

    def say(_stage: str, share: float) -> None:
        sys.stdout.write(f"{share}\n")
        sys.stdout.flush()

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in sys.stdin:
        try:
            open_scene(name.rstrip("\n")).splat_store(say)
        except NwEvalError:
            answer = _FAILED
        else:
            answer = _DONE
        sys.stdout.write(answer.decode())
        sys.stdout.flush()
