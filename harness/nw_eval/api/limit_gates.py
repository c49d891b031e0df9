"""Limits in a gate: what the trials on the ladders show that a suite's gate names.

Trials on ladders are runs of their own, in the folder `limits/` of the run: `<ladder>/candidate`,
and `<ladder>/baseline` where the baseline's own policy had to run, too (`limit_climbs`). What is
judged follows from their rows alone: the same path of trials is followed again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import NwEvalError, StoreError, UsageError
from nw_base.files.inside import what_is
from nw_eval.api.ladder_runs import (
    folder_names,
)
from nw_gate.limits.against import LimitGate, LimitMargins, judge_limit
from nw_gate.limits.find import LimitSearch
from nw_gate.limits.ladder import Ladder, LimitTrial
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline import SavedLimit, Stratum, machine_of
from nw_gate.results.provenance import read_run_info
from nw_gate.results.run_folder import RunFolder
from nw_gate.verdict import LimitFinding

if TYPE_CHECKING:
    from nw_eval.suite import Suite
    from nw_gate.limits.path import TrialPath
    from nw_gate.results.baseline import LoadedBaseline
    from nw_gate.results.provenance import RunInfo
    from nw_gate.settings import Gate, LadderGate
    from nw_gate.verdict import Verdict, Word

MOST_SAVED = 240
"""Trials for a baseline's limit on one ladder, at most: its bounds are surer than a candidate's."""
_WIDTH = 2
_MOST_BYTES = 1_000_000
"""Of `ladder.json`: a hundred rungs have 10 kB."""


def limit_findings(
    folder: RunFolder,
    info: RunInfo,
    suite: Suite,
    against: LoadedBaseline | None,
    verdict: Verdict | None = None,
    *,
    mend: bool = True,
) -> tuple[LimitFinding, ...]:
    """Return what the ladders of a suite's gate show, from the rows of a run's folder.

    Args:
        folder: of the run.
        info: its run.json.
        suite: its suite.
        against: the baseline that it is compared with.
        verdict: on its scenes; None = they may have ended in any way.
        mend: whether a damaged file may be mended from its copy, as of `read_trials`.

    Raises:
        StoreError: rows, or a file beside them, are damaged.
    """
    if info.is_part:
        return ()
    return tuple(
        _finding(name, folder, info, suite, against, verdict, mend=mend)
        for name in suite.gate.limits
    )


def run_limits(folder: RunFolder, info: RunInfo) -> dict[str, Limit]:
    """Return the policy's limit on each ladder that a run climbed.

    Raises:
        StoreError, IncomparableError: as `as_begun`.
    """
    from nw_eval.api.loaded_baselines import kept_baseline
    from nw_eval.api.saved_run import saved_suite

    suite = saved_suite(info)
    if not suite.gate.limits:
        return {}
    found = limit_findings(folder, info, suite, kept_baseline(folder, info))
    return {item.ladder: item.candidate for item in found if item.candidate is not None}


def baseline_search(ladder: Ladder, asked: LadderGate, gate: Gate) -> LimitSearch:
    """Return the search for a baseline's limit, as sure as a gate needs it."""
    return LimitSearch(
        ladder,
        share=asked.share,
        confidence=needed_confidence(asked, gate),
        width=_WIDTH,
        most=MOST_SAVED,
    )


def needed_confidence(asked: LadderGate, gate: Gate) -> float:
    """Return how sure a baseline's bounds must be for a candidate to be found REGRESSED."""
    return _margins(asked, gate, drops=True).baseline_confidence


def asked_ladders(suite: Suite, run: RunInfo) -> tuple[str, ...]:
    """Return the ladders that a run climbs: all, or those that `--scenes` names."""
    globs = None if run.request is None else run.request.scenes
    return tuple(
        name
        for name in suite.gate.limits
        if globs is None or any(fnmatchcase(name, glob) for glob in globs)
    )


def ladder_folders(folder: RunFolder, gate: Gate) -> dict[str, Path]:
    """Return where the runs of each ladder lie."""
    return {
        name: folder.limits / plain
        for name, plain in zip(gate.limits, folder_names(list(gate.limits)), strict=True)
    }


