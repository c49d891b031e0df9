"""viser, which is not installed with nw-eval itself."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from nw_eval.errors import PrerequisiteError, UsageError


def viser_server(host: str, port: int) -> Any:
    """Return a running `viser.ViserServer`, which prints nothing and shares nothing.

    Args:
        host: address that it listens at.
        port: 0 = one that is free.

    Raises:
        PrerequisiteError: viser is not installed, or does not start.
        UsageError: it cannot listen there.
    """
    try:
        viser = import_module("viser")
    except ImportError as error:
        raise PrerequisiteError(
            f"the label page needs the package viser: {error}", fix="pip install nw-eval[twin]"
        ) from error
    try:
        server = viser.ViserServer(host=host, port=port, label="nw-eval label", verbose=False)
    except (OSError, RuntimeError, AssertionError) as error:
        raise UsageError(
            f"cannot listen at {host}, port {port}: {error}", fix="choose another --port, or 0"
        ) from error
    # Sharing would send the place to a server of viser's makers.
    server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    return server
