"""viser, which is not installed with nw-eval itself."""

from __future__ import annotations

import socket
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from typing import Any

from nw_eval.errors import PrerequisiteError, UsageError
from nw_eval.viewing.browser.guard import (
    Opened,
    library_tells_in_lines,
    servers_are_guarded,
)

HOST = "127.0.0.1"
"""The page listens at this machine's own address only."""


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
            f"viser {viser.__version__} starts its server in a way that is not known here, and "
            "other web pages could not be kept out",
            fix="pip install 'viser==1.1.1'",
        )
    if port not in {0, server.get_port()}:  # Somebody was faster.
        stop(server)
        raise UsageError(f"port {port} is in use", fix="choose another --port, or 0")
    # Sharing would send the place to a server of viser's makers.
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
            f"the page needs the package viser: {error}", fix="pip install nw-eval[view]"
        ) from error
