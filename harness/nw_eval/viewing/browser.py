"""Pages in a browser by viser: who may speak to them, and what they draw splats by.

Listening at the loopback address alone does not keep other web pages out: any page in a browser of
this machine may open a websocket to it. Browsers say which page that is (`Origin`), and under which
name they reached the server (`Host`), which is not this machine's where an untrusted name was made
to point here. Programs of this machine may send anything: what is no message of the page ends their
connection, and what no user can act upon is a line of text.
"""

from __future__ import annotations

import asyncio
import http
import logging
import re
import socket
import sys
import warnings
from collections.abc import Awaitable, Callable, Generator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import PrerequisiteError, UsageError
from nw_splat.gaussians import SH0, Gaussians

HOST = "127.0.0.1"
"""The page listens at this machine's own address only."""

_HERE = re.compile(r"(localhost|127\.0\.0\.1)(:\d+)?")

Answer = Callable[[Any, Any], Any]
"""Of websockets' `process_request`: connection and request to a response, or None to go on."""
Handler = Callable[[Any], Awaitable[None]]
"""Of websockets: what is done with a connection until it ends."""
Opened = Callable[[str], None]
"""Is called with the path and query of every request of the page itself, and returns at once."""

MOST = 200_000
"""More take a browser without a graphics card longer than a second a picture."""


def check_server(port: int) -> None:
    """Check that a server can be started, before anything is done for it.

    Args:
        port: 0 = one that is free.

    Raises:
        PrerequisiteError: viser is not installed.
        UsageError: nothing can listen at the port.
    """
    _viser()
    try:
        _bind(port)
    except (OSError, OverflowError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or str(error).rstrip(".")
        raise UsageError(
            f"cannot listen at {HOST}, port {port}: {reason}", fix="choose another --port, or 0"
        ) from None


def free_port(wanted: int) -> int:
    """Return a port if nothing listens there, and otherwise 0: any that is free."""
    try:
        _bind(wanted)
    except OSError:
        return 0
    return wanted


def viser_server(port: int, label: str, opened: Opened | None = None) -> Any:
    """Return a running `viser.ViserServer` that prints nothing, shares nothing, and is guarded.

    Args:
        port: 0 = one that is free.
        label: what the browser's tab is called.
        opened: is called when somebody opens the page.

    Raises:
        PrerequisiteError: viser is not installed, does not start, or cannot be guarded.
        UsageError: it cannot listen there.
    """
    check_server(port)  # viser would try a thousand other ports.
    viser = _viser()
    library_tells_in_lines()
    # It draws a box round its address, whatever it is told.
    with servers_are_guarded(opened) as guarded, redirect_stdout(StringIO()):
        try:
            server = viser.ViserServer(host=HOST, port=port, label=label, verbose=False)
        except (OSError, RuntimeError, AssertionError) as error:
            raise PrerequisiteError(
                f"viser does not start: {error}", fix="pip install --upgrade nw-eval[view]"
            ) from error
    if not guarded:
        stop(server)
        raise PrerequisiteError(
            f"viser {viser.__version__} starts its server in an unknown way, so other web "
            "pages could not be kept out",
            fix="pip install 'viser==1.1.1'",
        )
    if port not in {0, server.get_port()}:  # Somebody was faster.
        stop(server)
        raise UsageError(f"port {port} is in use", fix="choose another --port, or 0")
    # Sharing would send the scene to a server of viser's makers.
    server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    return server


def _bind(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, port))


def stop(server: Any) -> None:
    """Stop a server; viser would say so on standard output."""
    with redirect_stdout(StringIO()):
        server.stop()


def _viser() -> Any:
    try:
        return import_module("viser")
    except ImportError as error:
        raise PrerequisiteError(
            f"the page needs the package viser: {error}", fix="pip install 'nw-eval[view]'"
        ) from error


