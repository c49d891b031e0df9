"""The table of scenes: success, what changed against a baseline, and the sentences on both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nw_base.plural import plural
from nw_eval.reporting.tables.table import Bar, Table, bounds_header, span, uncorrected
from nw_gate.results.row import Row
from nw_gate.stats.baseline.trials import SUSPECT
from nw_gate.stats.interval import Interval
from nw_gate.verdict import Comparison, SceneDrop, SceneScore, Verdict

_LEFT = "left capture"
"""Trials that left the captured volume, and are counted apart."""


@dataclass(frozen=True, kw_only=True)
class _Line:
    """A scene, with what was changed there; one of `score` and `drop` is known at least."""

    score: SceneScore | None
    drop: SceneDrop | None

    @property
    def name(self) -> str:
        return self.drop.name if self.drop is not None else self._scored.scene

    @property
    def tier(self) -> str:
        return self.drop.tier if self.drop is not None else self._scored.tier

    @property
    def trials(self) -> str:
        """Those that success is of, and of how many where some are missing."""
        if self.drop is not None and self.is_all_compared:
            return str(self.drop.trials)
        n, planned = self._scored.n, self._scored.planned
        return str(n) if n == planned else f"{n} of {planned}"

    @property
    def success(self) -> float | None:
        """Mean success of these."""
        if self.drop is not None and self.is_all_compared:
            return self.drop.candidate
        return None if self.score is None else self.score.mean

    @property
    def is_all_compared(self) -> bool:
        """Whether its trials are those that were compared with the baseline."""
        return self.score is None or (self.drop is not None and self.drop.trials == self.score.n)

    @property
    def change(self) -> str:
        """Of the trials that were compared, and how many these were of more."""
        if self.drop is None or self.drop.drop is None:
            return ""
        of = "" if self.is_all_compared else f" ({plural(self.drop.trials, 'trial')})"
        return f"{-self.drop.drop:+z.3f}{of}"

    @property
    def order(self) -> tuple[bool, bool, float, float, float, str]:
        """What regressed first, then what scores least; what does not count last."""
        drop, mean = self.drop, self.success
        return (
            self.tier == "informational" and drop is not None,
            drop is not None and drop.drop is None,
            0.0 if drop is None else -drop.evidence,
            0.0 if drop is None or drop.drop is None else -drop.drop,
            -1.0 if mean is None else mean,
            self.name,
        )

    @property
    def _scored(self) -> SceneScore:
        assert self.score is not None, "a line is of something"
        return self.score


def scenes_table(verdict: Verdict, rows: Sequence[Row] = (), *, brief: bool = False) -> Table:
    """Return success by scene: what regressed against the baseline first, then the lowest.

    Args:
        verdict: with the scenes, and a comparison where there is a baseline.
        rows: of the run; they tell whether trials have waypoints.
        brief: for a terminal: without the intervals of changes.
    """
    found = verdict.against
    lines = sorted(_lines(verdict), key=lambda line: line.order)
    tiers = any(line.tier != "supporting" for line in lines)
    splits = any(line.score and line.score.split for line in lines)
    own = f"{100 * verdict.confidence:.4g} % two-sided"
    change = "" if found is None else bounds_header(found.alpha_pass, found.alpha_regr)
    owned = [_has_own_interval(line, verdict) for line in lines]
    table = Table(
        title="Success by scene",
        columns=(
            *("scene", "split", "tier", "trials", _LEFT, "success", own, "completed"),
            *("baseline", "change", f"change, {change}", "regressed", "worse from"),
        ),
        rows=tuple(
            (
                line.name,
                (line.score.split or "-") if splits and line.score else "",
                line.tier if tiers else "",
                line.trials,
                str(line.score.outside) if line.score and line.score.outside else "",
                "none" if line.success is None else f"{line.success:.3f}",
                span(line.score.interval) if line.score and is_own else "",
                f"{line.score.completed} of {line.score.n}" if line.score and line.score.n else "",
                *_compared(line, brief=brief),
            )
            for line, is_own in zip(lines, owned, strict=True)
        ),
        numbers=frozenset({"trials", _LEFT, "success", own, "baseline", "change"}),
        foot=_of_splits(verdict.per_scene),
        note=" ".join(
            filter(
                None,
                (
                    _what_counts(rows),
                    _bootstrapped(own) if any(owned) else "",
                    _WEAK if any(item.weak for item in verdict.per_scene) else "",
                    "" if found is None else _note(found, change),
                ),
            )
        ),
        marked=_marked(verdict),
        bars=tuple(
            _bar(line, verdict, own=is_own) for line, is_own in zip(lines, owned, strict=True)
        ),
    )
    return table.without_empty()


def _lines(verdict: Verdict) -> list[_Line]:
    scores = {item.scene: item for item in verdict.per_scene}
    found = verdict.against
    drops = () if found is None else found.scenes
    if found is not None and found.again is not None and found.again.taken_over:
        drops = ()  # The results are the baseline's: nothing changed.
    lines = [
        # What is said of a scene is not said of what was changed in it.
        _Line(score=None if item.perturbation else scores.get(item.scene), drop=item)
        for item in drops
    ]
    met = {item.scene for item in drops}
    return lines + [
        _Line(score=item, drop=None) for item in verdict.per_scene if item.scene not in met
    ]


def _compared(line: _Line, *, brief: bool) -> tuple[str, str, str, str, str]:
    """Return the cells of what changed: baseline, change, its interval, and the two tests.

    One says whether the scene regressed, the other from which waypoint on it is worse.
    """
    item = line.drop
    if item is None:
        return "", "", "", "", ""
    baseline = "none" if item.baseline is None else f"{item.baseline:.3f}"
    interval = ""
    if not brief and item.interval is not None and item.trials:
        interval = span(Interval(-item.interval.high, -item.interval.low))
    from_there = "" if item.waypoint is None else f"waypoint {item.waypoint}"
    return baseline, line.change, interval, "yes" if item.named else "", from_there


def _has_own_interval(line: _Line, verdict: Verdict) -> bool:
    """Return whether a scene's success is to have an interval here.

    One that is all that counts has that of the verdict, and one that is compared with a baseline
    has that of its change, on which the verdict rests.
    """
    if line.score is None or line.score.mean is None:
        return False
    if verdict.against is not None and any(each.interval for each in verdict.against.scenes):
        return False
    return line.tier == "informational" or line.score.n < verdict.n


def _marked(verdict: Verdict) -> str:
    if verdict.against is not None:
        return "baseline"
    return "" if verdict.bar is None else "the bar"


def _bar(line: _Line, verdict: Verdict, *, own: bool) -> Bar | None:
    if line.success is None:
        return None
    drop = line.drop
    if drop is None or drop.baseline is None or drop.candidate is None:
        mark = verdict.bar if verdict.against is None else None
        interval = line.score.interval if line.score and own else None
        return Bar(value=line.success, interval=interval, mark=mark)
    return Bar(value=line.success, mark=drop.baseline, interval=_left(drop), change=True)


def _left(item: SceneDrop) -> Interval | None:
    """Return the candidate's success that the trials of the scene leave possible."""
    if item.interval is None or item.baseline is None:
        return None
    low, high = (item.baseline - drop for drop in reversed(item.interval))
    return Interval(max(0.0, low), min(1.0, high))