def rules_digest(suite: Suite) -> str:
    """Return the digest of what decides trials on a ladder besides the seed and the scenes."""
    from nw_eval.suite import override
    from nw_gate.results.request import Request

    return override(suite, Request(seed=0)).digest


def is_of(
    saved: SavedLimit, suite: Suite, digests: Mapping[str, str], ladder: str, gate: Gate
) -> bool:
    """Whether a saved limit is of the same trials, and as sure as a gate needs it.

    Args:
        saved: of a baseline.
        suite: of the trials on the ladder.
        digests: of their scenes, by name.
        ladder: its name.
        gate: that judges a candidate's limit.
    """
    asked, limit = gate.limits[ladder], Limit.from_dict(saved.limit)
    known = (saved.suite_digest, saved.scenes, limit.share)
    sure = limit.confidence >= needed_confidence(asked, gate) - 1e-9
    return sure and known == (rules_digest(suite), dict(digests), asked.share)


def holds_here(saved: SavedLimit, run: RunInfo) -> bool:
    """Whether a baseline's limit holds on the machine of a run: it was measured on such a one."""
    checked = None if run.baseline is None else run.baseline.checked
    return saved.machine == machine_of(run) or checked == "bits"


@dataclass(frozen=True, kw_only=True)
class _Climbed:
    """A run on a ladder: what its rungs are, and which trials have results."""

    ladder: Ladder
    cells: Sequence[Stratum]
    """Where the trials of each rung run."""
    title: str
    run: RunInfo
    results: Mapping[LimitTrial, bool]
    searched: bool
    """Whether its trials are those of a search for the limit, not of the gate."""


def _read(at: Path, *, mend: bool) -> _Climbed | None:
    """Return a run on a ladder; None if there is none.

    Raises:
        StoreError: it is damaged.
    """
    from nw_eval.api.saved_run import saved_suite, saved_trials
    from nw_gate.results.ended import read_trials

    folder, file = RunFolder(path=at), at / "ladder.json"
    if what_is(folder.run_json) != "file" or what_is(file) != "file":
        return None
    run = read_run_info(folder.run_json)
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise ValueError("it is too large")  # As what cannot be parsed.
        said: dict[str, Any] = json.loads(file.read_bytes())
        ladder, cells = _rungs(said)
        title, searched = clean(str(said["title"]), at_most=200), said["searched"] is True
    except _DAMAGED as error:
        raise StoreError(f"{file} is damaged: {error}", fix="run again or restore it") from None
    rungs = {cell: number for number, cell in enumerate(cells)}
    rows = read_trials(folder, run, saved_trials(run, saved_suite(run)), mend=mend).rows
    results = {
        LimitTrial(rungs[row.scene, row.perturbation], row.seed_index): row.completed
        for row in rows
        if row.status == "ok" and (row.scene, row.perturbation) in rungs
    }
    return _Climbed(
        ladder=ladder, cells=cells, title=title, run=run, results=results, searched=searched
    )


_DAMAGED = (
    *(OSError, ValueError, TypeError, KeyError, AttributeError),
    *(OverflowError, RecursionError, UsageError),
)
"""What reading a file raises that is none of ours."""


def _rungs(said: Mapping[str, Any]) -> tuple[Ladder, list[Stratum]]:
    """Return what `ladder.json` says of its rungs, and where their trials ran.

    Raises:
        ValueError, TypeError, KeyError, AttributeError, UsageError: it is damaged.
    """
    ladder = Ladder(
        name=clean(str(said["ladder"]), at_most=200),
        unit=clean(str(said["unit"]), at_most=20),
        rungs=tuple(float(value) for value in said["rungs"]),
    )
    cells: list[Stratum] = [
        (str(scene), tuple((str(axis), float(value)) for axis, value in cell.items()))
        for scene, cell in said["cells"]
    ]
    if len(cells) != len(ladder.rungs):
        raise ValueError("its rungs and scenes differ in number")
    return ladder, cells


