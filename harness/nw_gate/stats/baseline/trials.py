"""The gate trial by trial: evidence after each of them, and what it settles.

All S x M pairs of a scene and a start are drawn as one random sample without replacement
(`order_of_trials`), and the gate looks after each trial, in that order. The nulls and the numbers y
are those of `evidence`; here one box has all the pairs' numbers, z is centred by scene already, and
each null is bet against by `along`. A scene's own bets are settled when a trial of it is.

**The rule.** REGRESSED once E_regr >= 1 / alpha_regr, or once a critical scene is named: E_s >=
S / alpha_regr. It comes first where one trial does both. Once E_pass >= 1 / alpha_pass the drop of
the mean is below max_drop significantly, and stays so: by Ville's inequality a null may be rejected
for good at the first look that refutes it. Then only scenes can be left to settle. PASS waits for
those that are suspect (E_s >= SUSPECT and not named) and for critical ones that have had fewer than
CRITICAL_TRIALS trials. From there on the order is gone through for trials of these scenes alone:
how many trials a scene has may depend on anything that is known, so that E_s stays valid, and the
evidence on the mean takes no part. Waiting makes PASS rarer, and no other error more frequent.

By Ville's inequality a drop of max_drop or more passes with probability at most alpha_pass. One of
at most `tolerate` is flagged by the mean with at most alpha_regr. If no scene dropped by more
than scene_drop, any is named with at most alpha_regr besides: the S scenes share that error.

**The same trials whatever the number of workers.** Which trials are judged follows from the order
and from the results of those before. Workers may run ahead in the order (`TrialDecision.pending`);
what they find beyond the trial that settles it is not judged. So no batch has to be waited for, and
the number of trials that are judged is the least that there can be.

**Validity.** With M finite, `evidence` has the proof, for one box of S M numbers: the claim is of
these starts only. With M infinite the null's mean is not moved by what was drawn. Were scenes drawn
with replacement and starts afresh, that would be the case of M infinite there. Pairs are
drawn without replacement, which makes sums vary less: a product of 1 + k (y - n) / n over t draws
still has at most the expectation 1 (Maclaurin's inequality for elementary symmetric means;
Hoeffding, 1963, section 6, has it for all convex functions of a sum). That evidence *ever* reaches
1 / alpha is then bounded by no theorem here: it was enumerated for small seed sets and simulated on
real ones, and happens less often than alpha. A claim about fresh starts takes the baseline's means
for true. What a baseline errs in them was simulated: a policy exactly at `tolerate`, of whom 1 %
should be flagged, is in up to 2.5 % with 5 to 12 starts a scene, and in up to 1.8 % with 30 or more
(docs/concepts/power.md).

A randomised last look (U / alpha in place of 1 / alpha at the end of the budget, U uniform) would
be valid too. It turns 0 to 8 of 100 undecided gates into a verdict (simulated), and makes it wrong
to go on with more trials after it: it is not used.

Source: I. Waudby-Smith and A. Ramdas, arXiv 2006.04347; W. Hoeffding, "Probability inequalities for
sums of bounded random variables", JASA 58 (1963).

In which order starts are drawn from the baseline: in each scene, and of all scenes together.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from typing import Literal, NamedTuple

import numpy as np

from nw_base.words import Tier
from nw_gate.stats.baseline.evidence import (
    DOWN,
    UP,
    Floats,
    Margins,
    Places,
    Reference,
    Truths,
    along,
    capital,
    check_successes,
    nulls_at_least,
    nulls_at_most,
    scene_losses,
    scene_nulls,
)

SUSPECT = 4.0
"""E_s from which a scene may have fallen."""

CRITICAL_TRIALS = 4
"""Trials of each critical scene, at least, before a PASS. The mean of 64 scenes may pass before
half of them have been met: a critical one that always fails was then flagged in 24 %, and is with
this in all (simulated). Where nothing fell it takes 1 to 3 trials more for each critical scene."""

_Word = Literal["PASS", "REGRESSED", "undecided"]


@dataclass(frozen=True, kw_only=True)
class DrawnTrials:
    """Trials in the order in which they were drawn; leading axes are gates apart.

    Raises:
        ValueError: shapes differ, or a success is not between 0 and 1.
    """

    scenes: Places
    """Index of the scene among those of the baseline, shape (..., T)."""
    candidate: Floats
    """c, shape (..., T). NaN is a trial that has no result: it counts as 0 in E_pass and as 1 in
    E_regr and E_s, so that no verdict gains by what is missing."""
    baseline: Floats
    """b of the same starts, shape (..., T): from the baseline, or of a control. There NaN has no
    result either, and counts the other way round."""

    def __post_init__(self) -> None:
        shapes = {self.scenes.shape, self.candidate.shape, self.baseline.shape}
        if len(shapes) > 1:
            raise ValueError(f"trials of shapes {sorted(shapes)}")
        for values in (self.candidate, self.baseline):
            check_successes(values[~np.isnan(values)])

    def at(self, places: Sequence[int]) -> DrawnTrials:
        """Return the trials at some positions of the order, in their order."""
        which = np.array(places, dtype=np.intp)
        return DrawnTrials(
            scenes=self.scenes[..., which],
            candidate=self.candidate[..., which],
            baseline=self.baseline[..., which],
        )

    def only(self, which: Places, count: int) -> DrawnTrials:
        """Return the first trials of some of the gates, by their positions along the first axis."""
        cut = np.s_[which, :count]
        return DrawnTrials(
            scenes=self.scenes[cut], candidate=self.candidate[cut], baseline=self.baseline[cut]
        )

    def counted(self, missing: float) -> DrawnTrials:
        """Return the trials with this success of the candidate where it is missing.

        A control's is then 1 less it: what is missing speaks for the same side in both arms.
        """
        return replace(
            self,
            candidate=np.where(np.isnan(self.candidate), missing, self.candidate),
            baseline=np.where(np.isnan(self.baseline), 1.0 - missing, self.baseline),
        )


class Looks(NamedTuple):
    """E-values after each trial."""

    passed: Floats
    """E_pass, shape (..., T)."""
    regressed: Floats
    """E_regr, shape (..., T)."""
    own: Floats
    """E_s of the trial's own scene after it, shape (..., T)."""


