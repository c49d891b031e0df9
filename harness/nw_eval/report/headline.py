"""The first two lines of every report: the verdict, and what the run could not see."""

from __future__ import annotations

from nw_eval.gate.verdict import Verdict
from nw_eval.results.provenance import RunInfo


def headline(verdict: Verdict, run: RunInfo) -> str:
    """Return the verdict, success, its certainty, the number of trials and the cost, on a line."""
    parts = [verdict.verdict]
    if verdict.effect is not None:
        percent = f"{100 * verdict.confidence:.4g} %"
        bar = "no bar" if verdict.bar is None else f"bar {verdict.bar:g}"
        parts.append(
            f"success {verdict.effect:.3f} ({percent} bounds "
            f"{verdict.interval.low:.3f} and {verdict.interval.high:.3f}, {bar})"
        )
    scenes = sum(item.n > 0 for item in verdict.per_scene)
    ran = sum(item.n for item in verdict.per_scene)
    count = f"{ran}" if ran == verdict.planned else f"{ran} of {verdict.planned}"
    parts.append(f"{count} trials in {_count(scenes, 'scene')}")
    if verdict.errors:
        parts.append(_count(verdict.errors, "error"))
    cost = _duration(run.wall_s) if run.finished else "not finished"
    parts.append(f"{cost} on {_count(run.workers, 'worker')}")
    return " · ".join(parts)


def blind_spot(verdict: Verdict) -> str:
    """Return what the run could not have seen, on a line."""
    if verdict.effect is None:
        return "This run could not see anything: no trial has a result."
    return (
        f"This run could not see drops smaller than {verdict.mde:.2f}: a true success rate from "
        f"{verdict.interval.low:.2f} to {verdict.interval.high:.2f} could have given the same "
        f"{verdict.n} trials. It speaks of these scenes and this panel of seeds only."
    )


def _count(number: int, word: str) -> str:
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.1f} min"