def compares(
    asked: LadderGate, run: RunInfo, against: LoadedBaseline | None, verdict: Verdict | None
) -> bool:
    """Whether a limit is compared with the baseline's.

    Not where the policy is the baseline's, unless the trials of the scenes have shown that it
    computes other results here.
    """
    from nw_gate.baseline.match import is_baseline

    if asked.max_drop is None or against is None:
        return False
    comparison = None if verdict is None else verdict.against
    is_moved = comparison is not None and comparison.is_own
    return is_moved or not is_baseline(run.policy, against.results)


def limit_path(
    asked: LadderGate, gate: Gate, ladder: Ladder, baseline: Limit | None, *, searched: bool
) -> TrialPath | None:
    """Return what asks for a candidate's trials; None where nothing is to be shown.

    Args:
        asked: of its limit.
        gate: of the suite.
        ladder: that is climbed.
        baseline: limit to compare with; None = none.
        searched: whether its limit is searched for its own sake, too, as `watch` does it.
    """
    if baseline is None and asked.at_least is None:
        if not searched:
            return None
        return LimitSearch(
            ladder, share=asked.share, confidence=gate.confidence, width=_WIDTH, most=asked.trials
        )
    return LimitGate(
        _margins(asked, gate, drops=baseline is not None),
        baseline=baseline,
        ladder=ladder,
        share=asked.share,
        most=asked.trials,
        width=_WIDTH if searched else None,
    )


def _margins(asked: LadderGate, gate: Gate, *, drops: bool) -> LimitMargins:
    """Return what must be shown of a limit; without `drops` its bar alone."""
    return LimitMargins(
        max_drop=asked.max_drop if drops else None,
        tolerate=asked.tolerate if drops else 0.0,
        at_least=asked.at_least,
        confidence=gate.confidence,
        false_alarm=gate.false_alarm,
        ladders=gate.shared,
    )


def _finding(
    name: str,
    folder: RunFolder,
    info: RunInfo,
    suite: Suite,
    against: LoadedBaseline | None,
    verdict: Verdict | None,
    *,
    mend: bool,
) -> LimitFinding:
    """Return what one ladder shows."""
    asked, at = suite.gate.limits[name], ladder_folders(folder, suite.gate)[name]
    own = _read(at / "candidate", mend=mend)
    candidate = baseline = None
    if own is None:
        word, sentence = _unclimbed(name, info, suite, against, verdict)
    else:
        shown = _shown(name, own, at, info, suite, against, verdict, mend=mend)
        word, sentence, candidate, baseline = shown
    return LimitFinding(
        ladder=name,
        title=name if own is None else own.title,
        word=word,
        sentence=f"{name}: {sentence}".rstrip("."),
        candidate=candidate,
        baseline=baseline,
        at_least=asked.at_least,
        max_drop=asked.max_drop,
    )


_UNJUDGED = "max_drop is not judged without a baseline"
_OWN = "the policy is the baseline's own, so that nothing can have dropped"


def _unclimbed(
    name: str,
    info: RunInfo,
    suite: Suite,
    against: LoadedBaseline | None,
    verdict: Verdict | None,
) -> tuple[Word | None, str]:
    """Return the word and the sentence on a ladder on which no trial ran."""
    asked = suite.gate.limits[name]
    if asked.at_least is None and against is None:
        return None, _UNJUDGED
    if asked.at_least is None and not compares(asked, info, against, verdict):
        return "PASS", "the limit is the baseline's, as the policy is"
    if name not in asked_ladders(suite, info):
        return None, "not climbed, as --scenes leaves it out"
    if verdict is not None and verdict.verdict in {"INVALID", "INFRASTRUCTURE"}:
        return None, f"not climbed, as the run is {verdict.verdict} without it"
    return "INFRASTRUCTURE", "its trials are missing; --resume runs them"


