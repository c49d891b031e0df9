"""What the evidence of whole rounds says of the candidate.

PASS when E_pass >= 1 / alpha_pass, REGRESSED when E_regr >= 1 / alpha_regr. A scene is named once
E_s >= S / alpha_regr, the S scenes sharing the error; a critical one that is named is REGRESSED.
While any E_s is 4 or more PASS waits, so that a single bad scene is less often passed over.

By Ville's inequality a drop of max_drop or more passes with probability at most alpha_pass; one of
at most `tolerate` is convicted by the mean with at most alpha_regr, and if no scene dropped by more
than scene_drop, any is named with at most alpha_regr besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_eval.stats.bank.evidence import Values
from nw_eval.words import Tier

_SUSPECT = 4.0

_Word = Literal["PASS", "REGRESSED", "undecided"]


@dataclass(frozen=True, kw_only=True)
class Ruling:
    """What was found, and when."""

    word: _Word
    rounds: int
    """After how many it was settled; all that there were where it is not."""
    named: tuple[int, ...]
    """Scenes that fell, whatever the word."""
    waits_for: tuple[int, ...]
    """Scenes that alone hold back a PASS that the mean would allow."""


def decide(
    rounds: Sequence[Values],
    tiers: Sequence[Tier],
    *,
    alpha_pass: float = 0.05,
    alpha_regr: float = 0.01,
) -> Ruling:
    """Return what is settled after the first round that settles it; later ones are not looked at.

    Where one round would both pass and convict, which can be so for a drop between the margins, it
    convicts.

    Args:
        rounds: e-values after each round so far, in order.
        tiers: of the scenes, shape (S,). Those that are informational count for no verdict: they
            belong neither into the bank nor here.
        alpha_pass: probability, at most, that a drop of max_drop or more passes.
        alpha_regr: probability, at most, that a drop of `tolerate` or less is convicted.

    Raises:
        ValueError: an alpha is not between 0 and 1, or the tiers are not those of the scenes.
    """
    for alpha in (alpha_pass, alpha_regr):
        if not 0.0 < alpha < 1.0:
            raise ValueError(f"alpha {alpha} is not between 0 and 1; write 0.05 for 5 %")
    if "informational" in tiers:
        raise ValueError(f"scene {tiers.index('informational')} is informational and not judged")
    critical = np.array([tier == "critical" for tier in tiers], dtype=bool)
    named = np.zeros(len(tiers), dtype=bool)
    waits = np.zeros(len(tiers), dtype=bool)

    for number, values in enumerate(rounds, start=1):
        if values.scenes.shape != named.shape:
            raise ValueError(f"{len(tiers)} tiers for scenes of shape {values.scenes.shape}")
        named = named | (values.scenes >= len(tiers) / alpha_regr)
        enough = values.passed >= 1.0 / alpha_pass
        waits = enough & (values.scenes >= _SUSPECT)
        if values.regressed >= 1.0 / alpha_regr or (named & critical).any():
            return _ruling("REGRESSED", number, named, np.zeros_like(named))
        if enough and not waits.any():
            return _ruling("PASS", number, named, waits)
    return _ruling("undecided", len(rounds), named, waits)


def _ruling(word: _Word, rounds: int, named: NDArray[np.bool_], waits: NDArray[np.bool_]) -> Ruling:
    return Ruling(word=word, rounds=rounds, named=_which(named), waits_for=_which(waits))


def _which(scenes: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(np.flatnonzero(scenes).tolist())
