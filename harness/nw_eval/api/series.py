"""A series of checkpoints: which of them is flagged first."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nw_eval.api.paths import as_path
from nw_eval.api.renamed import keywords_were
from nw_eval.engine.how import How

if TYPE_CHECKING:
    from os import PathLike

    from nw_eval.api.reports import RunReport
    from nw_gate.bisection import Bisection, Decision
    from nw_gate.results.request import Request
    from nw_gate.settings import Gate

_REPORTS = Path("reports")


@dataclass(frozen=True, kw_only=True)
class BisectedSeries:
    """A series, as far as it was judged against the checkpoint that was known to be good."""

    baseline: str
    """Of the good one."""
    checkpoints: tuple[str, ...]
    """In order of age, the bad one last."""
    runs: Mapping[int, RunReport]
    """By position in the series: those that were judged."""
    found: Bisection | None
    """None if the search was interrupted."""
    folder: Path

    @property
    def trials(self) -> int:
        """Trials that it took, without those of the baseline."""
        return sum(len(run.rows) for run in self.runs.values())

    @property
    def exit_code(self) -> int:
        """1 if one was flagged, 0 if none was, 3 if nothing was decided, 130 if interrupted."""
        if self.found is None:
            return 130
        if self.found.first_fallen is not None:
            return 1
        return 3 if "INCONCLUSIVE" in self.found.words.values() else 0


@keywords_were(starts="baseline_trials")
def bisect(
    suite: str | Path,
    checkpoints: Sequence[str | Path],
    *,
    good: str | Path,
    bad: str | Path,
    policy: str | None = None,
    everyone: bool = False,
    baseline_trials: int | None = None,
    out: str | PathLike[str] | None = None,
    progress: Callable[[str, str], None] | None = None,
    **changes: Any,
) -> BisectedSeries:
    """Find which checkpoint of a series is the first that the gate flags as worse than a good one.

    Each that is asked for is judged against the baseline of the good one, trial by trial, as `run`
    does it, by success and by each of `gate.scores` that has a `max_drop`. The suite's bars are
    left out, since all of a series may lie on one side of one.

    Checkpoints are files of weights for the card of `policy`, or bundles; or the folder of a
    training, which stands for its checkpoints in order of their steps, after `good` and before
    `bad` where these are among them.

    Args:
        suite: a suite file or the name of a shipped one.
        checkpoints: the series between the good and the bad one, oldest first.
        good: a baseline, or the checkpoint before the series; its baseline is saved first.
        bad: the checkpoint after the series.
        policy: card that describes these checkpoints (default: the suite's policy).
        everyone: test every checkpoint: a search alone rarely detects a series that is not
            monotone.
        baseline_trials: trials per scene of a new baseline (default: as `baseline save`).
        out: the folder of the runs; an interrupted search there is resumed (default:
            `reports/bisect-<suite>`).
        progress: receives the checkpoint that is tested, and its verdict.
        changes: of `Request`: scenes, trials (the most of each scene, on average), seed, render,
            time_limit, memory_limit...; of `How`: workers, cache, listener.

    Raises:
        UsageError, SuiteError, PolicyError: a checkpoint or the suite cannot be used.
        IncomparableError: the baseline does not hold here, or moved on this machine.
        TrialError: a trial produced no result.
        StoreError: results cannot be written.
    """
    from nw_eval.suite import load_suite
    from nw_gate import bisection
    from nw_gate.results.request import Request

    out = as_path(out)
    series = tuple(str(one) for one in (*_of_folders(checkpoints, good, bad), bad))
    read = load_suite(suite)
    how = How.taken_from(changes, "workers", "cache", "listener")
    request = Request.of(suite, policy=policy, record="none", **changes)
    for one in (*series, *(() if _is_baseline(good, read.name) else (good,))):
        _check_place(one)
    folder = out or _REPORTS / f"bisect-{read.name}"
    baseline = _baseline_of(good, request, read.name, baseline_trials, how)
    runs: dict[int, RunReport] = {}

    def word(index: int) -> Decision:
        name = f"{index + 1:02d}-{re.sub(r'[^A-Za-z0-9_.]+', '-', Path(series[index]).stem)}"
        asked_for = _request_for(request, series[index], baseline)
        runs[index] = _judged(asked_for, folder / name, how)
        finding = _finding(runs[index])
        if progress is not None:
            progress(series[index], finding)
        return finding

    found = None
    with suppress(_InterruptedSeriesError):
        found = bisection.bisect(len(series), word, everyone=everyone)
    return BisectedSeries(
        baseline=baseline,
        checkpoints=series,
        runs=dict(sorted(runs.items())),
        found=found,
        folder=folder,
    )


class _InterruptedSeriesError(Exception):
    """A signal ended the run of a checkpoint."""


def _is_baseline(good: str | Path, suite: str) -> bool:
    """Whether a name or path means a baseline, and no checkpoint."""
    from nw_base.errors import UsageError
    from nw_gate.results.baseline_file import find_baseline

    try:
        return find_baseline(good, suite=suite).suffix == ".parquet"
    except UsageError:
        return False


def _of_folders(
    checkpoints: Sequence[str | Path], good: str | Path, bad: str | Path
) -> list[str | Path]:
    """Return a series with the checkpoints of a training in place of its folder.

    Raises:
        UsageError: a folder is neither a policy's nor one with checkpoints.
    """
    from nw_base.errors import UsageError
    from nw_eval.api.watching import checkpoints_in
    from nw_policies.cards.load import CARD_FILE

    series: list[str | Path] = []
    for each in checkpoints:
        if not Path(each).is_dir() or (Path(each) / CARD_FILE).exists():
            series.append(each)
            continue
        found = checkpoints_in(Path(each))
        there = {path.resolve(): index for index, path in enumerate(found)}
        first = there.get(Path(good).resolve(), -1) + 1
        last = there.get(Path(bad).resolve(), len(found))
        found = found[first:last]
        if not there:
            raise UsageError(
                f"{each} holds no card and no checkpoint",
                fix="name files of weights, or a folder with some such as model_1500.pt",
            )
        series += found
    return series


def _check_place(checkpoint: str | Path) -> None:
    """Refuse what is neither a file of weights nor a policy, before anything runs.

    Raises:
        UsageError: there is no such file.
        PolicyError: there is no such bundle.
    """
    from nw_policies import find_card

    if not Path(checkpoint).is_file():
        find_card(str(checkpoint))


def _request_for(request: Request, checkpoint: str, baseline: str | None = None) -> Request:
    """Return the request for one checkpoint: weights for a policy's card, or its own policy."""
    if Path(checkpoint).is_file() and Path(checkpoint).suffix not in {".yaml", ".yml"}:
        return replace(request, checkpoint=Path(checkpoint), baseline=baseline)
    return replace(request, policy=checkpoint, baseline=baseline)


def _baseline_of(
    good: str | Path, request: Request, suite: str, starts: int | None, how: How
) -> str:
    """Return the baseline of the good checkpoint, saved first if there is none.

    Raises:
        IncomparableError: there is a baseline of its name, of something else.
    """
    from nw_base.errors import IncomparableError
    from nw_eval.api.baselines_saved import save_baseline

    if _is_baseline(good, suite):
        return str(good)
    wanted = _request_for(request, str(good))
    saved = save_baseline(
        suite if request.suite is None else request.suite,
        policy=wanted.policy,
        checkpoint=wanted.checkpoint,
        trials=starts,
        name=re.sub(r"[^A-Za-z0-9_.]+", "-", Path(good).stem),
        note="the good end of a bisection",
        held_out=True,
        render=request.render,
        time_limit=request.time_limit,
        memory_limit=request.memory_limit,
        allow_code=request.allow_code,
        workers=how.workers,
        cache=how.cache,
        listener=how.listener,
    )
    if saved.action == "kept":
        raise IncomparableError(
            f"{saved.file} is there already, and is not a baseline of {good} as it is here",
            fix="rename the checkpoint or remove the baseline, or name a baseline with --good",
        )
    return str(saved.file)


def _judged(request: Request, folder: Path, how: How) -> RunReport:
    """Return the judged run of a checkpoint, begun or gone on with."""
    from nw_eval.api.continuing import continued
    from nw_eval.api.plans import plan_of
    from nw_eval.api.runs import judged, roll_out
    from nw_eval.suite import draft_of, load_suite
    from nw_gate.results.journal import has_begun

    assert request.suite is not None, "a series is of a suite"
    begun = has_begun(folder / "journal.jsonl")
    if begun:
        plan = continued(folder, replace(request, suite=None))
    else:
        suite = load_suite(request.suite)
        gate = _without_bars(suite.gate)
        plan = plan_of(request, draft_of(suite.model_copy(update={"gate": gate})))
    return judged(
        roll_out(
            plan,
            how,
            out=None if begun else folder,
            resume=folder if begun else None,
        )
    )


def _without_bars(gate: Gate) -> Gate:
    """Return a gate that compares with its baseline alone, in success, scores and limits."""
    scores = {
        name: asked.model_copy(update={"bar": None})
        for name, asked in gate.scores.items()
        if asked.max_drop is not None
    }
    limits = {
        name: asked.model_copy(update={"at_least": None})
        for name, asked in gate.limits.items()
        if asked.max_drop is not None
    }
    return gate.model_copy(update={"success_rate": None, "scores": scores, "limits": limits})


def _finding(run: RunReport) -> Decision:
    """Return what a run found of its checkpoint: the worst word on success and on its scores.

    Raises:
        IncomparableError: the baseline's own policy moved on this machine.
        TrialError: trials have no result, or another one than the cache says.
        _InterruptedSeriesError: a signal ended it.
    """
    from nw_base.errors import IncomparableError, TrialError

    verdict = run.verdict
    if run.interrupted and verdict.verdict == "INFRASTRUCTURE":
        raise _InterruptedSeriesError
    if verdict.verdict == "INVALID":
        raise IncomparableError(
            f"no failure is attributed to {run.info.policy.name}: {'; '.join(verdict.reasons)}",
            fix="renew the baseline of the good checkpoint",
        )
    if verdict.verdict == "INFRASTRUCTURE" or verdict.against is None:
        is_wrong = run.info.cache is not None and run.info.cache.differing
        raise TrialError(
            f"{run.typed_folder}: {'; '.join(verdict.reasons)}",
            fix=f"remove {run.typed_folder}, and give the same command again"
            if is_wrong
            else "run the same command again to resume",
        )
    words = [verdict.against.word, *(item.word for item in verdict.scores)]
    words += [item.word for item in verdict.limits]
    if "REGRESSED" in words:
        return "REGRESSED"
    return "INCONCLUSIVE" if "INCONCLUSIVE" in words else "PASS"
