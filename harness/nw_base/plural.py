"""Counts of things, and amounts of bytes, as a sentence says them."""

from __future__ import annotations

import re


def plural(count: int, noun: str, several: str | None = None) -> str:
    """Return a count with its noun, such as `1 trial` or `2 trials`.

    Args:
        count: how many there are.
        noun: the word for one.
        several: the word for more than one; None = the noun with an `s`.
    """
    return f"{count} {noun if count == 1 else several or f'{noun}s'}"


# Decimal and binary, as SI and IEC 80000-13 have them.
_UNITS = {f"{letter}B": 10 ** (3 * n) for n, letter in enumerate("KMGT", 1)} | {
    f"{letter}IB": 2 ** (10 * n) for n, letter in enumerate("KMGT", 1)
}
_SIZES = ((10**9, "GB"), (10**6, "MB"), (10**3, "kB"))
# Digits enough for a byte of a thousand terabytes.
_AMOUNT = re.compile(r"(\d{1,15}(?:\.\d{1,15})?) ?([KMGT]I?B)", re.ASCII | re.IGNORECASE)


def bytes_of(text: str) -> int:
    """Return how many bytes `2GB`, `1.5 GiB` or `500MB` are.

    Raises:
        ValueError: it is no such amount, or nothing.
    """
    match = _AMOUNT.fullmatch(text.strip())
    count = int(float(match[1]) * _UNITS[match[2].upper()]) if match else 0
    if count < 1:
        raise ValueError("give a number and its unit, such as 2GB, 1.5GiB or 500MB")
    return count


def in_words(count: int) -> str:
    """Return a number of bytes such as `2.31 GB`, `500 MB` or `1.2 kB`."""
    size, unit = next((one for one in _SIZES if count >= one[0]), _SIZES[-1])
    number = count / size
    return f"{number:.2f}".rstrip("0").rstrip(".") + f" {unit}"
