"""A comparison in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from nw_eval.gate.baseline.comparison import Comparison, SceneDrop, percent_sure
from nw_eval.gate.baseline.finding import Finding
from nw_eval.plural import plural
from nw_eval.stats.bank import CRITICAL_TRIALS, SUSPECT

_NONE_LEFT = "this run has no trial of these scenes left"
_NAMED = 3  # scenes that a reason names before it says "and more"


def in_words(found: Comparison, finding: Finding) -> tuple[str, ...]:
    """Return why a comparison says what it says, and of what it speaks: the main reason first.

    Args:
        found: the comparison.
        finding: what it rests on.
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
        *_limits(found),
    )


def _mean(found: Comparison) -> str:
    """Return what was found of the mean."""
    name, drops = f"the baseline {found.bank}", found.interval
    if not found.trials or found.drop is None:
        return f"no trial has been compared with {name} yet"
    in_trials = f"in {plural(found.trials, 'trial')}"
    if drops is None:
        return f"mean success dropped by {found.drop:z.3f} from {name} {in_trials}"
    at_most, at_least = percent_sure(found.alpha_pass), percent_sure(found.alpha_regr)
    if found.word == "PASS":
        worst = f"at most {drops.high:.3f} worse" if drops.high > 0.0 else "no worse"
        if float(f"{drops.high:.3f}") >= found.max_drop:  # Rounded it would contradict the verdict.
            worst = f"less than {found.max_drop:g} worse"
        return (
            f"{worst} than {name} ({at_most} confidence) {in_trials}: a drop of "
            f"{found.max_drop:g} is excluded"
        )
    span = (
        f"at least {drops.low:z.3f} ({at_least} confidence), at most {drops.high:z.3f} ({at_most})"
    )
    if found.mean_convicts:
        return f"mean success regressed from {name}: {span} worse {in_trials}"
    change = f"dropped by {found.drop:z.3f} from {name}"
    if found.drop < 0.0:
        change = f"rose by {-found.drop:.3f} from {name}"
        span = f"which leaves a drop of {span}"
    drop = f"mean success {change} {in_trials}, {span}"
    if drops.high < found.max_drop:
        return f"{drop}: a drop of {found.max_drop:g} is excluded"
    return (
        f"{drop}: undecided, the data fit a drop of {found.max_drop:g} and a drop below "
        f"{found.tolerate:g}"
    )


def _fallen(found: Comparison) -> tuple[str, ...]:
    """Return which scenes regressed, whatever the word; those that convict first."""
    order = {"critical": 0, "supporting": 1, "informational": 2}
    named = [item for item in found.scenes if item.named]
    named.sort(key=lambda item: (order[item.tier], -item.evidence, item.name))
    shown = tuple(_fell(item) for item in named[:_NAMED])
    if len(named) > _NAMED:
        return (*shown, f"{plural(len(named) - _NAMED, 'more scene')} regressed, see the table")
    return shown


def _fell(item: SceneDrop) -> str:
    which = "critical scene" if item.tier == "critical" else "scene"
    return f"{which} {item.name} regressed: {_change(item)}"


def _largest(found: Comparison) -> Iterable[str]:
    """Return where a policy that the mean convicts seems worst, if no scene convicts alone."""
    if not found.mean_convicts or any(item.named for item in found.scenes):
        return
    lower = [item for item in found.scenes if item.counts and item.drop and item.drop > 0.0]
    lower.sort(key=lambda item: (-item.evidence, item.name))
    if lower:
        worst = "; ".join(f"{item.name} {_change(item)}" for item in lower[:_NAMED])
        yield f"no single scene regressed significantly; largest drops: {worst}"


def _change(item: SceneDrop) -> str:
    onwards = "" if item.waypoint is None else f", from waypoint {item.waypoint} on"
    return f"{item.baseline:.2f} -> {item.candidate:.2f}{onwards}"


def _waiting(found: Comparison, finding: Finding) -> Iterable[str]:
    waited = [item for item in found.scenes if item.stratum in finding.waits_for]
    suspect = [item.name for item in waited if item.evidence >= SUSPECT]
    critical = [item.name for item in waited if item.evidence < SUSPECT]
    if suspect:
        which = "it" if len(suspect) == 1 else "they"
        held = f"the mean passes; PASS is held back by {_listed(suspect)}"
        yield f"{held}: {which} may have regressed"
    if critical:
        yield (
            f"the mean passes; PASS is held back by {_listed(critical)}: a critical scene needs "
            f"{CRITICAL_TRIALS} trials"
        )
    if waited and not finding.ahead:
        yield "this run has no trial of it left" if len(waited) == 1 else _NONE_LEFT


def _limits(found: Comparison) -> Iterable[str]:
    """Return of which starts it speaks, and what was left out."""
    if found.claim == "panel":
        yield (
            f"gate.claim is panel: this holds for the baseline's {plural(found.starts, 'start')} "
            "in each scene, not for new ones"
        )
    if found.basis == "control":
        yield (
            f"this machine or version gives other bits than the baseline's: its policy "
            f"{found.policy} ran beside the candidate from the same starts "
            f"({plural(found.control, 'trial')}), and is what it is compared with; a baseline "
            "saved here saves these trials"
        )
    unmet = [item.name for item in found.scenes if item.counts and not item.trials]
    if found.word == "PASS" and unmet:
        yield (
            f"PASS is on the mean: no trial met {_listed(unmet)}; "
            f"a critical scene is met by {CRITICAL_TRIALS} before a PASS (gate.tiers)"
        )
    if found.left_aside:
        left_aside = plural(found.left_aside, "scene")
        yield f"the run was asked for some scenes only: {left_aside} of the baseline not compared"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{more}"
