"""The first lines of every report: the verdict, and what it does and does not show."""

from __future__ import annotations

from nw_eval.gate.outlook import percent
from nw_eval.gate.verdict import Verdict
from nw_eval.plural import plural
from nw_eval.results.provenance import RunInfo


def headline(verdict: Verdict, run: RunInfo) -> str:
    """Return verdict, success (share of waypoints), completed (of trials) and cost, on a line."""
    parts = [verdict.verdict]
    if verdict.effect is not None:
        bar = "no bar" if verdict.bar is None else f"bar {verdict.bar:g}"
        parts.append(
            f"success {verdict.effect:.3f} ({confidence(verdict)} bounds "
            f"{verdict.interval.low:.3f} and {verdict.interval.high:.3f}, {bar})"
        )
    parts += _trials(verdict)
    if verdict.errors:
        parts.append(plural(verdict.errors, "error"))
    cost = _duration(run.wall_s) if run.finished else "not finished"
    parts.append(f"{cost} on {plural(run.workers, 'worker')}")
    return " · ".join(parts)


def blind_spot(verdict: Verdict, run: RunInfo) -> str:
    """Return what the bounds speak of, and what this run would not have noticed, on a line."""
    if verdict.effect is None:
        return "This run could not see anything: no trial has a result."
    sentence = (
        f"Fresh starts in these scenes: success {verdict.interval.low:.3f} to "
        f"{verdict.interval.high:.3f} ({confidence(verdict)} each side)"
    )
    if verdict.whole:
        # The simulator gives the same bits every time: on these starts nothing is estimated.
        sentence += f"; on the starts of this panel{_seed(run)} it is known: {verdict.effect:.3f}"
    if verdict.drop_passes is None:
        return f"{sentence}."
    return (
        f"{sentence}. A policy {verdict.drop:.2f} worse would still PASS in "
        f"{percent(verdict.drop_passes)} of such runs."
    )


def confidence(verdict: Verdict) -> str:
    """Return the confidence of a verdict's bounds in words."""
    return f"{100 * verdict.confidence:.4g} %"


def _trials(verdict: Verdict) -> list[str]:
    """Return how many trials completed, and how many there were in how many scenes."""
    ran = sum(item.n for item in verdict.per_scene)
    scenes = plural(sum(item.n > 0 for item in verdict.per_scene), "scene")
    if verdict.whole and ran == verdict.n:
        return [f"completed {verdict.completed} of {plural(ran, 'trial')} in {scenes}"]
    done = [f"completed {verdict.completed} of {verdict.n}"] if verdict.n else []
    of = f"{ran}" if ran == verdict.planned else f"{ran} of {verdict.planned}"
    return [*done, f"{of} trials in {scenes}"]


def _seed(run: RunInfo) -> str:
    seed = run.suite.get("seed")
    return "" if seed is None else f" (seed {seed})"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.1f} min"
