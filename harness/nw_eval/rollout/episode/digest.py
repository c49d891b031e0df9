"""Digests of what a policy saw, and of a trial, which can be saved in its middle and continued."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray


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


def observation_digest(observation: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the SHA-256 of observations: names in order, types, shapes and bytes."""
    total = sha256()
    for name in sorted(observation):
        array = np.ascontiguousarray(observation[name])
        total.update(_title(name, array.dtype, array.shape))
        total.update(array.data)
    return total.digest()


@lru_cache(maxsize=256)  # They are the same in every control step.
def _title(name: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return f"{name} {kind.str} {shape}".encode()
