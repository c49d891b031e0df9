"""What the evidence of whole rounds says of the candidate.

PASS when E_pass >= 1 / alpha_pass, REGRESSED when E_regr >= 1 / alpha_regr. A scene is named once
E_s >= S / alpha_regr, the S scenes sharing the error; a critical one that is named is REGRESSED.
While E_s is 4 or more for a scene that is not named, PASS waits, so that a single bad scene is less
often passed over. It does not wait for one that is named: further rounds have nothing to add about
it, and the mean passes in spite of it. Waiting only makes PASS rarer, so that no error hangs on it.

By Ville's inequality a drop of max_drop or more passes with probability at most alpha_pass; one of
at most `tolerate` is convicted by the mean with at most alpha_regr, and if no scene dropped by more
than scene_drop, any is named with at most alpha_regr besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.stats.bank.evidence import Values
from nw_eval.words import Tier

SUSPECT = 4.0
"""E_s from which a scene may have fallen."""

Truths = NDArray[np.bool_]

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


class Look(NamedTuple):
    """What is to be said after one round; leading axes are panels apart."""

    convicts: Truths
    """Shape (...)."""
    passes: Truths
    """Shape (...). Never where it convicts."""
    named: Truths
    """Scenes that fell by now, shape (..., S)."""
    waits: Truths
    """Scenes that alone hold back a PASS that the mean would allow, shape (..., S)."""


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
    named = waits = np.zeros(len(tiers), dtype=bool)
    for number, values in enumerate(rounds, start=1):
        if values.scenes.shape != named.shape:
            raise ValueError(f"{len(tiers)} tiers for scenes of shape {values.scenes.shape}")
        seen = look(values, named, tiers, alpha_pass=alpha_pass, alpha_regr=alpha_regr)
        named, waits = seen.named, seen.waits
        if seen.convicts or seen.passes:
            word = "REGRESSED" if seen.convicts else "PASS"
            return Ruling(word=word, rounds=number, named=_which(named), waits_for=())
    return Ruling(
        word="undecided", rounds=len(rounds), named=_which(named), waits_for=_which(waits)
    )


def look(
    values: Values, named: Truths, tiers: Sequence[Tier], *, alpha_pass: float, alpha_regr: float
) -> Look:
    """Return what a round shows; the arguments are those of `decide`.

    Args:
        values: e-values after the round, of any leading axes.
        named: scenes that fell in earlier rounds, shape (..., S).
        tiers: of the scenes, shape (S,).
        alpha_pass: of PASS.
        alpha_regr: of REGRESSED.
    """
    critical = np.array([tier == "critical" for tier in tiers], dtype=bool)
    named = named | (values.scenes >= len(tiers) / alpha_regr)
    convicts = (values.regressed >= 1.0 / alpha_regr) | (named & critical).any(axis=-1)
    enough = (values.passed >= 1.0 / alpha_pass) & ~convicts
    waits = enough[..., None] & (values.scenes >= SUSPECT) & ~named
    return Look(convicts=convicts, passes=enough & ~waits.any(axis=-1), named=named, waits=waits)


def most_false_alarms(
    *,
    bar: float | None,
    bar_critical: bool,
    baseline: float | None,
    critical: int,
    scenes: int,
) -> float:
    """Return how often a gate convicts wrongly at most: the sum of what its parts do.

    A policy is convicted wrongly if it is above the bar, in every critical scene too, dropped by
    `tolerate` at most, and in no critical scene by more than scene_drop. By Boole's inequality the
    parts together err with the sum of their probabilities at most.

    Args:
        bar: 1 - confidence of the absolute bar, None without one.
        bar_critical: whether critical scenes are judged alone by it, which share another of these.
        baseline: alpha_regr of the gate against a baseline, None without one.
        critical: scenes of it that convict alone. Each is named wrongly with alpha_regr / S.
        scenes: S.

    Raises:
        ValueError: there are more critical scenes than scenes.
    """
    if not 0 <= critical <= scenes:
        raise ValueError(f"{critical} critical scenes of {scenes}")
    by_bar = 0.0 if bar is None else bar * (2 if bar_critical else 1)
    by_baseline = 0.0 if baseline is None else baseline * (1 + critical / max(scenes, 1))
    return min(1.0, by_bar + by_baseline)


def _which(scenes: Truths) -> tuple[int, ...]:
    return tuple(np.flatnonzero(scenes).tolist())
