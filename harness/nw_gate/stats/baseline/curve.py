"""What a gate flags, passes and leaves open, and after how many trials: by simulation.

**Gates that were not run.** A policy of a known drop is judged as a real one is, many times over:
trial by trial with `settle_all`, critical scenes and the wait of PASS included. What scores look
like is taken from `stats.power`: scenes keep their difficulty, and a worse policy has the odds
of the next waypoint, in all scenes, multiplied by one factor. Nothing ties the candidate's trial to
the baseline's from the same start, which is how it was measured to be once a policy really changes,
and which makes no verdict easier. A repetition keeps its luck whatever the drop is: its order of
scenes and starts, and how lucky each trial is. So a larger drop fares worse in every repetition,
and a curve over drops is smooth. Between the margins either verdict is legitimate, so that what a
gate is worth stands in no single number, but in this curve.

**Further trials of a run that was not decided.** How good the candidate really is remains unknown:
its chances are drawn anew for each simulated end, from what they may be after its own trials and
the baseline's (`chances_beside`). So "about N more trials" is no number but a spread, from runs
that the next trial ends to those that no number of trials does. It is right for candidates that
look alike: one that lies midway between the margins takes longer, and its trials do not show it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import accumulate
from typing import Literal, get_args

import numpy as np

from nw_gate.stats.baseline.baseline_bets import make_bets
from nw_gate.stats.baseline.evidence import Floats, Margins, Places, Reference, Truths
from nw_gate.stats.baseline.trials import DrawnTrials, TrialDecision, TrialRules, settle_all
from nw_gate.stats.power import SceneCounts, chances_at, chances_beside, seeded

ComparisonKind = Literal["fresh", "panel", "control"]
"""What a gate speaks of, and what it compares with. fresh: fresh starts, M is infinite; panel: the
baseline's own starts alone; control: the baseline's policy, run beside the candidate."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Repetitions before anybody is judged: T trials each, in the order drawn."""

    reference: Reference
    """Of each, means of shape (repetitions, S); of a control, which has none, shape (S,)."""
    scenes: Places
    """Shape (repetitions, T)."""
    baseline: Floats
    """b of the same starts, shape (repetitions, T)."""
    luck: Floats
    """A trial reaches its i-th waypoint where this is below p^i, shape (repetitions, T)."""
    waypoints: Places
    """k, shape (S,)."""

    def all_or_nothing(self, means: Floats) -> DrawnTrials:
        """Return the trials of a policy that completes the course, or scores 0.

        Args:
            means: success in each scene, shape (S,).
        """
        candidate = (self.luck < means[self.scenes]).astype(np.float64)
        return DrawnTrials(scenes=self.scenes, candidate=candidate, baseline=self.baseline)

    def trials(self, chances: Floats) -> DrawnTrials:
        """Return the trials of a policy of these chances.

        Args:
            chances: p, shape (S,), or (repetitions, S) for a policy of each.
        """
        candidate = scores_of(self.luck, chances, self.scenes, self.waypoints)
        return DrawnTrials(scenes=self.scenes, candidate=candidate, baseline=self.baseline)


def draw(
    seen: Sequence[SceneCounts],
    *,
    starts: int | None,
    budget: int,
    repetitions: int,
    against: ComparisonKind = "fresh",
    margins: Margins | None = None,
) -> Drawn:
    """Return repetitions of a gate against a baseline, the same ones for the same counts.

    Args:
        seen: the baseline's trials; without `starts` they are the baseline itself, all of it.
        starts: M of the baselines to be drawn, each anew, from what was seen of the baseline.
        budget: T, how many trials to draw; at most S x M.
        repetitions: how many.
        against: what the gate compares with.
        margins: for which bets are made from each baseline, as a gate does; without them none are.

    Raises:
        ValueError: scenes have unequal numbers of starts, or there are fewer than are to be drawn.
    """
    rng, waypoints = seeded(seen), np.array([len(course.counts) - 1 for course in seen])
    known = {course.trials for course in seen}
    if starts is None and len(known) > 1:
        raise ValueError(
            f"scenes with {min(known)} to {max(known)} initial states are not a baseline"
        )
    size = known.pop() if starts is None else starts
    pairs = size * len(seen)
    if budget > pairs:
        raise ValueError(f"{budget} trials of {len(seen)} scenes with {size} initial states each")
    order = np.array([rng.choice(pairs, budget, replace=False) for _ in range(repetitions)])
    scenes = order // size
    if starts is None:
        panel = np.array([np.repeat(course.values, course.counts) for course in seen])
        means = np.broadcast_to(panel.mean(axis=-1), (repetitions, len(seen)))
        baseline = panel.ravel()[order]
    else:
        chances, every = chances_of(seen, success_of(seen)), np.arange(pairs) // size
        panels = scores_of(rng.random((repetitions, pairs)), chances, every, waypoints)
        panel = panels.reshape(repetitions, len(seen), size)
        means = panel.mean(axis=-1)
        baseline = np.take_along_axis(panels, order, axis=-1)
    reference = Reference(means=means, starts=size)
    if margins is not None and against != "control":
        most = max(course.trials for course in seen)
        shown = [np.resize(np.repeat(each.values, each.counts), most) for each in seen]
        # Those of each drawn baseline would be almost the same, and take half a minute.
        bets = make_bets(
            np.array(shown), waypoints, max_drop=margins.max_drop, tolerate=margins.tolerate
        )
        reference = replace(reference, bets=bets.against(panel))
    if against != "panel":
        reference = Reference.control(len(seen)) if against == "control" else reference.fresh()
    return Drawn(
        reference=reference,
        scenes=scenes,
        baseline=baseline,
        luck=rng.random((repetitions, budget)),
        waypoints=waypoints,
    )


