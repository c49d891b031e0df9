"""How a draft writes numbers and names."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence

from nw_eval.clean import clean

CHECK = "# CHECK:"
"""Begins every comment that the author of a card must act upon."""

RATE_LINE = f"rate: 10  {CHECK} images a second of the training; 50 = one for each action"
"""Of a camera whose rate no file tells."""

_WORDS = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}
"""What YAML reads as something else than a word."""


def number(value: float) -> str:
    """Return a number as YAML reads it: `1e-05` would be a word there."""
    short = f"{value:g}"
    return f"{value:.12f}".rstrip("0").rstrip(".") if "e" in short else short


def in_brackets(values: Sequence[float]) -> str:
    """Return a list of numbers."""
    return f"[{', '.join(number(value) for value in values)}]"


def per_joint(values: Sequence[float]) -> str:
    """Return one number if all are equal, else a list."""
    return number(values[0]) if len(set(values)) == 1 else in_brackets(values)


def slug(name: str) -> str:
    """Return a name as cards allow it; "" if nothing is left of it."""
    return re.sub(r"[^a-z0-9._-]+", "-", name.lower()).strip("-._")[:64]


def key(name: str) -> str:
    """Return a name of an input as the key of an observation."""
    return re.sub(r"[.-]", "_", slug(name)) or "obs"


def plain(text: str) -> str:
    """Return text of a file as a comment can hold it: on one line, and not too long."""
    return clean(text, at_most=400)


def quoted(name: str) -> str:
    """Return a name as YAML reads it."""
    if re.fullmatch(r"[A-Za-z_][\w.-]*", name, re.ASCII) and name.lower() not in _WORDS:
        return name
    return json.dumps(name)