@dataclass(frozen=True, kw_only=True)
class TrialRules:
    """By what a gate decides."""

    tiers: tuple[Tier, ...]
    """Of the scenes, shape (S,), none of them informational.

    Raises:
        ValueError: one is; or an alpha is not between 0 and 1.
    """
    margins: Margins = field(default_factory=Margins)
    alpha_pass: float = 0.05
    """Probability, at most, that a drop of max_drop or more passes."""
    alpha_regr: float = 0.01
    """Probability, at most, that a drop of `tolerate` or less is flagged by the mean; and, at
    most, that any scene is named where none dropped by more than scene_drop."""
    look_every: int = 1
    """Trials between two looks at the mean. Where trials come round by round, one of each scene in
    a fixed order of scenes, it is their number: E is an e-value after whole rounds alone."""

    def __post_init__(self) -> None:
        for alpha in (self.alpha_pass, self.alpha_regr):
            if not 0.0 < alpha < 1.0:
                raise ValueError(f"alpha {alpha} is not between 0 and 1; write 0.05 for 5 %")
        if "informational" in self.tiers:
            place = self.tiers.index("informational")
            raise ValueError(f"scene {place} is informational and not judged")

    @property
    def critical(self) -> frozenset[int]:
        """Scenes that are judged alone too, by index."""
        return frozenset(index for index, tier in enumerate(self.tiers) if tier == "critical")

    @property
    def names_at(self) -> float:
        """E_s from which a scene is named."""
        return len(self.tiers) / self.alpha_regr


