"""Limits in a gate: what the trials on the ladders show that a suite's gate names.

Trials on ladders are runs of their own, in the folder `limits/` of the run: `<ladder>/candidate`,
and `<ladder>/baseline` where the baseline's own policy had to run, too (`limit_climbs`). What is
judged follows from their rows alone: the same path of trials is followed again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_base.clean import clean
from nw_base.errors import StoreError, UsageError
from nw_base.files.inside import what_is
from nw_eval.api.ladder_runs import (
    folder_names,
)
from nw_gate.limits.against import BASELINE_CONFIDENCE, LimitGate, LimitMargins
from nw_gate.limits.find import LimitSearch
from nw_gate.limits.ladder import Ladder, LimitTrial
from nw_gate.limits.limit import Limit
from nw_gate.results.baseline import SavedLimit, Stratum, machine_of
from nw_gate.results.provenance import read_run_info
from nw_gate.results.run_folder import RunFolder
from nw_gate.verdict import LimitFinding

if TYPE_CHECKING:
    from nw_eval.suite import Suite
    from nw_gate.results.baseline import LoadedBaseline
    from nw_gate.results.provenance import RunInfo
    from nw_gate.settings import Gate, LadderGate
    from nw_gate.verdict import Verdict

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


def baseline_search(ladder: Ladder, share: float) -> LimitSearch:
    """Return the search for a baseline's limit, by its own name in a folder of candidates, too."""
    return LimitSearch(
        ladder, share=share, confidence=BASELINE_CONFIDENCE, width=_WIDTH, most=MOST_SAVED
    )


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


def holds_here(saved: SavedLimit, run: RunInfo) -> bool:
    """Whether a baseline's limit holds on the machine of a run: it was measured on such a one."""
    checked = None if run.baseline is None else run.baseline.checked
    return saved.machine == machine_of(run) or checked == "bits"


@dataclass(frozen=True, kw_only=True)
class _Climbed:
    """A run on a ladder: what its rungs are, and which trials have results."""

    ladder: Ladder
    title: str
    run: RunInfo
    results: Mapping[LimitTrial, bool]


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
        ladder, title, cells = _rungs(file)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, UsageError) as error:
        raise StoreError(f"{file} is damaged: {error}", fix="run again or restore it") from None
    rungs = {cell: number for number, cell in enumerate(cells)}
    rows = read_trials(folder, run, saved_trials(run, saved_suite(run)), mend=mend).rows
    results = {
        LimitTrial(rungs[row.scene, row.perturbation], row.seed_index): row.completed
        for row in rows
        if row.status == "ok" and (row.scene, row.perturbation) in rungs
    }
    return _Climbed(ladder=ladder, title=title, run=run, results=results)


def _rungs(file: Path) -> tuple[Ladder, str, list[Stratum]]:
    """Return what `ladder.json` says: the ladder, its title, and where each rung's trials ran.

    Raises:
        OSError, ValueError, TypeError, KeyError, AttributeError, UsageError: it is damaged.
    """
    if file.stat().st_size > _MOST_BYTES:
        raise ValueError("it is too large")
    said: dict[str, Any] = json.loads(file.read_bytes())
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
    return ladder, clean(str(said["title"]), at_most=200), cells


def compares(asked: LadderGate, run: RunInfo, against: LoadedBaseline | None) -> bool:
    """Whether a limit is compared with the baseline's: not where the policy is the baseline's."""
    from nw_gate.baseline.match import is_baseline

    if asked.max_drop is None or against is None:
        return False
    return not is_baseline(run.policy, against.results)


def limit_gate(
    asked: LadderGate, gate: Gate, ladder: Ladder, baseline: Limit | None
) -> LimitGate | None:
    """Return what asks for trials and judges them; None where nothing is to be shown."""
    drops = asked.max_drop is not None and baseline is not None
    if not drops and asked.at_least is None:
        return None
    margins = LimitMargins(
        max_drop=asked.max_drop if drops else None,
        tolerate=asked.tolerate if drops else 0.0,
        at_least=asked.at_least,
        confidence=gate.confidence,
        false_alarm=gate.false_alarm,
        ladders=gate.shared,
    )
    return LimitGate(
        margins, baseline=baseline, ladder=ladder, share=asked.share, most=asked.trials
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
    title = name if own is None else own.title

    def found(sentence: str, word: Any = None, **limits: Limit | None) -> LimitFinding:
        return LimitFinding(
            ladder=name,
            title=title,
            word=word,
            sentence=f"{name}: {sentence}".rstrip("."),
            at_least=asked.at_least,
            max_drop=asked.max_drop,
            **limits,
        )

    if own is None and name not in asked_ladders(suite, info):
        return found("not climbed, as --scenes leaves it out")
    same = asked.max_drop is not None and against is not None
    same = same and not compares(asked, info, against)
    if asked.at_least is None and same:
        return found("the limit is the baseline's, as the policy is", "PASS")
    if asked.at_least is None and against is None:
        return found(f"max_drop {asked.max_drop:g} is not judged without a baseline")
    if own is None:
        if verdict is not None and verdict.verdict in {"INVALID", "INFRASTRUCTURE"}:
            return found(f"not climbed, as the run is {verdict.verdict} without it")
        return found("its trials are missing; --resume runs them", "INFRASTRUCTURE")
    baseline = None
    if compares(asked, info, against):
        assert against is not None, "there is something to compare with"
        baseline = _baseline_limit(name, asked, at, own, info, against, mend=mend)
        if baseline is None:
            return found("the baseline has no limit that holds here; run again", "INFRASTRUCTURE")
    gate = limit_gate(asked, suite.gate, own.ladder, baseline)
    assert gate is not None, "there is something to show"
    whole = gate.follow(own.results)
    shown = gate.verdict
    limits = {"candidate": shown.candidate, "baseline": baseline}
    if not whole:
        return found(
            "trials are missing or ended in errors; --resume runs them", "INFRASTRUCTURE", **limits
        )
    return found(shown.sentence.removeprefix(f"{name}: "), shown.word, **limits)


def _baseline_limit(
    name: str,
    asked: LadderGate,
    at: Path,
    own: _Climbed,
    info: RunInfo,
    against: LoadedBaseline,
    *,
    mend: bool,
) -> Limit | None:
    """Return the baseline's limit: measured beside the run, or as it was saved; None if neither."""
    from nw_eval.api.saved_run import saved_suite

    beside = _read(at / "baseline", mend=mend)
    if beside is not None:
        search = baseline_search(beside.ladder, asked.share)
        return search.limit if search.follow(beside.results) else None
    saved = against.results.manifest.limits.get(name)
    if saved is None or not holds_here(saved, info):
        return None
    digests = {scene: each.digest for scene, each in own.run.scenes.items()}
    known = (saved.suite_digest, saved.scenes, saved.limit.get("share"))
    if known != (rules_digest(saved_suite(own.run)), digests, asked.share):
        return None
    return Limit.from_dict(saved.limit)
