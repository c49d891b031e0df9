"""Each message of docs/troubleshooting.md is one that the code still prints."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "troubleshooting.md"

_TEXT = re.compile(r"^```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_PLACE = re.compile(r"^[\w./-]+:\d+:\d+: ")
"""File, line and column, which stand before a fault of a file."""


def messages() -> list[str]:
    blocks = _TEXT.findall(PAGE.read_text(encoding="utf-8"))
    return [line for block in blocks for line in block.splitlines()]


@cache
def templates() -> frozenset[tuple[str | None, ...]]:
    """Every text of the code, in parts; None stands for what is filled in."""
    found: set[tuple[str | None, ...]] = set()
    for file in sorted((ROOT / "harness").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            parts = node.values if isinstance(node, ast.JoinedStr) else [node]
            said = tuple(_text(part) for part in parts)
            if any(said):
                found.add(said)
    return frozenset(found)


def _text(part: ast.AST) -> str | None:
    if isinstance(part, ast.Constant) and isinstance(part.value, str):
        return part.value
    return None


def is_said(words: str) -> bool:
    """Whether it is a text of the code that fixes two of ten letters, or more."""
    return any(_fits(words, parts) for parts in templates())


def _fits(words: str, parts: tuple[str | None, ...]) -> bool:
    fixed = [part for part in parts if part]
    letters = sum(map(len, fixed))
    if not 0.2 * len(words) <= letters <= len(words):
        return False
    at = 0
    for part in fixed:
        at = words.find(part, at) + len(part)
        if at < len(part):
            return False
    starts = parts[0] is None or words.startswith(parts[0])
    return starts and (parts[-1] is None or words.endswith(parts[-1]))


def is_printed(message: str) -> bool:
    """Whether texts of the code make this message, joined by semicolons."""
    parts = message.split("; ")
    return any(
        is_said("; ".join(parts[:cut]))
        and (cut == len(parts) or is_printed("; ".join(parts[cut:])))
        for cut in range(len(parts), 0, -1)
    )


def test_it_has_the_messages_that_a_new_user_meets_most() -> None:
    assert len(messages()) >= 25
    text = PAGE.read_text(encoding="utf-8")
    blocks = len(_TEXT.findall(text))
    assert text.count("**Cause**") == text.count("**Fix**") == blocks, "each has both"


@pytest.mark.parametrize("message", messages())
def test_a_message_is_still_in_the_code(message: str) -> None:
    said = _PLACE.sub("", message.removeprefix("fault: "))
    assert is_printed(said)


def test_what_the_code_does_not_say_is_found() -> None:
    assert not is_said("no scenario 'hurdels' is there")
    assert is_said("no suite 'hurdels'")
