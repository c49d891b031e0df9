"""What is said on standard error when things go wrong: one line, if that still works."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path

from nw_base.clean import clean
from nw_base.files.traceback_file import keep_traceback


def tell(line: str) -> None:
    """Say something on standard error, if that still works."""
    try:
        print(line, file=sys.stderr, flush=True)
    except (OSError, ValueError):
        return


def unforeseen(error: BaseException) -> str:
    """Return in one line what happened, where, and which file has the traceback."""
    try:
        kept = keep_traceback(error)
        frames = traceback.extract_tb(error.__traceback__)
        location = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
        where = "there is no room for its traceback" if kept is None else f"traceback: {kept}"
        return f"unforeseen: {type(error).__name__}: {clean(error)}{location}; {where}"
    except Exception:  # noqa: BLE001 - no memory is left for a sentence, or `__str__` raises.
        return "unforeseen, and without a message that can be read"


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
