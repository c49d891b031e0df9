"""Named arrays as bytes and back, for the states of sensors."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return arrays as the bytes of an .npz file; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def unpack(state: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of `pack`."""
    with np.load(io.BytesIO(state), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
