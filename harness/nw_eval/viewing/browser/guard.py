"""Who may speak to the page: browsers of this machine that show the page itself.

Listening at the loopback address alone does not keep other web pages out: any page in a browser of
this machine may open a websocket to it. Browsers say which page that is (`Origin`), and under which
name they reached the server (`Host`), which is not this machine's where a stranger's name was made
to point here. Programs of this machine may send anything: what is no message of the page ends their
connection, and what nobody can act upon is a line of text.
"""

from __future__ import annotations

import asyncio
import http
import logging
import re
import sys
import warnings
from collections.abc import Awaitable, Callable, Generator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from nw_eval.clean import clean

_HERE = re.compile(r"(localhost|127\.0\.0\.1)(:\d+)?")

Answer = Callable[[Any, Any], Any]
"""Of websockets' `process_request`: connection and request to a response, or None to go on."""
Handler = Callable[[Any], Awaitable[None]]
"""Of websockets: what is done with a connection until it ends."""
Opened = Callable[[str], None]
"""Is called with the path and query of every request of the page itself, and returns at once."""


def refusal(hosts: Sequence[str], origins: Sequence[str]) -> str | None:
    """Return why a request is refused; None where it is not.

    Args:
        hosts: its headers `Host`: browsers send one.
        origins: its headers `Origin`: a program that is no browser sends none.
    """
    if len(hosts) != 1 or _HERE.fullmatch(hosts[0]) is None:
        return "this page is reached as localhost only"
    if origins and list(origins) != [f"http://{hosts[0]}"]:
        return "another web page may not speak to this one"
    return None


def guarded(answer: Answer, opened: Opened | None = None) -> Answer:
    """Return a `process_request` that answers whom `refusal` lets in, and nobody inside a frame."""

    def process_request(connection: Any, request: Any) -> Any:
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        words = refusal(hosts, origins)
        if words is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"{words}\n")
        response = answer(connection, request)
        if response is not None:
            response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
            # Another page could ask for it as a picture, but nobody would see what that does.
            fetched_as = request.headers.get("Sec-Fetch-Dest", "document")
            if opened is not None and fetched_as == "document":
                opened(request.path)
        return response

    return process_request


class _Listened:
    """A connection whose frames are messages of viser's; the first other one ends it."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> Any:
        frame = await self._connection.recv()
        if not _is_message(frame):
            await self._connection.close(1007, "this is no message of the page")
            # Frames that came before it was closed are not heard either.
            raise import_module("websockets.exceptions").ConnectionClosedError(None, None)
        return frame


_REFUSED = ("ShareUrl", "FileTransfer")
"""Messages that no page of ours has a button for. The first have viser publish the page through a
server of its makers; the others fill the memory with files."""


def _is_message(frame: object) -> bool:
    """Whether viser can read a frame, and the page has a use for it."""
    messages: Any = import_module("viser._messages")
    try:
        message = messages.Message.deserialize(frame)
    except Exception:  # noqa: BLE001 - Whatever a stranger's bytes do to their reader.
        return False
    return isinstance(frame, bytes) and not type(message).__name__.startswith(_REFUSED)


def listening(handle: Handler) -> Handler:
    """Return a handler of connections that is given messages only, and whose tasks fail quietly."""

    async def handler(connection: Any) -> None:
        asyncio.get_running_loop().set_exception_handler(
            lambda _, context: tell(context.get("exception") or context["message"])
        )
        await handle(_Listened(connection))

    return handler


def tell(fault: object) -> None:
    """Say in a line that something could not be done that somebody asked of the page."""
    kind = f"{type(fault).__name__}: " if isinstance(fault, BaseException) else ""
    print(  # noqa: T201 - The page has no other place for it.
        f"warning: the page could not do what it was sent: {kind}{clean(fault, at_most=200)}",
        file=sys.stderr,
    )


def tell_of_future(future: Any) -> None:
    """Do so where a future failed, as `add_done_callback` calls it."""
    if not future.cancelled() and future.exception() is not None:
        tell(future.exception())


def library_tells_in_lines() -> None:
    """Let viser's modules, once they are imported, tell of failed callbacks by `tell`."""
    # Of values in messages, each of which fails or not where it is used.
    warnings.filterwarnings("ignore", message=r"\[viser\] .* does not match annotation")
    for name, module in list(sys.modules.items()):
        if name.startswith("viser."):
            for printer, ours in (
                ("print_threadpool_errors", tell_of_future),
                ("print_task_error", tell_of_future),
                ("print_awaited_callback_error", tell),
            ):
                if hasattr(module, printer):
                    setattr(module, printer, ours)


def _quiet_logger() -> logging.Logger:
    """Return a logger for connections that are none: they are nobody's news."""
    logger = logging.getLogger("nw_eval.viewing.browser")
    logger.propagate = False
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    return logger


@contextmanager
def servers_are_guarded(opened: Opened | None = None) -> Generator[list[Answer]]:
    """Guard the websocket servers that a library starts meanwhile, which has no option for it.

    Args:
        opened: is called when somebody opens a page.

    Yields:
        What was guarded: it stays empty where the library starts them in another way.
    """
    server: Any = import_module("websockets.asyncio.server")
    found: list[Answer] = []
    serve = server.serve

    def guarded_serve(
        handler: Handler, *arguments: Any, process_request: Answer, **options: Any
    ) -> Any:
        found.append(guarded(process_request, opened))
        options["logger"] = _quiet_logger()
        return serve(listening(handler), *arguments, process_request=found[-1], **options)

    server.serve = guarded_serve
    try:
        yield found
    finally:
        server.serve = serve