@dataclass(frozen=True, kw_only=True)
class TrialDecision:
    """What was found in a gate, and by which trials."""

    word: _Word
    mean: int
    """How many trials, from the first in the order, the evidence on the mean rests on."""
    followed: tuple[int, ...]
    """Trials after those, by index in the order, that were judged for their scenes alone."""
    named: tuple[int, ...]
    """Scenes that regressed, whatever the word, by index."""
    waits_for: tuple[int, ...]
    """Scenes that alone hold back a PASS that the mean allows."""
    pending: tuple[int, ...]
    """Trials that come next if none of them settles it, by index in the order, those that have
    ended already among them; none once it is settled or the budget is spent. W workers run those of
    the first W that have not ended: further ahead more would be run for nothing."""

    @property
    def trials(self) -> int:
        """How many were judged."""
        return self.mean + len(self.followed)


def looks(reference: Reference, trials: DrawnTrials, margins: Margins) -> Looks:
    """Return the evidence after each trial.

    A baseline that scores less than max_drop in every scene cannot be undercut by so much: E_pass
    is infinite from the first trial on, and says nothing of the candidate.

    Args:
        reference: a baseline or `Reference.control`; its means have the leading axes of the
            trials.
        trials: in the order drawn, shape (..., T).
        margins: drops that the nulls allow.

    Raises:
        ValueError: there are more trials than pairs of a scene and a start.
    """
    _check_baseline(reference, trials)
    means = np.broadcast_to(reference.means, (*trials.scenes.shape[:-1], reference.means.shape[-1]))
    worst, best = trials.counted(0.0), trials.counted(1.0)
    losses = scene_losses(reference, best.candidate, best.baseline)
    floors = np.broadcast_to(scene_nulls(reference, margins), means.shape)
    return Looks(
        passed=capital(
            reference, above_at(reference, worst), nulls_at_least(reference, margins.max_drop), UP
        ),
        regressed=capital(
            reference, below_at(reference, best), nulls_at_most(reference, margins.tolerate), DOWN
        ),
        own=_own(trials.scenes, losses, floors, reference.starts),
    )


def settle(
    reference: Reference,
    trials: DrawnTrials,
    rules: TrialRules,
    known: Sequence[bool] | Truths | None = None,
) -> TrialDecision:
    """Return what the trials that are known so far settle.

    Args:
        reference: a baseline or `Reference.control`, without leading axes.
        trials: all of the budget in the order drawn, shape (T,).
        rules: the gate's.
        known: which of them have ended, shape (T,), with a result or without any; all if None. Of
            one that has not nothing is looked at, nor of any that comes after it and would only be
            judged if it settled nothing.

    Raises:
        ValueError: the tiers are not those of the baseline; or as `looks`.
    """
    _check(reference, rules)
    budget = len(trials.scenes)
    ended = np.ones(budget, dtype=bool) if known is None else np.array(known, dtype=bool)
    count = budget if ended.all() else int(ended.argmin())
    every = looks(
        reference,
        replace(trials, candidate=np.where(ended, trials.candidate, np.nan)),
        rules.margins,
    )
    return _rule(trials.scenes, every, count, ended, rules)


