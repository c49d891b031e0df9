"""Who may speak to the page: browsers of this machine that show the page itself.

Listening at the loopback address alone does not keep other web pages out: any page in a browser of
this machine may open a websocket to it. Browsers say which page that is (`Origin`), and under which
name they reached the server (`Host`), which is not this machine's where a stranger's name was made
to point here.
"""

from __future__ import annotations

import http
import re
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

_HERE = re.compile(r"(localhost|127\.0\.0\.1)(:\d+)?")

Answer = Callable[[Any, Any], Any]
"""Of websockets' `process_request`: connection and request to a response, or None to go on."""
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

    def guarded_serve(*arguments: Any, process_request: Answer, **options: Any) -> Any:
        found.append(guarded(process_request, opened))
        return serve(*arguments, process_request=found[-1], **options)

    server.serve = guarded_serve
    try:
        yield found
    finally:
        server.serve = serve
