"""What every report says in sentences: the verdict, and what it does and does not show.

`headline` and `blind_spot` are its first lines; `how_sure` says in a few sentences what its numbers
can tell, and what a comparison with a baseline can.
"""

from __future__ import annotations

from collections.abc import Mapping

from nw_base.plural import plural
from nw_base.protocol import PROTOCOLS, STRICT
from nw_gate.baseline.power_forecast import in_a_sentence
from nw_gate.results.provenance import RunInfo
from nw_gate.verdict import Comparison, Verdict, Word


def headline(verdict: Verdict, run: RunInfo) -> str:
    """Return the verdict and what made it, what happened, success and cost, on a line."""
    word, *parts = headline_parts(verdict, run)
    return " · ".join([f"{word}{flagged_by(verdict)}", *parts])


def flagged_by(verdict: Verdict) -> str:
    """Return what made a verdict REGRESSED, such as ` by the bar`; nothing for any other."""
    by = verdict.regressed_by
    most = ", ".join(by[:_NAMED]) + (f" and {len(by) - _NAMED} more" if len(by) > _NAMED else "")
    return f" by {most}" if by else ""


_NAMED = 3


def headline_parts(verdict: Verdict, run: RunInfo) -> tuple[str, ...]:
    """Return what the headline is joined of: the verdict's word, then the meaning, then numbers.

    Bounds are in the reasons beneath, which say each of them once.

    Args:
        verdict: what the gate says of the run.
        run: the run's provenance.
    """
    parts = [verdict.verdict] + ([] if run.shard is None else [str(run.shard)])
    same = _same_policy(verdict.against)
    if same:
        parts.append(same)
    parts.append(_completed(verdict, run))
    if verdict.failures and verdict.verdict in {"REGRESSED", "INCONCLUSIVE"}:
        parts.append(verdict.failures)
    if verdict.success is not None:
        parts.append(_success(verdict))
    parts += _scores(verdict)
    parts += _limits(verdict)
    if verdict.left:
        parts.append(f"{len(verdict.left)} left the captured volume")
    if verdict.errors:
        parts.append(plural(verdict.errors, "error"))
    cost = _duration(run.wall_s) if run.finished else "not finished"
    parts.append(f"{cost} on {plural(run.workers, 'worker')}")
    return tuple(parts)


def next_step(verdict: Verdict, run: RunInfo) -> str:
    """Return what a reader may do next; nothing where the reasons say it."""
    if run.is_search:
        return ""
    if run.is_part:
        return "merge all shards with `nw-eval merge RUN... --out FOLDER`"
    if verdict.verdict == "PASS" and verdict.against and verdict.against.basis == "same":
        return "`nw-eval run SUITE --policy POLICY` compares the next checkpoint with this baseline"
    return _NEXT.get(verdict.verdict, "")


_NEXT: Mapping[Word, str] = {
    "PASS": "`nw-eval baseline save` makes this policy the baseline of later runs",
    "REGRESSED": "look at the worst trials",
    "RAN": "set `gate.success_rate` in the suite to get a verdict",
    "INCONCLUSIVE": "run more trials with `nw-eval run --resume RUN --trials N`",
    "INFRASTRUCTURE": "run the missing trials with `nw-eval run --resume RUN`",
}


def blind_spot(verdict: Verdict, run: RunInfo) -> str:
    """Return what the bounds apply to, and what a gate against a baseline finds, on a line."""
    if run.is_part:
        return "These are the trials of one shard only."
    if run.is_search:
        return (
            "These trials were chosen to find a limit; they do not measure success in these scenes."
        )
    if verdict.success is None:
        return "No trial has a result, so nothing can be said."
    sentence = "The bounds apply to new initial states in these scenes."
    if verdict.bar is None:
        sentence = (
            f"For new initial states in these scenes, success is {_between(verdict)} "
            f"({confidence(verdict)} confidence)."
        )
    if verdict.whole and _met_all(verdict, run):
        # The simulator gives the same bits every time: on these starts nothing is estimated.
        sentence += f" On this {_seed_set(run)} success is exactly {verdict.success:.3f}."
    found = verdict.against
    if found is not None and found.curve is not None:
        return f"{sentence} {in_a_sentence(found.curve, found.budget)}."
    return sentence


def _between(verdict: Verdict) -> str:
    low, high = verdict.interval
    if low < _ALIKE:
        return f"at most {high:.3f}"
    return f"at least {low:.3f}" if high > 1.0 - _ALIKE else f"between {low:.3f} and {high:.3f}"


def confidence(verdict: Verdict) -> str:
    """Return the confidence of a verdict's bounds in words."""
    return f"{100 * verdict.confidence:.4g} %"


def part_of_suite(verdict: Verdict, run: RunInfo) -> str:
    """Return of how many of its suite's scenes a run has results; nothing if of all or of none."""
    seen = sum(item.n > 0 for item in verdict.per_scene)
    every = len(run.scenes) + len(run.left_out)
    return f"{seen} of the suite's {plural(every, 'scene')}" if 0 < seen < every else ""


