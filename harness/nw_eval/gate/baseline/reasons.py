"""A comparison in words."""

from __future__ import annotations

from collections.abc import Iterable

from nw_eval.gate.baseline.comparison import Comparison, SceneDrop
from nw_eval.gate.baseline.finding import Finding
from nw_eval.plural import plural


def in_words(found: Comparison, finding: Finding, left_out: int) -> tuple[str, ...]:
    """Return why a comparison says what it says, and of what it speaks: the main reason first.

    Args:
        found: the comparison.
        finding: what it rests on.
        left_out: rows beyond whole rounds.
    """
    if found.basis == "same":
        return (f"the same policy as the baseline {found.policy}: nothing to test",)
    return (_word(found), *_fallen(found), *_waiting(found, finding), *_limits(found, left_out))


def _word(found: Comparison) -> str:
    """Return what was found of the mean."""
    if found.drop is None:
        return f"no whole round yet against {_baseline(found)}"
    seen = f"{found.baseline:.3f} against {found.baseline - found.drop:.3f} in {_rounds(found)}"
    if found.word == "PASS":
        sure = f"{100 * (1 - found.alpha_pass):.4g} %"
        return f"a drop of {found.max_drop:g} is excluded ({sure}): {seen}"
    if found.word == "REGRESSED":
        sure = f"{100 * (1 - found.alpha_regr):.4g} %"
        return f"worse than {_baseline(found)}, {seen} ({sure})"
    return (
        f"neither is a drop of {found.max_drop:g} excluded nor one over {found.tolerate:g} shown: "
        f"{seen}"
    )


def _fallen(found: Comparison) -> Iterable[str]:
    """Return which scenes fell, whatever the word."""
    for item in sorted(found.scenes, key=lambda item: -item.evidence):
        if item.named:
            yield _fell(item)


def _fell(item: SceneDrop) -> str:
    onwards = "" if item.waypoint is None else f", from waypoint {item.waypoint} on"
    which = "critical scene " if item.tier == "critical" else ""
    return f"{which}{item.name} fell from {item.baseline:.2f} to {item.candidate:.2f}{onwards}"


def _waiting(found: Comparison, finding: Finding) -> Iterable[str]:
    suspect = [item.name for item in found.scenes if item.stratum in finding.waits_for]
    if suspect:
        yield f"the mean would pass, but waits for {', '.join(suspect)}: more rounds will tell"


def _limits(found: Comparison, left_out: int) -> Iterable[str]:
    """Return of which starts it speaks, and what was left out."""
    if found.claim == "panel":
        yield (
            f"this speaks of the bank's {found.starts} starts only: a claim about fresh ones needs "
            f"{3 * found.budget}"
        )
    if found.claim == "fresh" and found.basis == "panel":
        yield (
            "the order of the starts was not drawn for this candidate: this speaks of fresh starts "
            "only, not of the panel"
        )
    if left_out:
        yield f"{plural(left_out, 'trial')} beyond whole rounds not compared"


def _rounds(found: Comparison) -> str:
    return plural(found.rounds, "round")


def _baseline(found: Comparison) -> str:
    return f"the baseline {found.bank}"
