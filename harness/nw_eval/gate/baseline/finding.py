"""What the rounds of a run say of its drop, scene by scene and together, before it is put in words.

The scenes of `stats.bank` are strata here: a scene, and what was changed there. Those that are
informational are not in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from nw_eval.errors import IncomparableError
from nw_eval.gate.baseline.comparison import Basis, Claim
from nw_eval.gate.baseline.rounds import Rounds, scores_of
from nw_eval.results.bank import Panel, Stratum
from nw_eval.stats import Interval
from nw_eval.stats.bank import (
    SUSPECT,
    Bank,
    Margins,
    decide,
    drop_interval,
    over_rounds,
    scene_drop_intervals,
)
from nw_eval.suite.model import Gate

_WORST = 3
"""Scenes of which it is said where the candidate fails, though none fell beyond doubt."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What is settled, and by what."""

    word: Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
    rounds: int
    """After how many; all that there are where nothing is."""
    evidence: Mapping[Stratum, float]
    """E_s of each that counts."""
    named: tuple[Stratum, ...]
    """Those that fell, beyond doubt."""
    waits_for: tuple[Stratum, ...] = ()
    """Those that alone hold back a PASS."""
    interval: Interval | None = None
    """Drops that are not ruled out; None where nothing was tested."""
    alone: Mapping[Stratum, Interval] = field(default_factory=dict)
    """Drops in each stratum that its own trials do not rule out, if they were asked for."""

    @property
    def worst(self) -> tuple[Stratum, ...]:
        """Those that fell or may have, and of a policy that was convicted some that speak most."""
        ranked = sorted(self.evidence, key=lambda stratum: (-self.evidence[stratum], stratum))
        least = _WORST if self.word == "REGRESSED" else 0
        return tuple(
            stratum
            for rank, stratum in enumerate(ranked)
            if rank < least or self.evidence[stratum] >= SUSPECT or stratum in self.named
        )


def margins_of(gate: Gate) -> Margins:
    """Return the drops that a gate allows."""
    return Margins(max_drop=gate.most_drop, tolerate=gate.tolerate, scene_drop=gate.scene_drop)


def find(
    rounds: Rounds,
    judged: Sequence[Stratum],
    panel: Panel,
    basis: Basis,
    gate: Gate,
    *,
    claim: Claim,
    alone: bool = False,
) -> Finding:
    """Return what whole rounds show.

    Args:
        rounds: of the candidate.
        judged: strata that count.
        panel: of the baseline.
        basis: what the panel is to the rounds.
        gate: margins, errors and tiers.
        claim: of which starts it is to hold. Of fresh ones no draw leaves less for the rest.
        alone: whether to ask what drops of each stratum its own trials do not rule out.

    Raises:
        IncomparableError: the baseline does not score so much as max_drop: nobody could drop by it,
            and all would pass.
    """
    if basis == "same":
        return Finding(
            word="PASS", rounds=rounds.count, evidence=dict.fromkeys(judged, 1.0), named=()
        )
    scores, margins = np.array([scores_of(panel, stratum) for stratum in judged]), margins_of(gate)
    if not scores.mean() > margins.max_drop:
        raise IncomparableError(
            f"the baseline's mean success is {scores.mean():.3f}: no policy can be worse by "
            f"max_drop {margins.max_drop:g}, so all would pass",
            fix="lower max_drop, or compare with a better policy",
        )
    bank, known = Bank.of(scores), rounds.known(judged, panel)
    if claim != "panel":
        bank = bank.fresh()
    if basis == "fresh":  # Nothing is known of these starts but the scene.
        known = np.broadcast_to(bank.means, known.shape)
    candidate = rounds.scores(judged)
    alphas = {"alpha_pass": 1.0 - gate.confidence, "alpha_regr": gate.false_alarm}
    values = over_rounds(bank, candidate, known, margins)
    ruling = decide(values, [gate.tier(scene) for scene, _ in judged], **alphas)
    count = ruling.rounds
    last = values[count - 1].scenes if count else np.ones(len(judged))
    met = candidate[:count], known[:count]
    return Finding(
        word="INCONCLUSIVE" if ruling.word == "undecided" else ruling.word,
        rounds=count,
        evidence=dict(zip(judged, last.tolist(), strict=True)),
        named=tuple(judged[index] for index in ruling.named),
        waits_for=tuple(judged[index] for index in ruling.waits_for),
        interval=drop_interval(bank, *met, **alphas),
        alone=dict(zip(judged, scene_drop_intervals(bank, *met, **alphas), strict=True))
        if alone and count
        else {},
    )