def success_of(seen: Sequence[SceneCounts]) -> float:
    """Return mean success, scenes weighted equally."""
    return float(np.mean([course.counts @ course.values / course.trials for course in seen]))


def chances_of(seen: Sequence[SceneCounts], mean: float) -> Floats:
    """Return the chances of a policy with this true success, shape (S,); 1 is one that never fails.

    Raises:
        ValueError: the mean is not above 0.
    """
    return np.ones(len(seen)) if mean >= 1.0 else chances_at(list(seen), mean)


def scores_of(luck: Floats, chances: Floats, scenes: Places, waypoints: Places) -> Floats:
    """Return success of trials with this luck, of the shape of luck.

    Args:
        luck: from 0 to 1, shape (..., T).
        chances: p, shape (S,), or (..., S).
        scenes: of the trials, shape (..., T) or (T,).
        waypoints: k, shape (S,).
    """
    p = chances[scenes] if chances.ndim == 1 else np.take_along_axis(chances, scenes, axis=-1)
    k = waypoints[scenes]
    reached, power = np.zeros(luck.shape), np.ones_like(p)
    for number in range(1, int(waypoints.max()) + 1):
        power = power * p
        reached += (luck < power) & (number <= k)
    return reached / k


DROPS = (0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.1, 0.12, 0.15, 0.2, 0.25, 0.3)
"""Of the curve: closer where the verdict turns."""

