"""One canonical text for plain values, and its hash."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import Any


def digest_of(value: Any) -> str:
    """Return the hex sha256 of a JSON value: sorted keys, no spaces, floats by `repr`.

    Raises:
        ValueError: the value holds NaN or infinity, which JSON has no word for.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return sha256(text.encode()).hexdigest()
