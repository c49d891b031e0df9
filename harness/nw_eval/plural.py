"""Counts of things, as a sentence says them."""

from __future__ import annotations


def plural(count: int, noun: str, several: str | None = None) -> str:
    """Return a count with its noun, such as `1 trial` or `2 trials`.

    Args:
        count: how many there are.
        noun: the word for one.
        several: the word for more than one; None = the noun with an `s`.
    """
    return f"{count} {noun if count == 1 else several or f'{noun}s'}"
