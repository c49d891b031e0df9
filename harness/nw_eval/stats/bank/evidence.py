"""Evidence for PASS, for REGRESSED and against single scenes, round by round.

Three nulls are bet against, each by the wealth of `wealth` on numbers y >= 0. With z, z_min and
z_max of `panel`:

    PASS       "the drop is at least max_drop"       y = z - z_min   n = B - max_drop - z_min
    REGRESSED  "the drop is at most tolerate"        y = z_max - z   n = z_max - (B - tolerate)
    scene s    "its drop is at most scene_drop"      y = 1 - c       n = 1 - (B_s - scene_drop)

(beside a concurrent control, where b is no part of a bank: y = 1 - c + b, n = 1 + scene_drop),
so that a factor is 1 + k (z - m_r) / (m_r - z_min), or 1 + k (m_r - z) / (z_max - m_r), where m_r
is the mean of z that the null leaves for the rest. The first two are means over beta in {0, 1/2}
and bet on all scenes at once; a scene's bets on its own trials. A mean of such processes is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from nw_eval.stats.bank.panel import Bank, Floats, Places, check_successes
from nw_eval.stats.bank.wealth import Bets, Wealth

UP = Bets(shares=(0.4, 0.6, 0.8, 0.95), weights=(0.2, 0.2, 0.4, 0.2))
DOWN = Bets(shares=(0.05, 0.1, 0.2, 0.4, 0.8), weights=(0.2, 0.2, 0.2, 0.2, 0.2))


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Drops of mean success, the baseline's less the candidate's.

    Raises:
        ValueError: not 0 <= tolerate <= max_drop < 1, or not 0 <= scene_drop < 1.
    """

    max_drop: float = 0.10
    """A drop as large as this must not pass."""
    tolerate: float = 0.02
    """A drop as small as this must not be convicted; between the two either may happen."""
    scene_drop: float = 0.10
    """A drop in one scene as small as this must not be held against that scene."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerate <= self.max_drop < 1.0:
            raise ValueError(f"drops {self.tolerate} to {self.max_drop} are not within 0 to 1")
        if not 0.0 <= self.scene_drop < 1.0:
            raise ValueError(f"drop {self.scene_drop} of a scene is not within 0 to 1")


class Values(NamedTuple):
    """E-values after one round."""

    passed: Floats
    """E_pass, shape ()."""
    regressed: Floats
    """E_regr, shape ()."""
    scenes: Floats
    """E_s, shape (S,)."""


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """All that is remembered of the rounds so far. Leading axes are panels apart."""

    bank: Bank
    passed: tuple[Wealth, ...]
    """Against "the drop is at least max_drop", one for each beta."""
    regressed: tuple[Wealth, ...]
    """Against "the drop is at most tolerate", one for each beta."""
    scenes: Wealth
    """Against "the drop in this scene is at most scene_drop"."""

    @classmethod
    def before(cls, bank: Bank, margins: Margins) -> Evidence:
        """Return the evidence before the first round.

        A baseline that nowhere scores max_drop cannot be undercut by so much: E_pass is infinite
        from the start, and says nothing of the candidate.
        """
        return cls(
            bank=bank,
            passed=against_at_least(bank, np.array(margins.max_drop)),
            regressed=against_at_most(bank, np.array(margins.tolerate)),
            scenes=Wealth.before(scene_nulls(bank, margins), bank.starts, DOWN),
        )

    def after(self, candidate: Floats, baseline: Floats) -> Evidence:
        """Return the evidence after one more round: one more start in every scene.

        Starts must come in random order, each once, independently between scenes
        (`order_of_starts`), and the order must not depend on what came of them.

        Args:
            candidate: c, shape (S,). NaN is a trial that has no result: it counts as 0 in E_pass
                and as 1 in E_regr and E_s, so that no verdict gains by what is missing.
            baseline: b of the same starts, from the bank, shape (S,).

        Raises:
            ValueError: a success is not between 0 and 1, a baseline's is missing, shapes are not
                the bank's, or all its starts have been drawn.
        """
        # One layout of memory, so that sums run in one order whatever array a round is cut from.
        candidate = np.array(candidate, dtype=np.float64, order="C")
        baseline = np.array(baseline, dtype=np.float64, order="C")
        scenes = self.bank.means.shape[-1:]
        if candidate.shape != baseline.shape or candidate.shape[-1:] != scenes:
            shapes = f"{candidate.shape} against {baseline.shape}"
            raise ValueError(f"a round of shapes {shapes}, with {scenes[0]} scenes in the bank")
        missing = np.isnan(candidate)
        worst, best = np.where(missing, 0.0, candidate), np.where(missing, 1.0, candidate)
        check_successes(best)
        check_successes(baseline)

        return replace(
            self,
            passed=after_each(self.passed, above(self.bank, worst, baseline)),
            regressed=after_each(self.regressed, below(self.bank, best, baseline)),
            scenes=self.scenes.after(scene_losses(self.bank, best, baseline)[..., None]),
        )

    def only(self, which: Places) -> Evidence:
        """Return the evidence of some of the panels, by their places along the first axis."""
        return replace(
            self,
            bank=replace(self.bank, means=self.bank.means[which]),
            passed=tuple(wealth.only(which) for wealth in self.passed),
            regressed=tuple(wealth.only(which) for wealth in self.regressed),
            scenes=self.scenes.only(which),
        )

    @property
    def values(self) -> Values:
        """The e-values by now."""
        return Values(
            passed=mean_of(self.passed),
            regressed=mean_of(self.regressed),
            scenes=self.scenes.evidence,
        )


def over_rounds(bank: Bank, candidate: Floats, baseline: Floats, margins: Margins) -> list[Values]:
    """Return the e-values after each of R rounds, by one `Evidence.after` for each.

    Args:
        bank: of the baseline.
        candidate: c in the order drawn, shape (R, S); NaN as in `Evidence.after`.
        baseline: b of the same starts, shape (R, S).
        margins: drops that the nulls allow.

    Raises:
        ValueError: as `Evidence.after`, or the shapes differ.
    """
    if candidate.shape != baseline.shape:
        raise ValueError(f"scores of shapes {candidate.shape} against {baseline.shape}")
    evidence, found = Evidence.before(bank, margins), list[Values]()
    for r in range(candidate.shape[-2]):
        evidence = evidence.after(candidate[..., r, :], baseline[..., r, :])
        found.append(evidence.values)
    return found


Gamblers = tuple[Wealth, ...]
"""One for each beta."""


def against_at_least(bank: Bank, drop: Floats) -> Gamblers:
    """Return who bets against "the drop is at least this", before the first round.

    Args:
        bank: of the baseline.
        drop: shape (); or, of one bank without leading axes, any shape: so many nulls apart.
    """
    return tuple(Wealth.before(null, bank.starts, UP) for null in nulls_at_least(bank, drop))


def against_at_most(bank: Bank, drop: Floats) -> Gamblers:
    """Return who bets against "the drop is at most this"; drops as for `against_at_least`."""
    return tuple(Wealth.before(null, bank.starts, DOWN) for null in nulls_at_most(bank, drop))


def nulls_at_least(bank: Bank, drop: Floats | float) -> list[Floats]:
    """Return n of "the drop is at least this" for each beta; drops as for `against_at_least`."""
    return [bank.mean[..., 0] - drop - bank.least(beta)[..., 0] for beta in bank.betas]


def nulls_at_most(bank: Bank, drop: Floats | float) -> list[Floats]:
    """Return n of "the drop is at most this" for each beta; drops as for `against_at_least`."""
    return [bank.most(beta)[..., 0] - (bank.mean[..., 0] - drop) for beta in bank.betas]


def above(bank: Bank, candidate: Floats, baseline: Floats) -> list[Floats]:
    """Return z - z_min of a round for each beta, shape (S,): what PASS is won by."""
    return [bank.adjusted(candidate, baseline, beta) - bank.least(beta) for beta in bank.betas]


def below(bank: Bank, candidate: Floats, baseline: Floats) -> list[Floats]:
    """Return z_max - z of a round for each beta, shape (S,): what REGRESSED is won by."""
    return [bank.most(beta) - bank.adjusted(candidate, baseline, beta) for beta in bank.betas]


def scene_nulls(bank: Bank, margins: Margins) -> Floats:
    """Return n of each scene alone, shape (S,): 1 less the least mean of c that its null allows."""
    return (
        1.0
        - ((0.0 if bank.paired else bank.means) - margins.scene_drop)
        + np.zeros_like(bank.means)
    )


def scene_losses(bank: Bank, candidate: Floats, baseline: Floats) -> Floats:
    """Return y = 1 - c, or 1 - (c - b) beside a control: what a scene's evidence is won by."""
    return 1.0 - (candidate - baseline if bank.paired else candidate)


def after_each(gamblers: Gamblers, values: Sequence[Floats]) -> Gamblers:
    """Return the gamblers after one more round, each with its own y."""
    return tuple(wealth.after(y) for wealth, y in zip(gamblers, values, strict=True))


def mean_of(gamblers: Gamblers) -> Floats:
    """Return the mean of their evidence, which is evidence too."""
    return np.mean([wealth.evidence for wealth in gamblers], axis=0)
