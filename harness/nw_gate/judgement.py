"""Whether a policy is worse than a baseline, from the episodes of any simulator.

Episodes of the two are paired: by their start where both name it, else by their order in a task,
which is right for episodes that are drawn alike. A pair (c, b) of scores is one number, x =
(1 + c - b) / 2, within [0, 1], whose mean over tasks is (1 - drop) / 2. Against "the drop is at
least `max_drop`" and against "the drop is at most `tolerate`" bets the capital of
`nw_gate.stats.betting`, after each round: one more pair in every task. Whichever claim is refuted
first decides: PASS, or REGRESSED. A PASS is wrong with probability 1 - `confidence` at most, a
REGRESSED with `false_alarm` at most, however many rounds there are and whenever one looks (Ville's
inequality), so an evaluation may stop at the round that `Judgement.decided_after` names. What a
task has beyond the shortest one is not compared. A critical task adds its own `false_alarm` to that
of REGRESSED, and a bar is judged at `confidence` on both sides.

Source: I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by betting",
JRSS B 86 (2024); for tasks of unequal means see `nw_gate.stats.betting`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import IncomparableError, UsageError
from nw_base.plural import plural
from nw_gate.episodes import Evaluation
from nw_gate.stats.betting import (
    evidence_above,
    log_bets,
    log_mixture,
    lower_bound,
    upper_bound,
)
from nw_gate.stats.interval import Interval, check_confidence

Values = NDArray[np.float64]
GateWord = Literal["PASS", "REGRESSED", "INCONCLUSIVE"]
Scored = tuple[str | None, float]
"""An episode's start and score."""


@dataclass(frozen=True, kw_only=True)
class JudgeSettings:
    """What must be shown.

    Attributes:
        max_drop: drop of the mean score, over tasks, that PASS rules out.
        tolerate: drop that counts as equal; REGRESSED needs a larger one to be shown.
        task_drop: drop in one task beyond which it is named.
        critical: names or globs of tasks of which each alone, where it fell, makes the verdict
            REGRESSED.
        bar: the mean score that must be reached by itself; None = none.
        confidence: that a PASS is right.
        false_alarm: largest probability of a wrong REGRESSED.

    Raises:
        UsageError: they do not fit one another.
    """

    max_drop: float = 0.10
    tolerate: float = 0.02
    task_drop: float = 0.10
    critical: tuple[str, ...] = ()
    bar: float | None = None
    confidence: float = 0.95
    false_alarm: float = 0.01

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerate <= self.max_drop < 1.0 or self.max_drop == 0.0:
            raise UsageError(
                f"tolerate {self.tolerate:g} and max_drop {self.max_drop:g} do not fit",
                fix="give 0 <= tolerate <= max_drop < 1, and a max_drop over 0",
            )
        if not 0.0 <= self.task_drop < 1.0:
            raise UsageError(f"task_drop {self.task_drop:g} is not from 0 to 1")
        if self.bar is not None and not 0.0 < self.bar < 1.0:
            raise UsageError(f"bar {self.bar:g} is not between 0 and 1")
        if not (0.5 <= self.confidence < 1.0 and 0.0 < self.false_alarm <= 0.5):
            raise UsageError(
                f"confidence {self.confidence:g} and false_alarm {self.false_alarm:g} do not fit",
                fix="give a confidence from 0.5 to 1 and a false_alarm from 0 to 0.5",
            )


