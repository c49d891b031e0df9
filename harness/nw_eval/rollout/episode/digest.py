"""Digests of a trial, which can be saved in its middle and continued."""

from __future__ import annotations

from hashlib import sha256

import numpy as np


class ChainDigest:
    """SHA-256 of (previous digest, new bytes), over and over.

    hashlib cannot save a hash half way; a chain of 32-byte values can, so a trial that is restored
    from a state in its middle ends with the same digest as the one that ran through.
    """

    def __init__(self) -> None:
        self._value = bytes(32)

    def update(self, *arrays: np.ndarray) -> None:
        """Append arrays; each is hashed as little-endian float64."""
        link = sha256(self._value)
        for array in arrays:
            link.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        self._value = link.digest()

    @property
    def hex(self) -> str:
        """The digest so far, 64 hexadecimal digits."""
        return self._value.hex()

    def state(self) -> bytes:
        """Return the digest so far, 32 bytes."""
        return self._value

    def restore(self, state: bytes) -> None:
        """Go on from a `state`."""
        self._value = state