REPETITIONS = 1000
"""The standard error of a share is at most 1.6 %."""


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """Shares of simulated gates of policies whose true success is `drop` below the baseline's."""

    drop: float
    passed: float
    regressed: float
    trials: float
    """Mean number that were judged, of the candidate alone where a control runs beside it."""

    @property
    def undecided(self) -> float:
        """Share that the budget left open."""
        return max(0.0, 1.0 - self.passed - self.regressed)


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Shares of simulated gates that have ended after 1, 2, ... trials were judged."""

    passed: tuple[float, ...]
    regressed: tuple[float, ...]

    @property
    def settled(self) -> tuple[float, ...]:
        """Of either verdict."""
        return tuple(a + b for a, b in zip(self.passed, self.regressed, strict=True))


def trials_for(shares: Sequence[float], share: float) -> int | None:
    """Return after how many trials a share of a `Progress` is first reached; None if it never is.

    Args:
        shares: after 1, 2, ... trials.
        share: to reach, from 0 to 1.
    """
    return next((number for number, each in enumerate(shares, 1) if each >= share), None)


Kind = Literal["every waypoint harder", "all or nothing"]
"""How a worse policy fails: more often at every waypoint, or before the first one, never later."""
KINDS: tuple[Kind, ...] = get_args(Kind)


def operating_curve(
    seen: Sequence[SceneCounts],
    rules: TrialRules,
    *,
    budget: int,
    starts: int | None = None,
    drops: Sequence[float] = DROPS,
    repetitions: int = REPETITIONS,
    against: ComparisonKind = "fresh",
    kind: Kind = "every waypoint harder",
) -> tuple[CurvePoint, ...]:
    """Return how a gate ends at each drop that the baseline is high enough for.

    Args:
        seen: the baseline's trials, waypoints reached in each scene. Without `starts` they are the
            baseline itself, with as many in each scene.
        rules: the gate's.
        budget: most trials, no more than the baseline has pairs of a scene and a start.
        starts: M of a baseline that is not there yet. Baselines are then drawn, one a repetition,
            from what was seen, as if the success that was seen were the true one.
        drops: of true success, scenes weighted equally.
        repetitions: simulated gates at each drop.
        against: what the gate compares with.
        kind: how worse policies fail.

    Raises:
        ValueError: scenes have unequal numbers of starts, or fewer than the budget needs.
    """
    drawn = draw(
        seen,
        starts=starts,
        budget=budget,
        repetitions=repetitions,
        against=against,
        margins=rules.margins,
    )
    mean, points = success_of(seen), list[CurvePoint]()
    for drop in drops:
        if mean - drop > 0.0:
            decisions = settle_all(drawn.reference, _of_kind(kind, drawn, seen, mean - drop), rules)
            words = [decision.word for decision in decisions]
            points.append(
                CurvePoint(
                    drop=drop,
                    passed=words.count("PASS") / len(words),
                    regressed=words.count("REGRESSED") / len(words),
                    trials=float(np.mean([decision.trials for decision in decisions])),
                )
            )
    return tuple(points)


def _of_kind(kind: Kind, drawn: Drawn, seen: Sequence[SceneCounts], mean: float) -> DrawnTrials:
    """Return the trials of a policy of this mean success that fails in one way."""
    if kind == "all or nothing":
        means = np.array([course.counts @ course.values / course.trials for course in seen])
        return drawn.all_or_nothing(means * (mean / means.mean()))
    return drawn.trials(chances_of(seen, mean))


def progress_at(
    seen: Sequence[SceneCounts],
    rules: TrialRules,
    drop: float,
    *,
    starts: int | None = None,
    repetitions: int = REPETITIONS,
    against: ComparisonKind = "fresh",
) -> Progress:
    """Return how gates of a policy of this drop end if all starts of the baseline may be run.

    Args:
        seen: as for `operating_curve`.
        rules: the gate's.
        drop: below the baseline's success.
        starts: as for `operating_curve`.
        repetitions: simulated gates.
        against: what the gate compares with.

    Raises:
        ValueError: scenes have unequal numbers of starts, or no policy can drop by so much.
    """
    budget = len(seen) * (seen[0].trials if starts is None else starts)
    chances = chances_of(seen, success_of(seen) - drop)
    drawn = draw(
        seen,
        starts=starts,
        budget=budget,
        repetitions=repetitions,
        against=against,
        margins=rules.margins,
    )
    decisions = settle_all(drawn.reference, drawn.trials(chances), rules)
    return _progress_of(decisions, [decision.trials for decision in decisions], budget)


def _progress_of(decisions: Sequence[TrialDecision], trials: Sequence[int], most: int) -> Progress:
    """Return the shares that have ended after each trial.

    Args:
        decisions: of the repetitions.
        trials: after how many, 1 to `most`, each was judged; not looked at where it is undecided.
        most: how many to tell of.
    """

    def shares(word: str) -> tuple[float, ...]:
        after = [
            count
            for decision, count in zip(decisions, trials, strict=True)
            if decision.word == word
        ]
        ended = np.bincount(after, minlength=most + 1)[1:]
        return tuple(count / len(decisions) for count in accumulate(ended.tolist()))

    return Progress(passed=shares("PASS"), regressed=shares("REGRESSED"))


def progress_from(
    reference: Reference,
    trials: DrawnTrials,
    rules: TrialRules,
    *,
    known: Sequence[bool] | Truths,
    seen: Sequence[SceneCounts],
    repetitions: int = REPETITIONS,
) -> Progress:
    """Return the shares in which each further trial would have ended a run, as it looks so far.

    Simulated with the committed baseline of hurdles, gates that 320 trials left open, true drops of
    .03 to .10 by two kinds of failure, pooled: 57 % were decided by the trials after which half of
    the simulated ends are, and 89 % by those of nine tenths; after 64 trials 49 and 85 %. Of a true
    drop of .06 alone 50 and 84 %, after 64 trials 28 and 72 %; of .10 94 and 100 %, 68 and 95 %.

    Args:
        reference: a baseline or `Reference.control`, without leading axes.
        trials: all that may still come, in the order drawn, shape (T,), those that have ended among
            them. Of the others the candidate's success, and a control's, is not looked at; NaN
            where a trial that has ended has no result.
        rules: the gate's.
        known: which have ended, shape (T,).
        seen: the baseline's trials in each scene.
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
    rng = _seeded_by(trials, ended)
    shape = (repetitions, len(ended))
    k = np.array([len(course.counts) - 1 for course in seen], dtype=np.intp)
    scenes = np.broadcast_to(trials.scenes, shape)

    def simulated(scores: Floats) -> Floats:
        """Return scores, those to come drawn by what the ended ones say, (repetitions, T)."""
        met = _counts(scores[ended], trials.scenes[ended], k)
        chances = chances_beside(met, seen, repetitions, rng)
        drawn = scores_of(rng.random(shape), chances, scenes, k)
        return np.where(ended, scores, drawn)

    candidate = simulated(trials.candidate)
    baseline = simulated(trials.baseline) if reference.paired else trials.baseline
    ends = settle_all(
        reference,
        DrawnTrials(scenes=scenes, candidate=candidate, baseline=np.broadcast_to(baseline, shape)),
        rules,
    )
    first = np.concatenate([[0], np.cumsum(~ended)])  # To come among the first 0, 1, ... places.
    after = [int(first[end.mean]) + sum(not ended[place] for place in end.followed) for end in ends]
    # Whatever is settled already is so after the next trial.
    return _progress_of(ends, np.maximum(after, 1).tolist(), more)


def _seeded_by(trials: DrawnTrials, ended: Truths) -> np.random.Generator:
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