@dataclass(frozen=True, kw_only=True)
class TaskFigures:
    """One task.

    Attributes:
        task: its name.
        candidate: mean score of the candidate's episodes that are compared.
        baseline: the same of the baseline; None without one.
        pairs: how many are compared.
        fell: whether the drop is shown to be over `task_drop`, all tasks together considered.
    """

    task: str
    candidate: float
    baseline: float | None
    pairs: int
    fell: bool = False


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What two evaluations show.

    Attributes:
        word: PASS, REGRESSED or INCONCLUSIVE.
        reasons: why, a sentence each.
        candidate: mean score over tasks.
        baseline: the same of the baseline; None without one.
        drop: of the mean, with the interval that holds at every round; None without a baseline.
        interval: from what `false_alarm` excludes below to what `confidence` excludes above.
        paired_by: whether starts or the order paired episodes.
        tasks: in alphabetical order.
        rounds: pairs in the task that has fewest.
        decided_after: round at which the verdict was settled; None where it is not, or the bar
            decided.
        missing: episodes without a score.
    """

    word: GateWord
    reasons: tuple[str, ...]
    candidate: float
    baseline: float | None
    drop: float | None
    interval: Interval | None
    paired_by: Literal["start", "order"] | None
    tasks: tuple[TaskFigures, ...]
    rounds: int
    decided_after: int | None
    missing: int

    @property
    def exit_code(self) -> int:
        """0 PASS, 1 REGRESSED, 3 INCONCLUSIVE; as of `nw-eval run`."""
        from nw_gate.verdict import EXIT_CODES  # With pydantic, which nothing else here needs.

        return EXIT_CODES[self.word]


def judge(
    new: Evaluation, baseline: Evaluation | None = None, limits: JudgeSettings | None = None
) -> Judgement:
    """Judge a candidate's episodes, by a baseline's, by a bar, or both.

        judge(read_evaluation("new.parquet"), read_evaluation("old.parquet")).word
        'PASS'

    Args:
        new: of the candidate.
        baseline: of what it is compared with, in the same tasks.
        limits: what must be shown.

    Raises:
        UsageError: there is neither a baseline nor a bar.
        IncomparableError: the two have no task in common, or not the same ones.
    """
    limits = limits or JudgeSettings()
    check_confidence(limits.confidence)
    if baseline is None and limits.bar is None:
        raise UsageError("there is nothing to judge by", fix="name a baseline or a bar")
    ours, absent = _by_task(new)
    reasons: list[tuple[GateWord | None, str]] = []
    decided: int | None = None
    drop: float | None = None
    interval: Interval | None = None
    paired_by: Literal["start", "order"] | None = None
    means: dict[str, tuple[float, float | None, int, bool]] = {
        task: (float(np.mean([score for _, score in group])), None, len(group), False)
        for task, group in ours.items()
    }
    if baseline is not None:
        theirs, absent_there = _by_task(baseline)
        absent += absent_there
        if ours.keys() != theirs.keys():
            raise IncomparableError(_unlike(new, baseline, ours, theirs))
        pairs, paired_by = _paired(ours, theirs)
        groups = [(1.0 + pair[:, 0] - pair[:, 1]) / 2.0 for pair in pairs.values()]
        drop = 1.0 - 2.0 * float(np.mean([group.mean() for group in groups]))
        interval = Interval(
            1.0 - 2.0 * upper_bound(groups, 1.0 - limits.false_alarm),
            1.0 - 2.0 * lower_bound(groups, limits.confidence),
        )
        word, decided = _rounds(groups, limits)
        is_odd = (word == "PASS" and drop >= limits.max_drop) or (
            word == "REGRESSED" and drop <= limits.tolerate
        )
        if is_odd:
            why = _order_words(word, drop, limits, decided)
            word, decided = "INCONCLUSIVE", None
        else:
            why = _drop_words(word, drop, interval, limits)
        reasons.append((word, why))
        each = limits.false_alarm / len(groups)
        for (task, pair), group in zip(pairs.items(), groups, strict=True):
            fell = evidence_above([1.0 - group], (1.0 + limits.task_drop) / 2.0) >= 1.0 / each
            candidate, other = map(float, pair.mean(axis=0))
            means[task] = candidate, other, len(pair), fell
        reasons += _fallen(means, limits)
    if limits.bar is not None:
        reasons.append(_by_bar(ours, limits))
    if absent:
        reasons.append(
            ("INCONCLUSIVE", f"{plural(absent, 'episode')} without a score: PASS needs all of them")
        )
    words = [word for word, _ in reasons]
    final: GateWord = (
        "REGRESSED"
        if "REGRESSED" in words
        else "INCONCLUSIVE"
        if "INCONCLUSIVE" in words
        else "PASS"
    )
    tasks = tuple(
        TaskFigures(task=task, candidate=of[0], baseline=of[1], pairs=of[2], fell=of[3])
        for task, of in sorted(means.items())
    )
    others = [task.baseline for task in tasks if task.baseline is not None]
    return Judgement(
        word=final,
        reasons=tuple(why for _, why in reasons),
        candidate=float(np.mean([task.candidate for task in tasks])),
        baseline=float(np.mean(others)) if others else None,
        drop=drop,
        interval=interval,
        paired_by=paired_by,
        tasks=tasks,
        rounds=min(task.pairs for task in tasks),
        decided_after=decided,
        missing=absent,
    )


def _by_task(evaluation: Evaluation) -> tuple[dict[str, list[Scored]], int]:
    """Return the episodes that have a score, by task, and how many have none."""
    by_task: dict[str, list[Scored]] = defaultdict(list)
    for episode in evaluation.episodes:
        if episode.score is not None:
            by_task[episode.task].append((episode.start, episode.score))
    if not by_task:
        raise UsageError(f"{evaluation.name}: no episode has a score")
    return dict(by_task), sum(episode.score is None for episode in evaluation.episodes)


def _unlike(
    new: Evaluation,
    baseline: Evaluation,
    ours: Mapping[str, object],
    theirs: Mapping[str, object],
) -> str:
    lacking = [
        f"{evaluation.name} lacks {', '.join(sorted(absent)[:3])}"
        + (f" and {len(absent) - 3} more" if len(absent) > 3 else "")
        for evaluation, absent in (
            (new, theirs.keys() - ours.keys()),
            (baseline, ours.keys() - theirs.keys()),
        )
        if absent
    ]
    return f"the tasks are not the same: {'; '.join(lacking)}"


def _paired(
    ours: Mapping[str, Sequence[Scored]], theirs: Mapping[str, Sequence[Scored]]
) -> tuple[dict[str, Values], Literal["start", "order"]]:
    """Return pairs of scores (P, 2) of each task, the candidate's first, and what pairs them."""
    known = {task: dict(group) for task, group in theirs.items()}
    by_start = all(
        start is not None and start in known[task]
        for task, group in ours.items()
        for start, _ in group
    )
    pairs: dict[str, Values] = {}
    for task in sorted(ours):
        if by_start:
            of_task = [(score, known[task][start]) for start, score in ours[task]]
        else:
            both = zip(ours[task], theirs[task], strict=False)
            of_task = [(one, other) for (_, one), (_, other) in both]
        pairs[task] = np.array(of_task, dtype=np.float64)
    # Only whole rounds: weights by unequal numbers would be others at each look.
    rounds = min(map(len, pairs.values()))
    whole = {task: of_task[:rounds] for task, of_task in pairs.items()}
    return whole, "start" if by_start else "order"


