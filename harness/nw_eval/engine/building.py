"""Builds the splats of built-in scenes in processes of their own, while this one does other things.

They only save time: what they have not built when they are waited for, for whatever reason, is
built by `prepare.build_splats`, which says what is wrong with it. Each takes the next scene of one
queue, in the order in which trials need them. What they write is what one process would have
written, to the byte.

The end of this file runs inside them.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Self

from nw_eval.built_in.entry import BuiltInSplat
from nw_eval.confinement.environment import environment_of_child
from nw_eval.engine.listener import Listener, NullListener

if TYPE_CHECKING:
    from collections.abc import Iterable

    from nw_eval.scenes import Scene

_WORTH = 2
"""Scenes from which on a process of its own, which takes half a second to start, is worth it."""


class SplatBuilders:
    """Processes that build splats; a context manager, whose end is theirs.

    Args:
        scenes: in the order in which they are needed; those that are built, or are no built-in
            ones, are left out.
        count: how many processes, at most.
        listener: hears how far each is, in threads, one at a time.
    """

    def __init__(
        self, scenes: Iterable[Scene], *, count: int, listener: Listener | None = None
    ) -> None:
        missing = [
            scene.name
            for scene in scenes
            if isinstance(scene.splat, BuiltInSplat) and not scene.splat.path.is_file()
        ]
        self._queue = deque(missing)
        self._count = min(count, len(missing)) if len(missing) >= _WORTH else 0
        self._listener = listener or NullListener()
        self._lock = threading.Lock()
        self._processes: list[subprocess.Popen[bytes]] = []
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Self:
        start = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        for _ in range(self._count):
            with suppress(OSError):  # Then others build it, or it is built when it is needed.
                process = subprocess.Popen(  # noqa: S603  # Our own module, no shell.
                    [sys.executable, "-P", "-c", start],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env=environment_of_child(),
                )
                self._processes.append(process)
                self._threads.append(threading.Thread(target=self._feed, args=(process,)))
                self._threads[-1].start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._queue.clear()
        for process in self._processes:
            process.kill()
        self.wait()
        for process in self._processes:
            process.wait()

    def wait(self) -> None:
        """Return when none of them has anything left to build."""
        for thread in self._threads:
            thread.join()

    def _feed(self, process: subprocess.Popen[bytes]) -> None:
        """Give a process one scene after the other, until there is none or it is gone."""
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError), process.stdin, process.stdout:
            while True:
                with self._lock:
                    if not self._queue:
                        return
                    name = self._queue.popleft()
                process.stdin.write(f"{name}\n".encode())
                process.stdin.flush()
                for line in iter(process.stdout.readline, b""):
                    if line == _DONE:
                        break
                    with self._lock:
                        self._listener.scene(name, float(line))
                else:
                    return


_DONE = b"done\n"


def serve() -> None:
    """Build the splats of the scenes that are named, one a line, until there is no line."""
    from nw_eval.catalogue import open_scene

    def say(_stage: str, share: float) -> None:
        sys.stdout.write(f"{share}\n")
        sys.stdout.flush()

    for name in sys.stdin:
        open_scene(name.rstrip("\n")).splat_store(say)
        sys.stdout.write(_DONE.decode())
        sys.stdout.flush()