def refusal(hosts: Sequence[str], origins: Sequence[str]) -> str | None:
    """Return why a request is refused; None where it is not.

    Args:
        hosts: its headers `Host`: browsers send one.
        origins: its headers `Origin`: a program that is no browser sends none.
    """
    if len(hosts) != 1 or _HERE.fullmatch(hosts[0]) is None:
        return "this page is reached as localhost only"
    if origins and list(origins) != [f"http://{hosts[0]}"]:
        return "another web page may not connect to this one"
    return None


def guarded(answer: Answer, opened: Opened | None = None) -> Answer:
    """Return a `process_request` that answers whom `refusal` lets in, but no page in a frame."""

    def process_request(connection: Any, request: Any) -> Any:
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        words = refusal(hosts, origins)
        if words is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"{words}\n")
        response = answer(connection, request)
        if response is not None:
            response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
            # Another page could ask for it as a picture, without any visible result.
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
            await self._connection.close(1007, "this is not a message of the page")
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
    except Exception:  # noqa: BLE001 - Untrusted bytes may raise anything in their reader.
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
    """Return a logger for connections that are none: they need no message."""
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
    answers: list[Answer] = []
    serve = server.serve

    def guarded_serve(
        handler: Handler, *arguments: Any, process_request: Answer, **options: Any
    ) -> Any:
        answers.append(guarded(process_request, opened))
        options["logger"] = _quiet_logger()
        return serve(listening(handler), *arguments, process_request=answers[-1], **options)

    server.serve = guarded_serve
    try:
        yield answers
    finally:
        server.serve = serve


@dataclass(frozen=True, kw_only=True, eq=False)
class SplatPoints:
    """N Gaussians in one frame.

    Attributes:
        centers: (N, 3) float32.
        covariances: (N, 3, 3) float32.
        rgbs: (N, 3) float32, 0 to 1, without what depends on the direction.
        opacities: (N, 1) float32, 0 to 1.
    """

    centers: NDArray[np.float32]
    covariances: NDArray[np.float32]
    rgbs: NDArray[np.float32]
    opacities: NDArray[np.float32]

    def take(self, selection: NDArray[np.bool_]) -> SplatPoints:
        """Return the Gaussians at a mask (N,)."""
        return SplatPoints(
            centers=self.centers[selection],
            covariances=self.covariances[selection],
            rgbs=self.rgbs[selection],
            opacities=self.opacities[selection],
        )


def splat_points(
    gaussians: Gaussians, T_world_splat: NDArray[np.float64], *, most: int = MOST
) -> SplatPoints:
    """Return the Gaussians that are seen most, in the world.

    Args:
        gaussians: in the splat's frame.
        T_world_splat: (4, 4) similarity.
        most: how many are kept: those of the largest opacity times area.
    """
    opacity = 1 / (1 + np.exp(-np.clip(gaussians.opacity_logits.astype(np.float64), -60, 60)))
    deviations = np.exp(np.clip(gaussians.log_scales.astype(np.float64), -60, 20))
    ordered = np.sort(deviations, axis=1)
    weight = opacity * ordered[:, 1] * ordered[:, 2]
    whole = np.isfinite(gaussians.means).all(axis=1) & np.isfinite(weight)
    whole &= np.isfinite(gaussians.quats).all(axis=1) & (np.abs(gaussians.quats).sum(axis=1) > 0)
    order = np.argsort(np.where(whole, -weight, np.inf), kind="stable")
    kept = np.sort(order[: min(most, int(whole.sum()))])
    axes = T_world_splat[:3, :3] @ _rotations(gaussians.quats[kept].astype(np.float64))
    means = gaussians.means[kept].astype(np.float64)
    spread = axes * deviations[kept][:, None, :]
    return SplatPoints(
        centers=(means @ T_world_splat[:3, :3].T + T_world_splat[:3, 3]).astype(np.float32),
        covariances=(spread @ spread.transpose(0, 2, 1)).astype(np.float32),
        rgbs=np.clip(0.5 + SH0 * gaussians.sh[kept, 0], 0, 1).astype(np.float32),
        opacities=opacity[kept, None].astype(np.float32),
    )


def _rotations(quats: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations (N, 3, 3) of quaternions (N, 4) w x y z of any length but 0."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
