"""The first lines of every report: the verdict, and what it does and does not show."""

from __future__ import annotations

from nw_eval.gate.baseline.foresee import in_a_sentence
from nw_eval.gate.verdict import Comparison, Recheck, Verdict, percent_sure
from nw_eval.plural import plural
from nw_eval.results.provenance import RunInfo


def headline(verdict: Verdict, run: RunInfo) -> str:
    """Return verdict, success (share of waypoints), completed (of trials) and cost, on a line."""
    return " · ".join(headline_parts(verdict, run))


def headline_parts(verdict: Verdict, run: RunInfo, *, intervals: bool = True) -> tuple[str, ...]:
    """Return what the headline is joined of, the verdict's word first.

    Args:
        verdict: what the gate says of the run.
        run: the run's provenance.
        intervals: whether means have theirs; a page that draws them shows them once.
    """
    part = [] if run.shard is None else [str(run.shard)]
    parts = [verdict.verdict, *part, *_against(verdict.against, intervals=intervals)]
    if verdict.success is not None:
        bar = "no bar" if verdict.bar is None else f"bar {verdict.bar:g}"
        low, high = verdict.interval
        bounds = f"{confidence(verdict)} bounds {low:.3f} and {high:.3f}, " if intervals else ""
        parts.append(f"success {verdict.success:.3f} ({bounds}{bar})")
    parts += _trials(verdict, run)
    if verdict.left:
        parts.append(f"{len(verdict.left)} left the captured volume")
    if verdict.errors:
        parts.append(plural(verdict.errors, "error"))
    cost = _duration(run.wall_s) if run.finished else "not finished"
    parts.append(f"{cost} on {plural(run.workers, 'worker')}")
    return tuple(parts)


def blind_spot(verdict: Verdict, run: RunInfo) -> str:
    """Return what the bounds speak of, and what a gate against a baseline notices, on a line."""
    if run.shard is not None:
        return "A part of a run speaks for nothing but its own trials."
    if verdict.success is None:
        return "No trial has a result, so nothing can be said."
    sentence = "The bounds of success are for new starts in these scenes"
    if verdict.whole and _met_all(verdict, run):
        # The simulator gives the same bits every time: on these starts nothing is estimated.
        sentence += f"; on the starts of this {_panel(run)} it is known: {verdict.success:.3f}"
    if verdict.against is not None and verdict.against.curve is not None:
        return f"{sentence}. {in_a_sentence(verdict.against.curve)}."
    return f"{sentence}."


def confidence(verdict: Verdict) -> str:
    """Return the confidence of a verdict's bounds in words."""
    return f"{100 * verdict.confidence:.4g} %"


def part_of_suite(verdict: Verdict, run: RunInfo) -> str:
    """Return of how many of its suite's scenes a run has results; nothing if of all or of none."""
    seen = sum(item.n > 0 for item in verdict.per_scene)
    every = len(run.scenes) + len(run.left_out)
    return f"{seen} of the suite's {plural(every, 'scene')}" if 0 < seen < every else ""


def _trials(verdict: Verdict, run: RunInfo) -> list[str]:
    """Return how many trials completed, and how many there were in how many scenes."""
    ran = sum(item.n for item in verdict.per_scene)
    scenes = part_of_suite(verdict, run)
    if not scenes:
        scenes = plural(sum(item.n > 0 for item in verdict.per_scene), "scene")
    if verdict.whole and ran == verdict.n:
        return [f"completed {verdict.completed} of {plural(ran, 'trial')} in {scenes}"]
    done = [f"completed {verdict.completed} of {verdict.n}"] if verdict.n else []
    of = f"{ran}" if ran == verdict.planned else f"{ran} of {verdict.planned}"
    noun = "trial" if of == "1" or of.endswith(" of 1") else "trials"
    return [*done, f"{of} {noun} in {scenes}"]


def _against(found: Comparison | None, *, intervals: bool) -> list[str]:
    """Return what the baseline says of the drop, if there is one."""
    if found is None:
        return []
    if found.drop is None or found.interval is None:
        if found.again is not None and found.again.differing:
            return [f"baseline {found.bank} is not what its own policy does"]
        same = "is the same policy" if found.basis == "same" else f"scores {found.baseline:.3f}"
        return [f"baseline {found.bank} {same}", *_again(found.again)]
    beside = " (run beside)" if found.basis == "control" else ""
    drop = f"baseline {found.bank}{beside} {found.baseline:.3f}, drop {found.drop:z.3f}"
    if intervals:
        sure_low, sure_high = percent_sure(found.alpha_regr), percent_sure(found.alpha_pass)
        drop += (
            f" ({sure_low} lower bound {found.interval.low:z.3f}, {sure_high} upper bound "
            f"{found.interval.high:z.3f})"
        )
    return [f"{drop} in {found.trials} of {plural(found.budget, 'trial')}"]


def _again(again: Recheck | None) -> list[str]:
    """Return how many trials of the baseline's own policy ran again, and what came of it."""
    if again is None:
        return []
    over = "taken over from the baseline, " if again.taken_over else ""
    return [f"{over}{again.in_words}"]


def _panel(run: RunInfo) -> str:
    """Return which starts the policy met: pinned ones where nothing else is said."""
    seed = run.suite.get("seed")
    kind = "fresh panel" if run.panel == "fresh" else "panel"
    return kind if seed is None else f"{kind} (seed {seed})"


def _met_all(verdict: Verdict, run: RunInfo) -> bool:
    """Whether success is that of all starts of the panel, not only of those that were drawn."""
    again = None if verdict.against is None else verdict.against.again
    if again is not None and again.taken_over:
        return True
    return run.drawn_from is None or (
        run.stop is None and run.suite.get("trials") == run.drawn_from
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.1f} min"
