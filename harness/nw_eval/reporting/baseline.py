"""What a comparison with a baseline can tell and what it cannot, in a few sentences."""

from __future__ import annotations

from nw_eval.gate.verdict import Comparison
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
    """Return how often it errs, and that one may look after every trial."""
    false_pass, false_alarm = _percent(found.alpha_pass), _percent(found.alpha_regr)
    return (
        f"A drop of {found.max_drop:g} or more against the baseline passes with probability at "
        f"most {false_pass}, and a drop of {found.tolerate:g} or less is convicted by the mean "
        f"with probability at most {false_alarm}. Both hold at any stopping time, and so does the "
        f"interval (lower end {false_alarm}, upper end {false_pass}). All tests of this gate "
        f"together report REGRESSED of a policy that is good enough (above the bar, dropped by "
        f"{found.tolerate:g} at most, in no scene by more than {found.scene_drop:g}) with "
        f"probability at most {_percent(found.false_alarm)}. The verdict is on this checkpoint, "
        "not on its training recipe: another seed of the same recipe may score otherwise."
    )


def _claim(found: Comparison) -> str:
    """Return of which starts it speaks, and why."""
    starts = plural(found.starts, "start")
    if found.claim == "panel":
        return (
            f"What the baseline does from each of its {starts} a scene is known, and scenes and "
            "starts were drawn at random for the candidate: the claim is of these starts only."
        )
    if found.basis == "control":
        return (
            "Bits differ between this machine and the baseline's, so that its recorded results are "
            "not used: its policy ran beside the candidate, from the same starts. The claim is of "
            "new starts in these scenes."
        )
    # Which scenes the trials met is by chance, and the drop is free of that.
    how = (
        f"the candidate met new starts, and the baseline's mean is of {starts} in each scene"
        if found.basis == "fresh"
        else f"scenes and starts were drawn at random from the baseline's {starts} a scene"
    )
    return (
        f"The claim is of new starts in these scenes: {how}. The drop compares each trial with the "
        "baseline's mean in its scene. Mean success is of the trials drawn, which meet easy and "
        "hard scenes by chance: it need not be the baseline's mean less the drop."
    )


def _percent(alpha: float) -> str:
    return f"{100 * alpha:.3g} %"
