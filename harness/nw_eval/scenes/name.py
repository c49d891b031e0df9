"""Names of scenes. A name is no path, but logs lie in folders that are called by it."""

from __future__ import annotations

import re

_SEGMENT = r"[A-Za-z0-9_][A-Za-z0-9_.-]*"
_DEPTH, _LENGTH = 4, 120
_NAME = re.compile(rf"{_SEGMENT}(/{_SEGMENT}){{0,{_DEPTH - 1}}}")


def checked_name(name: str) -> str:
    """Return a name, such as `hurdles/one_low_carpet`.

    Raises:
        ValueError: it is not made of one to four parts between slashes, each of letters, digits,
            `_`, `-` and `.`, beginning with none of the last two; or is longer than 120 characters.
    """
    if len(name) > _LENGTH or not _NAME.fullmatch(name):
        raise ValueError(
            f"{name[:60]!r} is not a valid scene name; give up to {_DEPTH} words of letters, "
            f"digits, '_', '-' and '.' with slashes between, {_LENGTH} characters at most"
        )
    return name


def name_of(file_name: str) -> str:
    """Return the name of a file or folder as part of a scene's name."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", file_name).lstrip("-.")[: _LENGTH - 20] or "unnamed"
