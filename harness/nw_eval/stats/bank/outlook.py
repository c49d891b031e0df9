"""What further trials may bring to a run that was not decided.

How good the candidate really is remains unknown: its chances are drawn anew for each simulated end,
from what they may be after its own trials. So "about N more trials" is no number but a spread, from
runs that the next trial ends to those that no number of trials does.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

import numpy as np

from nw_eval.stats.bank.curve import REPETITIONS, Progress, progress_of
from nw_eval.stats.bank.panel import Bank, Floats, Places, Truths
from nw_eval.stats.bank.simulate import scores_of
from nw_eval.stats.bank.trials import DrawnTrials, TrialRules, settle_all
from nw_eval.stats.courses import SceneCounts, likely_chances


def progress_from(
    bank: Bank,
    trials: DrawnTrials,
    rules: TrialRules,
    *,
    known: Sequence[bool] | Truths,
    waypoints: Sequence[int],
    repetitions: int = REPETITIONS,
) -> Progress:
    """Return the shares in which each further trial would have ended a run.

    Args:
        bank: of the baseline, or `Bank.control`, without leading axes.
        trials: all that may still come, in the order drawn, shape (T,), those that have ended among
            them. Of the others the candidate's success, and a control's, is not looked at; NaN
            where a trial that has ended has no result.
        rules: of the gate.
        known: which have ended, shape (T,).
        waypoints: k of each scene, shape (S,).
        repetitions: simulated ends.

    Returns:
        Shares after 1, 2, ... trials more, as many as have not ended.

    Raises:
        ValueError: as `settle_all`.
    """
    ended = np.array(known, dtype=bool)
    more = int((~ended).sum())
    if not more:
        return Progress(passed=(), regressed=())
    rng = _rng(trials, ended)
    shape, k = (repetitions, len(ended)), np.array(waypoints, dtype=np.intp)
    scenes = np.broadcast_to(trials.scenes, shape)

    def simulated(scores: Floats) -> Floats:
        """Return scores, those to come drawn by what the ended ones say, (repetitions, T)."""
        chances = likely_chances(_counts(scores[ended], trials.scenes[ended], k), repetitions, rng)
        drawn = scores_of(rng.random(shape), chances, scenes, k)
        return np.where(ended, scores, drawn)

    candidate = simulated(trials.candidate)
    baseline = simulated(trials.baseline) if bank.paired else trials.baseline
    ends = settle_all(
        bank,
        DrawnTrials(scenes=scenes, candidate=candidate, baseline=np.broadcast_to(baseline, shape)),
        rules,
    )
    first = np.concatenate([[0], np.cumsum(~ended)])  # To come among the first 0, 1, ... places.
    after = [int(first[end.mean]) + sum(not ended[place] for place in end.followed) for end in ends]
    # Whatever is settled already is so after the next trial.
    return progress_of(ends, np.maximum(after, 1).tolist(), more)


def _rng(trials: DrawnTrials, ended: Truths) -> np.random.Generator:
    """Return a generator that is seeded by what has ended, and by the order of all."""
    parts = [trials.scenes.astype("<i8"), trials.candidate[ended].astype("<f8"), ended]
    content = sha256(b"|".join(part.tobytes() for part in parts))
    return np.random.Generator(np.random.PCG64(int.from_bytes(content.digest()[:16], "little")))


def _counts(scores: Floats, scenes: Places, waypoints: Places) -> list[SceneCounts]:
    """Return how many trials of each scene ended with 0, 1, ..., k waypoints."""
    met = ~np.isnan(scores)
    reached = np.rint(np.where(met, scores, 0.0) * waypoints[scenes]).astype(np.intp)
    return [
        SceneCounts.of(reached[met & (scenes == scene)].tolist(), [k])
        for scene, k in enumerate(waypoints.tolist())
    ]
