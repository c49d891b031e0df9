"""Words for people, with an exit code."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Message:
    """Words for people, and the exit code that goes with them."""

    text: str
    exit_code: int = 0
