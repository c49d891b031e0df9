"""A page that is served until it is closed, with one thread of its own that moves things."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from nw_eval.clean import clean
from nw_eval.viewing.browser import HOST, stop, viser_server

STEP = 0.02
"""Seconds of a control step."""
_WIDTH = 320  # pixels


class ServedPage:
    """Listens at this machine's own address only, and turns other web pages away.

    A context manager. All browsers that show it show the same.

    Args:
        port: to listen at; 0 = one that is free.
        opened: is called with path and query when somebody opens it.

    Attributes:
        server: viser's.

    Raises:
        PrerequisiteError, UsageError: as `viser_server`.
    """

    def __init__(self, port: int, opened: Callable[[str], None] | None = None) -> None:
        self.server: Any = viser_server(port, "nw-eval view", opened)
        self._closed = threading.Event()
        self._mover: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Where browsers find it."""
        return f"http://{HOST}:{self.server.get_port()}"

    def start(self, move: Callable[[], None], tick: float) -> None:
        """Call something every `tick` seconds until the page is closed."""

        def moves() -> None:
            while not self._closed.wait(tick):
                move()

        self._mover = threading.Thread(target=moves, name="view mover", daemon=True)
        self._mover.start()

    def close(self) -> None:
        """Stop serving; a second time does nothing."""
        if not self._closed.is_set():
            self._closed.set()
            if self._mover is not None:
                self._mover.join(timeout=5.0)
            stop(self.server)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def enlarged(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) at least as wide as the panel, its pixels as squares."""
    factor = max(1, -(-_WIDTH // picture.shape[1]))
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def plain(text: str) -> str:
    """Return text that is no Markdown."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]()#+-.!|<>" else c for c in clean(text, at_most=200))
