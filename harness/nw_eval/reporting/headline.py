"""What every report says in sentences: the verdict, and what it does and does not show.

`headline` and `blind_spot` are its first lines; `how_sure` says in a few sentences what its numbers
can tell, and what a comparison with a baseline can.
"""

from __future__ import annotations

from nw_base.plural import plural
from nw_base.protocol import PROTOCOLS, STRICT
from nw_gate.baseline.power_forecast import in_a_sentence
from nw_gate.results.provenance import RunInfo
from nw_gate.verdict import Comparison, Recheck, Verdict, percent_sure


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
        unjudged = "not judged" if verdict.against is None else "no bar"
        bar = unjudged if verdict.bar is None else f"bar {verdict.bar:g}"
        low, high = verdict.interval
        bounds = f"{confidence(verdict)} bounds {low:.3f} and {high:.3f}, " if intervals else ""
        parts.append(f"success {verdict.success:.3f} ({bounds}{bar})")
    parts += _scores(verdict)
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
    if run.is_part:
        return "A part of a run speaks for nothing but its own trials."
    if verdict.success is None:
        return "No trial has a result, so nothing can be said."
    sentence = "The bounds of success are for new starts in these scenes"
    if verdict.whole and _met_all(verdict, run):
        # The simulator gives the same bits every time: on these starts nothing is estimated.
        sentence += f"; in this {_seed_set(run)} it is known: {verdict.success:.3f}"
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


def stopped_early(run: RunInfo) -> str:
    """Return after how many of its trials a run was stopped; nothing if it was not."""
    if run.stop is None:
        return ""
    most = sum(scene.trials for scene in run.scenes.values())
    return f"stopped after {sum(run.stop.trials.values())} of at most {most} trials"


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
        if found.is_own:
            return [f"baseline {found.bank} is the same policy, with other bits here"]
        same = "is the same policy" if found.basis == "same" else f"scores {found.baseline:.3f}"
        return [f"baseline {found.bank} {same}", *_again(found.again)]
    beside = " (run beside)" if found.basis == "control" else ""
    if found.is_own:
        beside = " (the same policy, other bits here)"
    drop = f"baseline {found.bank}{beside} {found.baseline:.3f}, drop {found.drop:z.3f}"
    ends = [
        f"{percent_sure(alpha)} {name} bound {end:z.3f}"
        for name, alpha, end in (
            ("lower", found.alpha_regr, found.known_low),
            ("upper", found.alpha_pass, found.known_high),
        )
        if end is not None
    ]
    if intervals and ends:
        drop += f" ({', '.join(ends)})"
    return [f"{drop} in {found.trials} of {plural(found.budget, 'trial')}"]


def _again(again: Recheck | None) -> list[str]:
    """Return how many trials of the baseline's own policy ran again, and the result."""
    if again is None:
        return []
    over = "taken over from the baseline, " if again.taken_over else ""
    return [f"{over}{again.in_words}"]


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
    "same trial gives the same bits. Whoever picks the best of many checkpoints on one seed "
    "set picks luck too: --seed-set fresh draws the checkpoint's own, to confirm the choice on."
)
_FRESH = (
    "The seed set is fresh: it follows from what the checkpoint computes: no user chose "
    "the checkpoint by these starts, nor the starts for it."
)
_CHANCES = (
    "The chances that more trials decide come from simulated trials, in which every part of "
    "a trial (a waypoint of a course) is done with one chance; what that is, beyond what was seen, "
    "is left open."
)
_SAME_OFFSETS = (
    "The protocol {protocol} gives trial number i the same start offset in every scene, so "
    "scenes are not independent of each other, as the bounds suppose."
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
        f"The bounds hold for new starts in these scenes, {confidence(verdict)} each, whatever "
        "the distribution of success, and however often trials are added and judged again. They "
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
        f"most {false_pass}, and a drop of {found.tolerate:g} or less is flagged by the mean "
        f"with probability at most {false_alarm}. Both hold at any stopping time, and so does the "
        f"interval (lower end {false_alarm}, upper end {false_pass}). The estimated drop is of the "
        "trials up to one that the results chose, which biases it away from zero; the bounds have "
        "no such bias. All tests of this gate "
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
    if found.is_own:
        return (
            "The policy is the baseline's own, and bits are others here. It met starts drawn at "
            "random, and the mean is judged after whole rounds of one trial a scene. The claim is "
            "of new starts in these scenes on this machine and version."
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
