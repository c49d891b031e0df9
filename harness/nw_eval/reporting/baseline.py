"""What a comparison with a baseline can tell and what it cannot, in a few sentences."""

from __future__ import annotations

from nw_eval.gate.baseline.comparison import Comparison
from nw_eval.plural import plural

_SAME = (
    "Checkpoint and card are the baseline's, by their digests: the simulator gives the same policy "
    "the same bits, so that no trial could tell the two apart."
)
_TAKEN_OVER = (
    "Results that did not run again are what the baseline's file says. Which starts ran again was "
    "drawn when the run began. Each trial that ran again shows a file that is wrong in a share p "
    "of its starts with probability p; `nw-eval baseline verify` runs any share of them."
)
_CURVE = (
    "What this gate does with policies that it has not met is simulated: in every scene their odds "
    "of reaching the next waypoint are lower by one factor, and nothing ties a trial to that of "
    "the baseline from the same start. Between the two drops either verdict is legitimate."
)


def against_baseline(found: Comparison) -> tuple[str, ...]:
    """Return the sentences that apply to a comparison."""
    if found.basis == "same":
        is_taken_over = found.again is not None and found.again.taken_over
        return (_SAME, _TAKEN_OVER) if is_taken_over else (_SAME,)
    return (_errors(found), _claim(found), *([_CURVE] if found.curve else ()))


def _errors(found: Comparison) -> str:
    """Return how often it errs, and that one may look after every round."""
    critical = sum(item.tier == "critical" for item in found.scenes)
    alone = (
        f"; that {plural(critical, 'critical scene')} can convict alone adds as much again, where "
        f"no scene fell by more than {found.scene_drop:g}"
        if critical
        else ""
    )
    false_pass, false_alarm = _percent(found.alpha_pass), _percent(found.alpha_regr)
    return (
        f"Against the baseline a drop of {found.max_drop:g} or more passes with a probability of "
        f"at most {false_pass}, and one of {found.tolerate:g} or less is convicted with at most "
        f"{false_alarm}{alone}. That holds however often one looks after a whole round and stops "
        "there, and so do both ends of the interval, of which the lower one errs with "
        f"{false_alarm} and the upper one with {false_pass}."
    )


def _claim(found: Comparison) -> str:
    """Return of which starts it speaks, and why."""
    starts, rounds = plural(found.starts, "start"), plural(found.budget, "round")
    known = f"What the baseline does from each of its {starts} a scene is known"
    drawn = "their order was drawn by the candidate's digest"
    if found.claim == "panel":
        return (
            f"{known}, and {drawn}: it speaks of these starts. Of fresh ones it does not, since "
            f"{rounds} would need a bank of {found.fresh_needs}."
        )
    if found.claim == "panel and fresh":
        return (
            f"{known}, and {drawn}: it speaks of these starts exactly, and of fresh ones in these "
            f"scenes, since the bank has at least three for each of {rounds} (by simulation)."
        )
    why = {
        "panel": "their order was not drawn for this candidate",
        "sample": "this class of machine gives other bits, by which trials part after some steps",
        "fresh": "the candidate met none of them",
    }
    return (
        f"The bank is a sample of starts ({why[found.basis]}): it speaks of fresh starts in these "
        f"scenes, since the bank has at least three for each of {rounds} (by simulation)."
    )


def _percent(alpha: float) -> str:
    return f"{100 * alpha:.3g} %"
