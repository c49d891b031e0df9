"""The nulls that are bet against, the numbers that they are about, and the bets.

Three nulls are bet against, each by `wealth.along` on numbers y >= 0. With z, z_min and z_max of
`panel`:

    PASS       "the drop is at least max_drop"       y = z - z_min   n = B - max_drop - z_min
    REGRESSED  "the drop is at most tolerate"        y = z_max - z   n = z_max - (B - tolerate)
    scene s    "its drop is at most scene_drop"      y = 1 - c       n = 1 - (B_s - scene_drop)

(beside a concurrent control, where b is no part of a bank: y = 1 - c + b, n = 1 + scene_drop),
so that a factor is 1 + k (z - m_r) / (m_r - z_min), or 1 + k (m_r - z) / (z_max - m_r), where m_r
is the mean of z that the null leaves for the rest. The first two are means over beta in {0, 1/2}
and bet on the trials of all scenes; a scene's bets are on its own trials. A mean of such processes
is one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nw_eval.stats.bank.panel import Bank, Floats
from nw_eval.stats.bank.wealth import Bets

UP = Bets(shares=(0.4, 0.6, 0.8, 0.95), weights=(0.2, 0.2, 0.4, 0.2))
"""Bets for PASS."""

DOWN = Bets(shares=(0.05, 0.1, 0.2, 0.4, 0.8), weights=(0.2, 0.2, 0.2, 0.2, 0.2))
"""Bets for REGRESSED and against single scenes."""


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


def nulls_at_least(bank: Bank, drop: Floats | float) -> list[Floats]:
    """Return n of "the drop is at least this" for each beta.

    Args:
        bank: of the baseline.
        drop: shape (); or, of one bank without leading axes, any shape: so many nulls apart.
    """
    return [bank.mean[..., 0] - drop - bank.least(beta)[..., 0] for beta in bank.betas]


def nulls_at_most(bank: Bank, drop: Floats | float) -> list[Floats]:
    """Return n of "the drop is at most this" for each beta; drops as for `nulls_at_least`."""
    return [bank.most(beta)[..., 0] - (bank.mean[..., 0] - drop) for beta in bank.betas]


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