def _shown(
    name: str,
    own: _Climbed,
    at: Path,
    info: RunInfo,
    suite: Suite,
    against: LoadedBaseline | None,
    verdict: Verdict | None,
    *,
    mend: bool,
) -> tuple[Word | None, str, Limit | None, Limit | None]:
    """Return word, sentence and the limits of candidate and baseline on a ladder with trials."""
    asked, baseline = suite.gate.limits[name], None
    if fault := _fault_of(own, info, suite):
        raise StoreError(f"{at / 'candidate'} is not of this run: {fault}", fix="run again")
    if compares(asked, info, against, verdict):
        assert against is not None, "there is something to compare with"
        baseline = _baseline_limit(name, suite, at, own, info, against, mend=mend)
        if baseline is None:
            why = "the baseline has no limit that holds here; run again"
            return "INFRASTRUCTURE", why, None, None
    path = limit_path(asked, suite.gate, own.ladder, baseline, searched=own.searched)
    if path is None:
        return None, _UNJUDGED, None, None
    whole, limit = path.follow(own.results), path.limit
    if not whole and not _is_begun_with(info, against):
        why = "the trials that this baseline asks for did not run"
        return "INCONCLUSIVE", why, limit, baseline
    if not whole:
        why = "trials are missing or ended in errors; --resume runs them"
        return "INFRASTRUCTURE", why, limit, baseline
    if baseline is None and asked.at_least is None:
        return None, _UNJUDGED, limit, baseline
    margins = _margins(asked, suite.gate, drops=baseline is not None)
    shown = judge_limit(limit, margins, baseline)
    sentence = shown.sentence.removeprefix(f"{name}: ").rstrip(".")
    if asked.max_drop is not None and baseline is None:
        sentence += f"; {_UNJUDGED if against is None else _OWN}"
    return shown.word, sentence, limit, baseline


def _fault_of(own: _Climbed, info: RunInfo, suite: Suite) -> str:
    """Return what of a run on a ladder is not as of the run that it lies in; empty if nothing."""
    from nw_eval.api.saved_run import saved_suite
    from nw_eval.suite.ladders import climbed_episode
    from nw_sim.axes import COMMANDED
    from nw_sim.ladders import ladder_named

    theirs, ours = own.run.policy, info.policy
    if (theirs.checkpoint_digest, theirs.card_digest) != (
        ours.checkpoint_digest,
        ours.card_digest,
    ):
        return f"its policy is {theirs.name} ({theirs.short_digest})"
    rules = saved_suite(own.run)
    commanded = any(axis in COMMANDED for _, cell in own.cells for axis, _ in cell)
    if rules.episode != climbed_episode(suite.episode, is_commanded=commanded):
        return "its episode is another one"
    for rule in ("robot", "protocol", "seed", "render"):
        if getattr(rules, rule) != getattr(suite, rule):
            return f"its {rule} is another one"
    try:
        known = {rung.scene: rung.value for rung in ladder_named(own.ladder.name, suite.base).rungs}
    except (NwEvalError, OSError):  # It need not be here for its trials to be judged.
        return ""
    if len(known) == len(own.ladder.rungs):
        for (scene, _), value in zip(own.cells, own.ladder.rungs, strict=True):
            if known.get(scene, value) != value:
                return f"{scene} is the rung {known[scene]:g} of {own.ladder.name}, not {value:g}"
    return ""


def _is_begun_with(info: RunInfo, against: LoadedBaseline | None) -> bool:
    """Whether a run was begun with the baseline that it is judged by."""
    begun = None if info.baseline is None else info.baseline.sha256
    return begun == (None if against is None else against.info.sha256)


def _baseline_limit(
    name: str,
    suite: Suite,
    at: Path,
    own: _Climbed,
    info: RunInfo,
    against: LoadedBaseline,
    *,
    mend: bool,
) -> Limit | None:
    """Return the baseline's limit: measured beside the run, or as it was saved; None if neither."""
    from nw_eval.api.saved_run import saved_suite
    from nw_gate.baseline.match import is_baseline

    asked, beside = suite.gate.limits[name], _read(at / "baseline", mend=mend)
    if beside is not None and is_baseline(beside.run.policy, against.results):
        search = baseline_search(beside.ladder, asked, suite.gate)
        return search.limit if search.follow(beside.results) else None
    saved = against.results.manifest.limits.get(name)
    if saved is None or not holds_here(saved, info):
        return None
    digests = {scene: each.digest for scene, each in own.run.scenes.items()}
    if not is_of(saved, saved_suite(own.run), digests, name, suite.gate):
        return None
    return Limit.from_dict(saved.limit)
