"""What was fetched from a hub or pushed to one, as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.amounts import in_words
from nw_eval.clean import clean
from nw_eval.plural import plural

if TYPE_CHECKING:
    from nw_eval.api import PushedScene
    from nw_eval.hub.fetched import Fetched


def fetched_lines(fetched: Fetched) -> str:
    """Return which revision something is, and where it lies."""
    amount = f"{plural(len(fetched.files), 'file')}, {in_words(fetched.bytes)}"
    return f"{clean(fetched)}: {amount}\n{fetched.folder}"


def pushed_line(pushed: PushedScene) -> str:
    """Return what names the revision that was made."""
    return f"{pushed.reference}: {plural(len(pushed.files), 'file')}, {in_words(pushed.bytes)}"