def stopped_early(run: RunInfo) -> str:
    """Return after how many of its trials a run was stopped; nothing if it was not."""
    if run.stop is None:
        return ""
    most = sum(scene.trials for scene in run.scenes.values())
    return f"decided after {sum(run.stop.trials.values())} of {most} trials; the rest were skipped"


def _scores(verdict: Verdict) -> list[str]:
    """Return the scores that make the verdict what it is."""
    parts: list[str] = []
    for item in verdict.scores:
        if item.word != verdict.verdict or item.mean is None:
            continue
        asked = [f"bar {item.bar:g}"] if item.bar is not None else []
        if item.baseline is None:
            parts.append(", ".join([f"{item.spec.name} {item.mean:.4g}", *asked]))
        else:
            asked.append(f"max_drop {item.max_drop:g}")
            change = f"{item.baseline:.4g} -> {item.mean:.4g}"
            parts.append(f"{item.spec.name} {change}, {', '.join(asked)}")
    return parts


def _limits(verdict: Verdict) -> list[str]:
    """Return the limits that make the verdict what it is."""
    parts: list[str] = []
    for item in verdict.limits:
        if item.word == verdict.verdict and item.candidate is not None:
            beside = "" if item.baseline is None else f", baseline {item.baseline.range_text}"
            parts.append(f"limit of {item.ladder} {item.candidate.range_text}{beside}")
    return parts


def _completed(verdict: Verdict, run: RunInfo) -> str:
    """Return how many trials completed, in how many scenes, and the baseline's from the same."""
    ran = sum(item.n for item in verdict.per_scene)
    scenes = part_of_suite(verdict, run)
    if not scenes:
        scenes = plural(sum(item.n > 0 for item in verdict.per_scene), "scene")
    of = f"{ran}" if ran == verdict.planned else f"{ran} of {verdict.planned}"
    if not verdict.n:
        noun = "trial" if of == "1" or of.endswith(" of 1") else "trials"
        return f"{of} {noun} in {scenes}"
    if ran == verdict.planned == verdict.n:
        said = f"completed {verdict.completed} of {plural(ran, 'trial')} in {scenes}"
    else:
        # Those of informational scenes, and such as have no result, are in no count of completed.
        counted = plural(verdict.n, "counted trial")
        said = f"completed {verdict.completed} of {counted}; {of} ran in {scenes}"
    return said + _beside(verdict)


def _beside(verdict: Verdict) -> str:
    """Return how many trials the baseline completed from the same initial states."""
    found = verdict.against
    if found is None or found.paired is None or found.drop is None:
        return ""
    ours, theirs, trials = found.paired
    if (ours, trials) == (verdict.completed, verdict.n):
        return f"; baseline {found.baseline_name} completed {theirs} of the same {trials}"
    return (
        f"; of the {trials} compared it completed {ours}, baseline {found.baseline_name} {theirs}"
    )


def _success(verdict: Verdict) -> str:
    """Return mean success, the baseline's in the same scenes, and the gate's limits.

    Success is the baseline's less the drop. Where trials that are not compared bear on it too, or
    trials that count less, the drop stands alone, with its trials.
    """
    unjudged = "not judged" if verdict.against is None else "no bar"
    bar = unjudged if verdict.bar is None else f"bar {verdict.bar:g}"
    success, found = f"success {verdict.success:.3f} ({bar})", verdict.against
    if found is None or found.drop is None:
        return success
    drop, met = f"drop {found.drop:z.3f} (max_drop {found.max_drop:g})", found.baseline_met
    assert verdict.success is not None, "asked for where it is known"
    if met is not None and abs(met - found.drop - verdict.success) < _ALIKE:
        return f"{success}, baseline {met:.3f} in the same scenes, {drop}"
    return f"{success}, {drop} in the {plural(found.trials, 'trial')} compared"


_ALIKE = 5e-4
"""What is printed with three digits as the same."""


def _same_policy(found: Comparison | None) -> str:
    """Return what is said where the policy is the baseline's own; nothing of any other."""
    if found is None:
        return ""
    same = f"same policy as baseline {found.baseline_name}"
    if found.again is not None and found.again.differing:
        return f"{same}, but its results differ from the baseline's"
    if found.is_own:
        return f"{same}, but this machine or version computes different results"
    if found.basis == "same":
        # Where the other results come from is said beneath, in the reasons.
        return same if found.again is None else f"{same}: {found.again.in_words.partition(';')[0]}"
    return ""


def _seed_set(run: RunInfo) -> str:
    """Return which seed set the policy met: the suite's own where nothing else is said."""
    seed = run.suite.get("seed")
    kind = "fresh seed set" if run.panel == "fresh" else "seed set"
    return kind if seed is None else f"{kind} (seed {seed})"


def _met_all(verdict: Verdict, run: RunInfo) -> bool:
    """Whether success is that of the whole seed set, not only of the starts that were drawn."""
    again = None if verdict.against is None else verdict.against.again
    if again is not None and again.taken_over:
        return True
    return run.drawn_from is None or (
        run.stop is None and run.suite.get("trials") == run.drawn_from
    )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.1f} min"