def _rounds(groups: Sequence[Values], limits: JudgeSettings) -> tuple[GateWord, int | None]:
    """Return which claim is refuted first, and after how many rounds; groups have one length."""
    values = np.stack(groups)
    passed = _first(values, (1.0 - limits.max_drop) / 2.0, 1.0 - limits.confidence)
    regressed = _first(1.0 - values, (1.0 + limits.tolerate) / 2.0, limits.false_alarm)
    if passed is not None and (regressed is None or passed <= regressed):
        return "PASS", passed
    return ("INCONCLUSIVE", None) if regressed is None else ("REGRESSED", regressed)


def _first(values: Values, mean: float, error: float) -> int | None:
    """Return the first round at which "the mean is at most this" is refuted; None if at none.

    Args:
        values: (S, R), of each task and round.
        mean: of the claim.
        error: probability with which a true claim may be refuted.
    """
    tasks, rounds = values.shape
    bets = log_bets(values.T.ravel(), 1.0, mean).reshape(-1, rounds, tasks)
    capital = log_mixture(bets.sum(axis=2).cumsum(axis=1).T)
    (refuted,) = np.nonzero(capital >= -math.log(error))
    return int(refuted[0]) + 1 if len(refuted) else None


def _order_words(word: GateWord, drop: float, limits: JudgeSettings, rounds: int | None) -> str:
    """Return why the first episodes decide nothing where all of them say the opposite."""
    limit = f"max_drop {limits.max_drop:g}" if word == "PASS" else f"tolerate {limits.tolerate:g}"
    return (
        f"the first {rounds} episodes of each task say {word}, and all of them a drop of "
        f"{drop:+.3f}, where {limit} is the limit: the order of the episodes may depend on their "
        "scores; give them in the order in which they ran, or name their initial states (--start)"
    )


def _drop_words(word: GateWord, drop: float, interval: Interval, limits: JudgeSettings) -> str:
    said = f"the drop is {drop:+.3f}"
    # Rounded to three digits, an end beside a margin would contradict the verdict.
    if word == "PASS" and float(f"{interval.high:.3f}") >= limits.max_drop:
        return f"{said}, less than max_drop {limits.max_drop:g}"
    if word == "REGRESSED" and float(f"{interval.low:.3f}") <= limits.tolerate:
        return f"{said}, more than tolerate {limits.tolerate:g}"
    said = f"{said}, between {interval.low:+.3f} and {interval.high:+.3f}"
    if word == "PASS":
        return f"{said}: less than max_drop {limits.max_drop:g}"
    if word == "REGRESSED":
        return f"{said}: more than tolerate {limits.tolerate:g}"
    return (
        f"{said}: too few episodes to tell a drop of {limits.max_drop:g} from one below "
        f"{limits.tolerate:g}"
    )


def _fallen(
    means: Mapping[str, tuple[float, float | None, int, bool]], limits: JudgeSettings
) -> Iterator[tuple[GateWord | None, str]]:
    """Yield what to say of each task that fell; a critical one decides the verdict."""
    for task, (candidate, baseline, _, fell) in sorted(means.items()):
        if fell:
            is_critical = any(fnmatchcase(task, pattern) for pattern in limits.critical)
            said = f"{task} fell by over {limits.task_drop:g}: {baseline:.3f} to {candidate:.3f}"
            yield ("REGRESSED", f"{said}, and is critical") if is_critical else (None, said)


def _by_bar(groups: Mapping[str, Sequence[Scored]], limits: JudgeSettings) -> tuple[GateWord, str]:
    assert limits.bar is not None, "the caller has one"
    rounds = min(map(len, groups.values()))
    values = [np.array([score for _, score in group[:rounds]]) for group in groups.values()]
    low, high = (bound(values, limits.confidence) for bound in (lower_bound, upper_bound))
    said = f"the mean is between {low:.3f} and {high:.3f}"
    if low >= limits.bar:
        return "PASS", f"{said}: it reaches {limits.bar:g}"
    if high < limits.bar:
        return "REGRESSED", f"{said}: below {limits.bar:g}"
    return "INCONCLUSIVE", f"{said}: {limits.bar:g} is between them"
