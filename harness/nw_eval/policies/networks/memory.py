"""The recurrent state of a network as bytes, for the snapshot of a trial."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.errors import TrialError


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return arrays as bytes; equal arrays give equal bytes, no arrays give none."""
    if not arrays:
        return b""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def unpack(state: bytes, policy: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of `pack`.

    Raises:
        TrialError: the bytes are no such state.
    """
    if not state:
        return {}
    try:
        with np.load(io.BytesIO(state), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise unfitting(policy, str(error)) from None


def unfitting(policy: str, reason: str) -> TrialError:
    """Return the error for a state that belongs to something else."""
    return TrialError(
        f"the state does not fit policy {policy!r}: {reason}",
        fix="continue a trial with the checkpoint and card that began it",
    )
