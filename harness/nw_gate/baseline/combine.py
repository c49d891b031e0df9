"""The verdict on a run: by the bar and by the baseline, both of which must pass.

Of a part of a run it is only said whether its trials ran. Which trials a part has follows from
hashes: it is no sample that anything is claimed of, it need not have met a critical scene, and it
has no whole round. So the word is RAN, or what keeps the part from being put together with the
others. The whole is judged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from shlex import quote

from nw_gate.absolute import judge
from nw_gate.baseline.finding import by_place
from nw_gate.baseline.judge import compare, setup_of
from nw_gate.baseline.match import known_rows
from nw_gate.baseline.scores import reworded, with_scores, without_unjudged, worse
from nw_gate.results.baseline import LoadedBaseline
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import Row
from nw_gate.settings import Gate
from nw_gate.verdict import Comparison, LimitFinding, Verdict, Word


def judge_run(
    rows: Sequence[Row], run: RunInfo, gate: Gate, against: LoadedBaseline | None
) -> Verdict:
    """Judge the rows of a run by the bar, and against a baseline if there is one.

    Where a result came out otherwise than the cache of trials says, the verdict is INFRASTRUCTURE.
    Where the baseline's own policy did other than the baseline says on the machine of the run, the
    verdict is INVALID: nothing is attributed to the candidate. Where the candidate is the
    baseline's own policy, the baseline's results are judged in place of the run's only if all that
    ran again is equal. If bits are others, its trials are compared with the baseline as any
    candidate's are, and what would be REGRESSED is INVALID: the machine or the version changed. A
    part of a run and the trials of a search are not judged (`_of_part`).

    Args:
        rows: of the run's plan.
        run: what they are of.
        gate: the settings to judge by.
        against: the baseline.

    Raises:
        IncomparableError, StoreError: as `compare`.
    """
    if run.is_part or run.is_search:
        verdict = _of_part(rows, run, gate)
    else:
        verdict = _of_rows(rows, run, gate, against)
        verdict = with_scores(verdict, rows, run, gate, against)
    verdict = replace(
        verdict,
        per_scene=tuple(
            replace(item, split=run.scenes[item.scene].split if item.scene in run.scenes else None)
            for item in verdict.per_scene
        ),
    )
    if run.cache is None or not run.cache.differing:
        return verdict
    reasons = (*run.cache.differing, *verdict.reasons)
    return replace(verdict, verdict="INFRASTRUCTURE", reasons=reasons)


def with_limits(verdict: Verdict, limits: Sequence[LimitFinding]) -> Verdict:
    """Return a verdict with the limits of the ladders that its gate names.

    PASS asks for every limit, and any one that is REGRESSED makes the run REGRESSED: its errors are
    split over success, scores and limits (`Gate.shared`).

    Args:
        verdict: on the run's scenes. A run that is INFRASTRUCTURE or INVALID stays so, and no
            REGRESSED but INVALID becomes of the baseline's own policy.
        limits: what the ladders show, in the order of the suite.
    """
    if not limits:
        return verdict
    verdict = replace(verdict, limits=tuple(limits))
    if verdict.verdict in {"INFRASTRUCTURE", "INVALID"}:
        return verdict
    word, judged = verdict.verdict, [item for item in limits if item.word is not None]
    for item in judged:
        word = worse(word, item.word or "PASS")
    if word == "REGRESSED" and verdict.against is not None and verdict.against.is_own:
        word = "INVALID"  # The policy is the same: this machine or version changed.
    verdict = without_unjudged(verdict) if judged else verdict
    ordered = sorted(limits, key=lambda item: (item.word or "PASS") != word)
    return reworded(verdict, word, [item.sentence for item in ordered])


def _of_rows(
    rows: Sequence[Row], run: RunInfo, gate: Gate, against: LoadedBaseline | None
) -> Verdict:
    """Return the verdict on the rows as they are."""
    by_bar = partial(judge, left_out=run.left_out)
    if against is None:
        alone = by_bar(rows, gate, run.planned)
        why = unjudged(gate, *_as_asked(run))
        return replace(alone, reasons=(*alone.reasons, why)) if why else alone
    begun = run.baseline if run.baseline and run.baseline.sha256 == against.info.sha256 else None
    if begun is not None and not rows and run.stop is None:
        # Cut while the baseline's own policy ran, or before: nothing is known but what is missing.
        return by_bar(rows, gate, run.planned)
    if begun is not None and begun.moved:
        reasons = (*begun.moved, _mend(run, against))
        return replace(by_bar(rows, gate, run.planned), verdict="INVALID", reasons=reasons)
    comparison = compare(rows, run, against, gate, power_forecast=True)
    by_bar = partial(by_bar, drawn=_drawn(rows, run, against, gate))
    if comparison.again is not None and comparison.again.differing:
        verdict = by_bar(rows, gate, run.planned, against=comparison)
        reasons = (*comparison.again.differing, _mend(run, against))
        return replace(verdict, verdict="INVALID", reasons=reasons, against=comparison)
    planned = run.planned
    if comparison.again is not None and comparison.again.taken_over:
        rows = known_rows(run, against.results)
        planned = Counter(row.scene for row in rows)
        by_bar = partial(judge, left_out=run.left_out)
    verdict = combined(by_bar(rows, gate, planned, against=comparison), comparison)
    return _of_machine(verdict, comparison, gate) if comparison.is_own else verdict


def _of_machine(verdict: Verdict, comparison: Comparison, gate: Gate) -> Verdict:
    """Return the verdict on a baseline's own policy with other bits: no REGRESSED but INVALID.

    The policy is the same, so that a drop is the machine's or the version's. It stays REGRESSED
    where the baseline says itself that the policy is below the bar.
    """
    if verdict.verdict != "REGRESSED":
        return verdict
    if comparison.word == "REGRESSED":
        return replace(verdict, verdict="INVALID")
    if gate.success_rate is not None and comparison.baseline < gate.success_rate:
        return verdict
    why = (
        f"baseline {comparison.baseline_name} has success {comparison.baseline:.3f} for the same "
        "policy: this machine or version changed, not the policy"
    )
    return replace(verdict, verdict="INVALID", reasons=(why, *verdict.reasons))


def _mend(run: RunInfo, against: LoadedBaseline) -> str:
    """Return what to do about a baseline that its own policy contradicts."""
    suite, manifest = _as_asked(run)[0], against.results.manifest
    file = quote(f"{manifest.suite}/{manifest.name}")
    return (
        f"`nw-eval baseline verify {file} --trials 100%` names each row that differs, "
        f"`nw-eval baseline save {quote(suite)} --policy {quote(manifest.policy.name)} "
        f"--name {quote(manifest.name)} --renew` saves it again"
    )


def unjudged(gate: Gate, suite: str, policy: str) -> str | None:
    """Return what a suite asks for beside its bar where nothing is compared; None if nothing.

    Args:
        gate: the suite's settings.
        suite: what names the suite on a command line.
        policy: as above, the policy.
    """
    named = None if gate.baseline == "none" else gate.baseline
    if gate.max_drop is None and named is None:
        return None
    own = "" if named is None else f" ({named} is for the suite's own policy)"
    return (
        f"max_drop {gate.most_drop:g} was ignored: {policy} has no baseline in this suite{own}; "
        f"`nw-eval baseline save {quote(suite)} --policy {quote(policy)}` saves one, "
        "--baseline names it"
    )


def _as_asked(run: RunInfo) -> tuple[str, str]:
    """Return what names suite and policy of a run on a command line."""
    suite = policy = None
    if run.request is not None:
        suite, policy = run.request.suite, run.request.policy
    return str(suite or run.suite.get("name", "SUITE")), policy or run.policy.name


def combined(verdict: Verdict, comparison: Comparison) -> Verdict:
    """Return the verdict on a run that was judged by its suite's bar and against a baseline.

    A run with holes stays INFRASTRUCTURE, one of the baseline's own policy too.

    Args:
        verdict: by the bar; RAN where the suite has none.
        comparison: of the same rows with the baseline.
    """
    word = _word(verdict.verdict, comparison.word)
    # More trials change nothing once the bar has flagged.
    more = (comparison.more,) if comparison.more and word == "INCONCLUSIVE" else ()
    reasons = (*comparison.reasons, *more, *verdict.reasons)
    if verdict.verdict == word != comparison.word:
        reasons = (*verdict.reasons, *comparison.reasons, *more)
    # Where too many trials left the captured volume, both say so.
    once = tuple(dict.fromkeys(reasons))
    return replace(verdict, verdict=word, reasons=once, against=comparison)


def without_baseline(verdict: Verdict, why: str) -> Verdict:
    """Return the verdict on a run that was to be compared with a baseline, and cannot be: INVALID.

    Args:
        verdict: by the bar alone, which is told, and does not count.
        why: in what the baseline fails.
    """
    alone = (f"the bar alone: {verdict.verdict}", *verdict.reasons) if verdict.n else ()
    return replace(verdict, verdict="INVALID", reasons=(why, *alone))


def _drawn(
    rows: Sequence[Row], run: RunInfo, against: LoadedBaseline, gate: Gate
) -> list[Row] | None:
    """Return the rows that bear on a bar, where a part of the trials was enough; else None.

    Trials that were followed for their scenes alone are not among them.
    """
    if run.stop is None:
        return None
    order = setup_of(run, against, gate).order[: run.stop.first]
    return [row for row in by_place(rows, run, order) if row is not None]


def _word(bar: Word, baseline: Word) -> Word:
    if bar in {"INFRASTRUCTURE", "INVALID"}:
        return bar
    both = {bar, baseline}
    if "REGRESSED" in both:
        return "REGRESSED"
    return "INCONCLUSIVE" if "INCONCLUSIVE" in both else "PASS"


def _of_part(rows: Sequence[Row], run: RunInfo, gate: Gate) -> Verdict:
    """Return RAN, INFRASTRUCTURE if a trial has no result, INVALID if the baseline fails here.

    Args:
        rows: of the part's plan, or those that a search chose.
        run: what they are of; `run.shard` says which part.
        gate: the suite's settings, of which no bar and no tier counts.
    """
    bare = gate.model_copy(
        update={"success_rate": None, "max_drop": None, "tiers": {}, "validity": None}
    )
    planned = {scene: count for scene, count in run.planned.items() if count}
    verdict = judge(rows, bare, planned)
    scores = tuple(replace(item, tier=gate.tier(item.scene)) for item in verdict.per_scene)
    word, reasons = verdict.verdict, verdict.reasons
    if run.baseline is not None and run.baseline.moved:
        word, reasons = "INVALID", run.baseline.moved
    elif word == "RAN":
        reasons = ()
    whole = f"{run.shard}: `nw-eval merge` joins all parts and judges the run"
    if run.is_search:
        whole = (
            "a search for a limit chose these trials by their results, so that success over all of "
            "them estimates nothing; limits.md in the folder of the search has the limit"
        )
        verdict = replace(verdict, success=None)
    return replace(verdict, verdict=word, reasons=(*reasons, whole), per_scene=scores)
