"""A checksum as the last key of a JSON object, so that damage is seen before a value is believed.

    {"row": {...}, "sum": "0123456789abcdef"}

It covers every byte before it, and whatever stood before the object, if the caller says so: lines
that are chained in this way cannot be left out, repeated or exchanged without notice. It is no
signature: whoever can write the file can write its sums.
"""

from __future__ import annotations

import re
from hashlib import sha256

_DIGITS = 16
_END = re.compile(rb',\s{0,3}"sum": ?"([0-9a-f]{16})"\n?\}\n?\Z')
_LONGEST_END = 64  # bytes, which is more than `_END` can match
_LINES_END = b'"}\n'
_OF_A_LINE = len(',"sum":""}\n') + _DIGITS


def seal(text: str, before: str = "") -> tuple[str, str]:
    """Return a JSON object with its sum as the last key, and the sum.

    Args:
        text: one object with at least one key, in one line or indented by two spaces.
        before: the sum of what stands before it.
    """
    head = text.rstrip()[:-1].rstrip()
    value = _sum(head.encode(), before)
    if "\n" in text:
        return f'{head},\n  "sum": "{value}"\n}}\n', value
    return f'{head},"sum":"{value}"}}\n', value


def sum_of(data: bytes) -> str:
    """Return the sum that a JSON object says it has, true or not; empty if it says none."""
    end = _END.search(data[-_LONGEST_END:])
    return end.group(1).decode() if end else ""


def unseal(data: bytes, before: str = "") -> tuple[bytes, str]:
    """Return a JSON object without its sum, and the sum.

    Raises:
        ValueError: the sum is missing, or is that of other bytes.
    """
    if data.endswith(_LINES_END):  # As `seal` ends every line of a journal.
        head = data[:-_OF_A_LINE]
        actual = _sum(head, before)
        if data.endswith(f',"sum":"{actual}"}}\n'.encode()):
            return head + b"}", actual
    start = max(0, len(data) - _LONGEST_END)
    end = _END.search(data[start:])
    if end is None:
        raise ValueError("its checksum is missing")
    head = data[: start + end.start()]
    written, actual = end.group(1).decode(), _sum(head, before)
    if written != actual:
        raise ValueError(f"its checksum is {written}, what it holds gives {actual}")
    return head + b"}", written


def _sum(head: bytes, before: str) -> str:
    return sha256(before.encode() + head).hexdigest()[:_DIGITS]
