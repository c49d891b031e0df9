"""Scenes, policies and robots from elsewhere: fetched from a Hugging Face hub once, and kept.

What is fetched is untrusted: names and sizes are checked before a byte is asked for, what comes
is compared with the digest that the hub says, nothing of it is run. Afterwards no network is
needed, and a run's provenance says which revision it had.

Whoever finds a scene or a policy by its name does not know whether it must be fetched, so listeners
are not handed down: they listen in.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class FetchListener(Protocol):
    """Hears of fetching, in the process that fetches."""

    def fetching(self, name: str, done: int, total: int) -> None:
        """Hear how many bytes of one file are here."""
        ...

    def message(self, text: str) -> None:
        """Hear one line for people."""
        ...


class _NullListener:
    def fetching(self, name: str, done: int, total: int) -> None:
        """Ignore it."""

    def message(self, text: str) -> None:
        """Ignore it."""


_LISTENER: ContextVar[FetchListener] = ContextVar("listener", default=_NullListener())  # noqa: B039 - it holds nothing.


def listener() -> FetchListener:
    """Return who listens."""
    return _LISTENER.get()


@contextmanager
def heard_by(listener: FetchListener) -> Generator[None]:
    """Have somebody hear of what is fetched while the context lasts."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)