def _rule(
    scenes: Places, every: Looks, count: int, ended: Truths, rules: TrialRules
) -> TrialDecision:
    """Return the decision on one gate.

    Args:
        scenes: of all trials of the budget, shape (T,).
        every: evidence after each, shape (T,); where it has not ended, or one before it that would
            be judged, nothing is looked at.
        count: trials that have ended before the first that has not.
        ended: which have, shape (T,).
        rules: the gate's.
    """
    flagging, passing = _reached(scenes[:count], every, rules)
    flags, passes = _first(flagging), _first(passing)
    mean = min(count, flags + 1, passes + 1)
    rule_scenes = _Scenes(scenes[:mean], every.own[:mean], rules)
    word: _Word = "undecided"
    followed, pending = list[int](), list[int]()
    if flags < mean:
        word = "REGRESSED"
    elif passes < mean:
        followed, pending = rule_scenes.follow(scenes, every.own, ended, mean)
        word = "REGRESSED" if rule_scenes.flagged else "undecided" if rule_scenes.waits else "PASS"
    else:
        pending = list(range(count, len(scenes)))
    return TrialDecision(
        word=word,
        mean=mean,
        followed=tuple(followed),
        named=tuple(sorted(rule_scenes.named)),
        waits_for=tuple(sorted(rule_scenes.waits)) if word == "undecided" else (),
        pending=tuple(pending),
    )


def _reached(scenes: Places, every: Looks, rules: TrialRules) -> tuple[Truths, Truths]:
    """Return where evidence flags, and where that on the mean passes; of the shape of scenes."""
    count = scenes.shape[-1]
    looked = np.arange(1, count + 1) % rules.look_every == 0
    flags = looked & (every.regressed[..., :count] >= 1.0 / rules.alpha_regr)
    if critical := rules.critical:
        alone = every.own[..., :count] >= rules.names_at
        flags |= alone & np.isin(scenes, list(critical))
    return flags, looked & (every.passed[..., :count] >= 1.0 / rules.alpha_pass)


class _Scenes:
    """What is known of single scenes, trial after trial.

    Args:
        scenes: of the trials so far, in order, shape (T,).
        own: E_s after each, shape (T,).
        rules: the gate's.
    """

    def __init__(self, scenes: Places, own: Floats, rules: TrialRules) -> None:
        self._critical, self._names_at = rules.critical, rules.names_at
        self._met = np.bincount(scenes, minlength=len(rules.tiers))
        self._own = np.ones(len(rules.tiers))
        self._own[scenes] = own  # Of a scene that is met again the last one stays.
        self.named = set[int](scenes[own >= self._names_at].tolist())
        self.waits = set[int]()
        """Scenes that hold back a PASS, once it is asked for."""

    @property
    def flagged(self) -> bool:
        """Whether a critical scene is named."""
        return not self.named.isdisjoint(self._critical)

    def follow(
        self, scenes: Places, own: Floats, ended: Truths, begin: int
    ) -> tuple[list[int], list[int]]:
        """Judge trials from index `begin` on for the scenes that hold back a PASS.

        Returns:
            Those that were judged; and those that come next, if it ends for want of one.
        """
        self.waits = {scene for scene in range(len(self._met)) if self._is_waited_for(scene)}
        followed = list[int]()
        for index in range(begin, len(scenes)):
            scene = int(scenes[index])
            if self.flagged or not self.waits:
                break
            if scene not in self.waits:
                continue
            if not ended[index]:
                rest = np.isin(scenes[index:], list(self.waits))
                return followed, (index + np.flatnonzero(rest)).tolist()
            followed.append(index)
            self._met[scene] += 1
            self._own[scene] = own[index]
            if own[index] >= self._names_at:
                self.named.add(scene)
            if not self._is_waited_for(scene):
                self.waits.discard(scene)
        return followed, []

    def _is_waited_for(self, scene: int) -> bool:
        if scene in self.named:
            return False
        few = scene in self._critical and self._met[scene] < CRITICAL_TRIALS
        return bool(few or self._own[scene] >= SUSPECT)