def _what_counts(rows: Sequence[Row]) -> str:
    results = [row for row in rows if row.status == "ok" and not row.waypoints_total]
    kinds = sorted({row.task_kind for row in results})
    if kinds:
        return f"Success is what the task {' and '.join(kinds)} counts: 1 of a completed trial."
    return (
        "Success is the share of the course's waypoints reached, completed the share of trials "
        "that reached all."
    )


def _bootstrapped(header: str) -> str:
    return (
        f"{uncorrected('scene', header)} It is a Bayesian bootstrap of the scene's trials; the "
        "verdict uses bounds that hold for any distribution."
    )


_WEAK = (
    "A scene is below the bar by itself if its whole interval is. This is not corrected for the "
    "number of scenes either: of many scenes at the bar, some are below it by chance."
)


def _of_splits(scores: Sequence[SceneScore]) -> str:
    """Return the means of the scenes that a policy was trained in, and of the others; or nothing.

    Scenes weigh equally, as in the verdict, and informational ones do not count.
    """
    parts: list[str] = []
    for split, words in (("train", "it was trained in"), ("eval", "it was not trained in")):
        known = [
            item.mean
            for item in scores
            if item.split == split and item.mean is not None and item.tier != "informational"
        ]
        if known:
            average = float(np.mean(known))
            parts.append(f"{average:.3f} in {plural(len(known), 'scene')} that {words} ({split})")
    return f"Mean success: {', '.join(parts)}." if parts else ""


def _note(found: Comparison, header: str) -> str:
    """Return of which trials a change is, and when a scene is reported as regressed."""
    judged = sum(item.counts for item in found.scenes)
    known = f"{plural(found.starts, 'initial state')} in each scene"
    if found.basis == "control":
        known = f"{plural(found.control, 'trial')} that ran beside the candidate"
    if found.basis == "same" and found.again is not None and found.again.taken_over:
        return f"Results are the baseline's, {known}; {plural(found.again.ran, 'trial')} re-run."
    trials = plural(found.trials, "trial")
    means = f"The baseline {found.baseline_name} has {known}, the candidate {trials}."
    if found.basis == "same":
        return means
    alone = f"{uncorrected('scene', header)} " if any(x.interval for x in found.scenes) else ""
    return (
        f"{means} {alone}Evidence (a test martingale) is against a drop of at most "
        f"{found.scene_drop:g} in that scene. At {judged / found.alpha_regr:.0f} or more the scene "
        f"is reported as regressed ({plural(judged, 'scene')} share an error of "
        f"{100 * found.alpha_regr:.3g} %). At {SUSPECT:g} or more, PASS is withheld. Worse from is "
        "another test: the first waypoint that the candidate misses significantly more often."
    )
