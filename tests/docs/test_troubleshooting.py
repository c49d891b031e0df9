"""Each message of docs/troubleshooting.md is one that the code still prints."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "troubleshooting.md"

_TEXT = re.compile(r"^```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_PLACE = re.compile(r"^[\w./-]+(?::\d+:\d+)?: ")
"""File, or file, line and column, which stand before a fault of a file."""


def messages() -> list[str]:
    blocks = _TEXT.findall(PAGE.read_text(encoding="utf-8"))
    return [line for block in blocks for line in block.splitlines()]


_VALUE = (
    r"(?:nw-eval [^`;]*|`[^`]*`|'[^']*'|[^\s;,'\"`]+|(?:of )?[\d.,]+ \S+"
    r"|`\w+` is \d+ numbers|`\w+` \d+ = \d+(?: [x+] \d+)+)?"
)
"""What fills a gap of a text and is not text itself: a name, a path, a number with its unit."""

Text = tuple[str | None, ...]
"""A text of the code, in pieces; None is a gap."""


@cache
def texts() -> tuple[Text, ...]:
    """Every text of the code that has a word of four letters."""
    found: set[Text] = set()
    for file in sorted((ROOT / "harness").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            pieces = tuple(_pieces(node))
            if any(piece and re.search(r"[a-z]{4}", piece) for piece in pieces):
                found.add(pieces)
    return tuple(sorted(found, key=str))


def _pieces(node: ast.AST) -> Iterator[str | None]:
    if isinstance(node, ast.JoinedStr):
        for part in node.values:
            yield from _pieces(part)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    else:
        yield None


@cache
def is_said(words: str, depth: int = 2) -> bool:
    """Whether a text of the code makes these words, letter by letter.

    What stands in a gap of the text is a value, or is made by another text of the code.
    """
    for text in texts():
        if not all(piece in words for piece in text if piece):
            continue
        for gap in (_VALUE, ".*?")[: depth + 1]:
            pattern = "".join(f"({gap})" if piece is None else re.escape(piece) for piece in text)
            found = re.fullmatch(pattern, words)
            if found and all(_fills(filling, depth - 1) for filling in found.groups()):
                return True
    return False


def _fills(words: str, depth: int) -> bool:
    """Whether a gap can have these words: a value, a text, or a value and a text behind it."""
    if re.fullmatch(_VALUE, words):
        return True
    ends = [0, *(found.start() for found in re.finditer("; ", words))]
    return depth >= 0 and any(
        re.fullmatch(_VALUE, words[:end]) and is_said(words[end:], depth) for end in ends
    )


@cache
def is_printed(message: str) -> bool:
    """Whether texts of the code make this message, joined by semicolons."""
    parts = message.split("; ")
    return any(
        is_said("; ".join(parts[:cut]))
        and (cut == len(parts) or is_printed("; ".join(parts[cut:])))
        for cut in range(len(parts), 0, -1)
    )


def forms_of(message: str) -> set[str]:
    """A message, and what it says behind its place."""
    said = message.removeprefix("fault: ")
    return {said, _PLACE.sub("", said)}


def test_it_has_the_messages_that_a_new_user_meets_most() -> None:
    assert len(messages()) >= 25
    text = PAGE.read_text(encoding="utf-8")
    blocks = len(_TEXT.findall(text))
    assert text.count("**Cause**") == text.count("**Fix**") == blocks, "each has both"


@pytest.mark.parametrize("message", messages())
def test_a_message_is_still_in_the_code(message: str) -> None:
    assert any(map(is_printed, forms_of(message)))


def test_what_the_code_does_not_say_is_found() -> None:
    assert is_printed("no suite 'hurdels'; did you mean 'hurdles'?")
    for words in (
        "no scenario 'hurdels'; did you mean 'hurdles'?",
        "no suite 'hurdels'; did you want 'hurdles'?",
        "no suite 'hurdels' here; did you mean 'hurdles'?",
    ):
        assert not is_printed(words)


@pytest.mark.parametrize("message", messages())
def test_a_message_with_another_word_is_found(message: str) -> None:
    words = re.findall(r"(?<![\w'`/])[a-z]{4,}(?![\w'`/.:])", message)
    changed = message.replace(words[-1], "otherwise gone", 1)
    assert not any(map(is_printed, forms_of(changed)))