def settle_all(reference: Reference, trials: DrawnTrials, rules: TrialRules) -> list[TrialDecision]:
    """Return how gates end of which every trial is known: `settle` of each, and much faster.

    Args:
        reference: means of shape (S,), or (gates, S) for a baseline of each.
        trials: shape (gates, T).
        rules: of all gates.
    """
    _check(reference, rules)
    gates, budget = trials.scenes.shape
    whole = replace(
        reference, means=np.broadcast_to(reference.means, (gates, reference.means.shape[-1]))
    )
    decisions: dict[int, TrialDecision] = {}
    going, count = np.arange(gates), min(64, budget)
    while going.size:
        cut = trials.only(going, count)
        every = looks(whole.only(going), cut, rules.margins)
        flags, passes = _reached(cut.scenes, every, rules)
        reached = set(np.flatnonzero((flags | passes).any(axis=-1)).tolist())
        for row, gate in enumerate(going.tolist()):
            if row not in reached and count < budget:
                continue
            one = Looks(every.passed[row], every.regressed[row], every.own[row])
            decision = _rule(cut.scenes[row], one, count, np.ones(count, dtype=bool), rules)
            if count == budget or decision.word != "undecided":
                decisions[gate] = decision
        going = np.array([gate for gate in going.tolist() if gate not in decisions], dtype=np.intp)
        count = min(2 * count, budget)
    return [decisions[gate] for gate in range(gates)]


def most_false_alarms(
    *,
    bar: float | None,
    bar_critical: bool,
    baseline: float | None,
    critical: int,
    scenes: int,
) -> float:
    """Return how often a gate flags wrongly at most: the sum of what its parts do.

    A policy is flagged wrongly if it is above the bar, in every critical scene too, dropped by
    `tolerate` at most, and in no critical scene by more than scene_drop. By Boole's inequality the
    parts together err with the sum of their probabilities at most.

    Args:
        bar: 1 - confidence of the absolute bar, None without one.
        bar_critical: whether critical scenes are judged alone by it, which share another of these.
        baseline: alpha_regr of the gate against a baseline, None without one.
        critical: scenes of it that flag alone. Each is named wrongly with alpha_regr / S.
        scenes: S.

    Raises:
        ValueError: there are more critical scenes than scenes.
    """
    if not 0 <= critical <= scenes:
        raise ValueError(f"{critical} critical scenes of {scenes}")
    by_bar = 0.0 if bar is None else bar * (2 if bar_critical else 1)
    by_baseline = 0.0 if baseline is None else baseline * (1 + critical / max(scenes, 1))
    return min(1.0, by_bar + by_baseline)


def above_at(reference: Reference, trials: DrawnTrials) -> list[Floats]:
    """Return y of each trial for each beta and account, shape (..., T): what PASS is won by."""
    own = [_centred(reference, trials, beta) - reference.least(beta) for beta in reference.betas]
    if reference.bets is None:
        return own
    given = (trials.scenes, trials.baseline, trials.candidate)
    return [*own, *(reference.bets.values(account, *given) for account in reference.bets.above)]


def below_at(reference: Reference, trials: DrawnTrials) -> list[Floats]:
    """Return y of each trial as `above_at` does: what REGRESSED is won by."""
    own = [reference.most(beta) - _centred(reference, trials, beta) for beta in reference.betas]
    if reference.bets is None:
        return own
    given = (trials.scenes, trials.baseline, 1.0 - trials.candidate)
    return [*own, *(reference.bets.values(account, *given) for account in reference.bets.below)]


def _centred(reference: Reference, trials: DrawnTrials, beta: float) -> Floats:
    """Return z of `evidence`, shape (..., T)."""
    if reference.means.ndim == 1:
        means = reference.means[trials.scenes]
    else:
        means = np.take_along_axis(reference.means, trials.scenes, axis=-1)
    known = means + beta * (trials.baseline - means)
    return trials.candidate - known + reference.mean