_PINNED = (
    "The seed set is pinned, the suite's own. On it success is known, not estimated: the "
    "same trial gives the same result. Picking the best of many checkpoints favours luck: confirm "
    "it with --seed-set fresh."
)
_FRESH = (
    "The seed set is fresh: it follows from what the checkpoint computes. No user "
    "chose the checkpoint by these initial states, or the initial states for it."
)
_CHANCES = (
    "The chances that more trials decide are simulated. Each waypoint is reached with the same "
    "chance, and that chance is drawn from the values that the trials so far allow."
)
_SAME_OFFSETS = (
    "The protocol {protocol} gives trial number i the same offset of its initial state in every "
    "scene, so scenes are not independent of each other, as the bounds suppose."
)


def how_sure(verdict: Verdict, run: RunInfo) -> tuple[str, ...]:
    """Return the sentences that apply to this run; none for one without results, or a part."""
    if verdict.success is None or run.is_part:
        return ()
    sentences = [_bounds(verdict), _FRESH if run.panel == "fresh" else _PINNED]
    if verdict.against is not None:
        sentences += against_baseline(verdict.against)
    if verdict.verdict == "INCONCLUSIVE":
        sentences.append(_CHANCES)
    critical = sum(item.tier == "critical" for item in verdict.per_scene)
    if critical and verdict.bar is not None:
        sentences.append(_alone(verdict, critical))
    protocol = PROTOCOLS.get(str(run.suite.get("protocol")), STRICT)
    if protocol.one_start_for_all_scenes:
        sentences.append(_SAME_OFFSETS.format(protocol=protocol.name))
    return tuple(sentences)


def _bounds(verdict: Verdict) -> str:
    return (
        f"The bounds hold for new initial states in these scenes, {confidence(verdict)} each, for "
        "any distribution of success, and however often trials are added and judged again. They "
        "say nothing of other scenes."
    )


def _alone(verdict: Verdict, critical: int) -> str:
    return (
        f"{plural(critical, 'critical scene')} can flag a regression alone, by an upper bound "
        "below the bar; few trials show that only of a scene far below it. So a REGRESSED is wrong "
        f"with a probability of at most {200 * (1 - verdict.confidence):.3g} %: half of it for the "
        "mean, half for the critical scenes together."
    )


_SAME = (
    "Checkpoint and card are the baseline's, by their digests. The simulator gives the same policy "
    "the same results, so no trial can tell the two apart."
)
_TAKEN_OVER = (
    "Results that were not re-run are those of the baseline's file. The trials to re-run were "
    "drawn when the run started. Each detects, with probability p, a file that is wrong in a share "
    "p of its trials; `nw-eval baseline verify` re-runs any share of them."
)
_CURVE = (
    "What this gate does with other policies is simulated, with two kinds of them: every waypoint "
    "is harder by one factor, or a trial completes the course or scores 0. Nothing ties a trial to "
    "that of the baseline from the same initial state. Between `tolerate` and `max_drop` either "
    "verdict is legitimate."
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
        f"most {false_pass}, and a drop of {found.tolerate:g} or less is flagged by the mean "
        f"with probability at most {false_alarm}. Both hold at any stopping time, and so does the "
        f"interval (lower end {false_alarm}, upper end {false_pass}). Success and drop are "
        "estimates at a stop that the results chose, which biases the drop away from zero; the "
        "bounds have no such bias. All tests of this gate "
        f"together report REGRESSED with probability at most {_percent(found.false_alarm)} for a "
        f"policy that is good enough: above the bar, dropped by at most {found.tolerate:g}, in no "
        f"scene by more than {found.scene_drop:g}. The verdict is on this checkpoint, "
        "not on its training recipe: another seed of the same recipe may score otherwise."
    )


def _claim(found: Comparison) -> str:
    """Return of which starts it speaks, and why."""
    starts = plural(found.starts, "initial state")
    if found.claim == "panel":
        return (
            f"What the baseline does from each of its {starts} a scene is known, and scenes and "
            "initial states were drawn at random for the candidate: the claim is of these only."
        )
    if found.basis == "control":
        return (
            "This machine computes other results than the baseline's, so its recorded results are "
            "not used: its policy ran beside the candidate, from the same initial states. The "
            "claim is of new initial states in these scenes."
        )
    if found.is_own:
        return (
            "The policy is the baseline's own, and its results are others here. It met initial "
            "states drawn at random, and the mean is judged after whole rounds of one trial a "
            "scene. The claim is of new initial states in these scenes on this machine and version."
        )
    # Which scenes the trials met is by chance, and the drop is free of that.
    how = (
        f"the candidate met new ones, and the baseline's mean is of {starts} in each scene"
        if found.basis == "fresh"
        else f"scenes and states were drawn at random from the baseline's {starts} a scene"
    )
    return (
        f"The claim is of new initial states in these scenes: {how}. The drop compares each trial "
        "with the baseline's mean in its scene. The baseline's success in the headline is "
        "therefore that of the scenes of these trials, some easy and some hard by chance. The "
        "baseline's mean is taken as exact; with 30 or more initial states per scene, that adds "
        "at most 0.9 percentage points to either error (simulated)."
    )


def _percent(alpha: float) -> str:
    return f"{100 * alpha:.3g} %"
