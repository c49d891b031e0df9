"""A comparison in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from nw_eval.gate.baseline.comparison import Comparison, SceneDrop, percent_sure
from nw_eval.gate.baseline.finding import Finding
from nw_eval.plural import plural

_NAMED = 3  # scenes that a reason names before it says "and more"


def in_words(
    found: Comparison, finding: Finding, left_out: int, more: str | None
) -> tuple[str, ...]:
    """Return why a comparison says what it says, and of what it speaks: the main reason first.

    Args:
        found: the comparison.
        finding: what it rests on.
        left_out: rows beyond whole rounds.
        more: about how many more rounds would settle it, where that was simulated.
    """
    if found.basis == "same":
        again = found.again
        if again is None:
            return (f"the same policy as the baseline {found.policy}: nothing to test",)
        over = "taken over from the baseline, " if again.taken_over else ""
        return (f"the same policy as the baseline {found.policy}: {over}{again.in_words}",)
    fallen, mean = _fallen(found), _mean(found)
    by_scenes_alone = found.word == "REGRESSED" and not found.mean_convicts
    return (
        *((*fallen, mean) if by_scenes_alone else (mean, *fallen)),
        *_largest(found),
        *_waiting(found, finding),
        *((more,) if more else ()),
        *_limits(found, left_out),
    )


def _mean(found: Comparison) -> str:
    """Return what was found of the mean."""
    name, drops = f"the baseline {found.bank}", found.interval
    if drops is None or found.drop is None:
        return f"not one whole round has run yet against {name}"
    at_most, at_least = percent_sure(found.alpha_pass), percent_sure(found.alpha_regr)
    if found.word == "PASS":
        worst = f"at most {drops.high:.3f} worse" if drops.high > 0.0 else "no worse"
        return f"{worst} than {name} ({at_most}): a drop of {found.max_drop:g} is excluded"
    span = f"at least {drops.low:z.3f} ({at_least}) and at most {drops.high:z.3f} ({at_most})"
    if found.mean_convicts:
        return f"worse than {name} by {span}"
    return (
        f"the drop from {name} is {found.drop:z.3f} in {plural(found.rounds, 'round')}, {span}: "
        f"{found.max_drop:g} is {_excluded(drops.high < found.max_drop)}, more than "
        f"{found.tolerate:g} is not shown"
    )


def _excluded(is_excluded: bool) -> str:
    return "excluded" if is_excluded else "not excluded"


def _fallen(found: Comparison) -> tuple[str, ...]:
    """Return which scenes fell, whatever the word; those that convict first."""
    order = {"critical": 0, "supporting": 1, "informational": 2}
    named = [item for item in found.scenes if item.named]
    named.sort(key=lambda item: (order[item.tier], -item.evidence, item.name))
    shown = tuple(_fell(item) for item in named[:_NAMED])
    if len(named) > _NAMED:
        return (*shown, f"{plural(len(named) - _NAMED, 'more scene')} fell, see the table")
    return shown


def _fell(item: SceneDrop) -> str:
    which = "critical scene " if item.tier == "critical" else ""
    return f"{which}{item.name} fell {_change(item)}"


def _largest(found: Comparison) -> Iterable[str]:
    """Return where a policy that the mean convicts seems worst, if no scene convicts alone."""
    if not found.mean_convicts or any(item.named for item in found.scenes):
        return
    lower = [item for item in found.scenes if item.counts and item.drop and item.drop > 0.0]
    lower.sort(key=lambda item: (-item.evidence, item.name))
    if lower:
        worst = "; ".join(f"{item.name} {_change(item)}" for item in lower[:_NAMED])
        yield f"no scene fell beyond doubt by itself; those that speak most: {worst}"


def _change(item: SceneDrop) -> str:
    onwards = "" if item.waypoint is None else f", from waypoint {item.waypoint} on"
    return f"from {item.baseline:.2f} to {item.candidate:.2f}{onwards}"


def _waiting(found: Comparison, finding: Finding) -> Iterable[str]:
    suspect = [item.name for item in found.scenes if item.stratum in finding.waits_for]
    if suspect:
        yield f"the mean would pass, and waits for what may have fallen: {_listed(suspect)}"


def _limits(found: Comparison, left_out: int) -> Iterable[str]:
    """Return of which starts it speaks, and what was left out."""
    if found.claim == "panel":
        yield (
            f"this speaks of the bank's {plural(found.starts, 'start')} in each scene only: for "
            f"fresh ones {plural(found.budget, 'round')} would need {found.fresh_needs}"
        )
    if found.claim == "fresh" and found.basis == "panel":
        yield (
            "the order of the starts was not drawn for this candidate: this speaks of fresh starts "
            "only, not of the panel"
        )
    if found.basis == "sample":
        yield (
            "the bank was made on another class of machine: its policy's scores are in line here, "
            "its bits are not, so this speaks of fresh starts only"
        )
    if found.left_aside:
        left_aside = plural(found.left_aside, "scene")
        yield f"the run was asked for some scenes only: {left_aside} of the bank not compared"
    if left_out:
        yield f"{plural(left_out, 'trial')} beyond whole rounds not compared"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"
