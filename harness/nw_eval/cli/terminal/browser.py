"""A page in the reader's browser."""

from __future__ import annotations

from pathlib import Path

from nw_eval.cli.terminal.last_words import tell


def show(page: Path) -> None:
    """Open a page; where there is no browser that is said, and nothing else changes."""
    show_address(page.resolve().as_uri())


def show_address(address: str) -> None:
    """Open an address; where there is no browser that is said, and nothing else changes."""
    import webbrowser

    try:
        opened = webbrowser.open(address)
    except (webbrowser.Error, OSError):
        opened = False
    if not opened:
        tell(f"warning: no browser to open here; the page is {address}")
