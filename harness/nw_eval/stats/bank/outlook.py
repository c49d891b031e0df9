"""What further rounds may bring to a run that was not decided.

How good the candidate really is remains unknown: its chances are drawn anew for each simulated end,
from what they may be after its own trials. So "about N more rounds" is no number but a spread, from
runs that the next round ends to those that no number of rounds does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256

import numpy as np

from nw_eval.stats.bank.curve import REPETITIONS, Progress, progress_of
from nw_eval.stats.bank.evidence import Evidence
from nw_eval.stats.bank.panel import Bank, Floats
from nw_eval.stats.bank.simulate import Before, Drawn, GateRules, judge_all
from nw_eval.stats.courses import SceneCounts, likely_chances


def progress_after(
    bank: Bank,
    candidate: Floats,
    baseline: Floats,
    rules: GateRules,
    *,
    waypoints: Sequence[int],
    named: tuple[int, ...] = (),
    repetitions: int = REPETITIONS,
) -> Progress:
    """Return the shares in which each further round would have ended it.

    Args:
        bank: of the baseline, without leading axes.
        candidate: c in the order drawn, shape (R, S); NaN is a trial without a result.
        baseline: b in the order drawn, those of the rounds to come included: shape (Q, S), Q > R.
        rules: of the gate; their number of rounds is not looked at.
        waypoints: k of each scene, shape (S,).
        named: scenes that fell.
        repetitions: simulated ends.

    Returns:
        Shares after 1, ..., Q - R rounds more.
    """
    rounds, scenes = candidate.shape
    more = len(baseline) - rounds
    content = sha256(candidate.astype("<f8").tobytes() + baseline.astype("<f8").tobytes())
    rng = np.random.Generator(np.random.PCG64(int.from_bytes(content.digest()[:16], "little")))
    panels = Bank(
        means=np.broadcast_to(bank.means, (repetitions, scenes)),
        starts=bank.starts,
    )
    evidence = Evidence.before(panels, rules.margins)
    for c, b in zip(candidate, baseline[:rounds], strict=True):
        evidence = evidence.after(*np.broadcast_arrays(c, b, panels.means)[:2])
    drawn = Drawn(
        bank=panels,
        baseline=np.broadcast_to(baseline[rounds:], (repetitions, more, scenes)),
        luck=rng.random((repetitions, more, scenes)),
        waypoints=np.array(waypoints),
    )
    chances = likely_chances(_counts(candidate, waypoints), repetitions, rng)
    ends = judge_all(
        drawn, chances, replace(rules, rounds=more), Before(evidence=evidence, named=named)
    )
    return progress_of(ends.passed, ends.convicted, more)


def _counts(candidate: Floats, waypoints: Sequence[int]) -> list[SceneCounts]:
    """Return how many trials of each scene ended with 0, 1, ..., k waypoints."""
    return [
        SceneCounts.of(np.rint(scores[~np.isnan(scores)] * k).astype(int).tolist(), [k])
        for scores, k in zip(candidate.T, waypoints, strict=True)
    ]
