"""Which trials of a run are run again: some that nobody can foresee."""

from __future__ import annotations

import re
import secrets
from collections.abc import Collection
from hashlib import sha256
from math import ceil

from nw_eval.errors import UsageError

SAMPLE = "5%"
"""Of the trials with a result, where nothing else is asked for."""

_BITS = 48  # of a seed, which somebody may have to type
_SHARE = re.compile(r"([0-9]{1,3}(?:\.[0-9]{1,9})?) ?%|([0-9]{1,9})")


def unforeseen_seed() -> int:
    """Return a seed that nobody knew before."""
    return secrets.randbits(_BITS)


def draw(trials: Collection[str], sample: str, seed: int) -> tuple[str, ...]:
    """Return the trials that a seed draws, sorted: the same ones whatever their order was.

    Args:
        trials: ids.
        sample: as `check_sample`.
        seed: of the draw.
    """
    count = min(max(1, _count(sample, len(trials))), len(trials))
    ranked = sorted(trials, key=lambda name: sha256(f"{seed}/{name}".encode()).digest())
    return tuple(sorted(ranked[:count]))


def check_sample(sample: str, option: str = "--sample") -> None:
    """Refuse what is neither a share, such as `5%`, nor a number of trials.

    Args:
        sample: the words.
        option: what they were given for.

    Raises:
        UsageError: it is not.
    """
    found = _SHARE.fullmatch(sample)
    if found is None or not 0.0 < float(found[1] or found[2]) <= (100.0 if found[1] else 1e9):
        raise UsageError(
            f"{option} {sample!r} is no share of the trials and no number of them",
            fix="give one, such as 5% or 3",
        )


def _count(sample: str, of: int) -> int:
    if sample.endswith("%"):
        return ceil(float(sample.rstrip(" %")) / 100.0 * of)
    return int(sample)
