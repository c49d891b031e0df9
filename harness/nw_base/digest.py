"""One canonical text for plain values, and its hash."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any

_ENCODE = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False).encode


def canonical(value: Any) -> str:
    """Return the one text of a JSON value: sorted keys, no spaces, floats by `repr`.

    Raises:
        ValueError: the value holds NaN or infinity, which JSON has no word for.
    """
    return _ENCODE(value)


def digest_of(value: Any) -> str:
    """Return the hex sha256 of a JSON value's `canonical` text.

    Raises:
        ValueError: as there.
    """
    return sha256(canonical(value).encode()).hexdigest()
