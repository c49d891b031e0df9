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
from nw_eval.stats.bank.decide import Truths
from nw_eval.stats.bank.panel import Bank, Floats, Places
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


def progress_after(
    bank: Bank,
    candidate: Floats,
    baseline: Floats,
    rules: TrialRules,
    *,
    waypoints: Sequence[int],
    named: tuple[int, ...] = (),
    repetitions: int = REPETITIONS,
) -> Progress:
    """Return as `progress_from` the shares in which each further round would have ended a run.

    Args:
        bank: of the baseline, without leading axes.
        candidate: c in the order drawn, shape (R, S); NaN is a trial without a result.
        baseline: b in the order drawn, those of the rounds to come included: shape (Q, S), Q > R.
        rules: of the gate.
        waypoints: k of each scene, shape (S,).
        named: scenes that fell; not looked at, the trials say so.
        repetitions: simulated ends.
    """
    del named
    (count, scenes), most = candidate.shape, len(baseline)
    scores = np.full(baseline.shape, np.nan)
    scores[:count] = candidate
    found = progress_from(
        bank,
        DrawnTrials(
            scenes=np.tile(np.arange(scenes), most),
            candidate=scores.ravel(),
            baseline=np.ravel(baseline),
        ),
        rules,
        known=np.arange(most * scenes) < count * scenes,
        waypoints=waypoints,
        repetitions=repetitions,
    )
    whole = slice(scenes - 1, None, scenes)
    return Progress(passed=found.passed[whole], regressed=found.regressed[whole])


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