def _own(scenes: Places, losses: Floats, nulls: Floats, starts: float) -> Floats:
    """Return E_s of each trial's scene after it, shape (..., T).

    Args:
        scenes: shape (..., T).
        losses: y of the scene's own bets, shape (..., T).
        nulls: n of each scene, shape (..., S).
        starts: M.
    """
    shape, count = scenes.shape, scenes.shape[-1]
    flat = scenes.reshape(-1, count)
    values, null = losses.reshape(-1, count), nulls.reshape(-1, nulls.shape[-1])
    order = np.argsort(flat, axis=-1, kind="stable")
    sorted_scenes = np.take_along_axis(flat, order, axis=-1)
    begins = np.ones(flat.shape, dtype=bool)
    begins[:, 1:] = sorted_scenes[:, 1:] != sorted_scenes[:, :-1]
    places = np.arange(count)
    visits = places - np.maximum.accumulate(np.where(begins, places, 0), axis=-1)
    rows = np.arange(len(flat))[:, None]
    table = np.zeros((*null.shape, int(visits.max(initial=0)) + 1))
    table[rows, sorted_scenes, visits] = np.take_along_axis(values, order, axis=-1)
    evidence = along(table, null, starts, DOWN)
    own_evidence = np.empty(flat.shape)
    np.put_along_axis(own_evidence, order, evidence[rows, sorted_scenes, visits], axis=-1)
    return own_evidence.reshape(shape)


def _first(holds: Truths) -> int:
    """Return where something holds first; the length if nowhere."""
    return int(holds.argmax()) if holds.any() else len(holds)


def _check(reference: Reference, rules: TrialRules) -> None:
    if len(rules.tiers) != reference.means.shape[-1]:
        raise ValueError(f"{len(rules.tiers)} tiers for {reference.means.shape[-1]} scenes")


def _check_baseline(reference: Reference, trials: DrawnTrials) -> None:
    if not reference.paired and np.isnan(trials.baseline).any():
        raise ValueError("a baseline has a result from every start; one is missing")


def order_of_starts(
    starts: int, *, candidate_digest: str, suite_digest: str, scene: str
) -> list[int]:
    """Return the indexes 0 .. M - 1 in the order in which they are to be drawn.

    The order is random as far as scores go: it follows sha256 of who is judged by what, so that it
    is the same on every machine and in every run, differs between scenes and between candidates,
    and cannot be chosen after the trials have been seen. A baseline with more starts keeps the
    order of those that it had.

    Args:
        starts: M.
        candidate_digest: of the policy that is judged.
        suite_digest: of the suite.
        scene: its name.
    """
    ranks = _ranks(starts, json.dumps([candidate_digest, suite_digest, scene]))
    return sorted(range(starts), key=ranks.__getitem__)


def order_of_trials(
    scenes: Sequence[str], starts: int, *, candidate_digest: str, suite_digest: str
) -> list[tuple[int, int]]:
    """Return all S x M pairs of a scene and a start of it in the order in which they are drawn.

    They are one simple random sample without replacement, as far as scores go: whoever has the
    smaller sha256 comes first, whatever its scene. Within a scene the starts come as in
    `order_of_starts`. Scenes that are left out, or starts that are added to a baseline, do not
    change the order of the others.

    Args:
        scenes: their names, shape (S,), each once.
        starts: M.
        candidate_digest: of the policy that is judged.
        suite_digest: of the suite.

    Returns:
        Pairs of the index of a scene among `scenes` and the index of a start, shape (S M, 2).
    """
    drawn = [
        (rank, place, start)
        for place, scene in enumerate(scenes)
        for start, rank in enumerate(
            _ranks(starts, json.dumps([candidate_digest, suite_digest, scene]))
        )
    ]
    return [(place, start) for _, place, start in sorted(drawn)]


@lru_cache(maxsize=4096)  # Who plans a run, who judges it and who words it ask for the same.
def _ranks(starts: int, drawn_by: str) -> tuple[bytes, ...]:
    """Return for 0 .. M - 1 the sha256 of the JSON list of what draws them, and the start."""
    beginning = sha256(drawn_by.removesuffix("]").encode())

    def rank(start: int) -> bytes:
        one = beginning.copy()
        one.update(f", {start}]".encode())
        return one.digest()

    return tuple(map(rank, range(starts)))
