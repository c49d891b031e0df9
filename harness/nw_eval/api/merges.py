"""Merging: the parts of a run become the run, and that is judged. Runs nothing."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import IncomparableError, StoreError
from nw_base.plural import plural

if TYPE_CHECKING:
    from nw_eval.api.reports import RunReport
    from nw_eval.suite import Trial
    from nw_gate.results.baseline import LoadedBaseline
    from nw_gate.results.merge import MergedArm, MergeSource
    from nw_gate.results.row import Row


def merge(runs: Sequence[str | Path], *, out: str | Path, baseline: str | None = None) -> RunReport:
    """Put the parts of a run together in one folder, and judge it as `judge` does.

    The rows are those that the run would have without parts, its control's too. Folders may be
    named twice, in any order, and one that was merged before may be among them: the rows are the
    same, byte for byte.

    `out` is there whole or not at all. Where it holds these rows already, they are only judged
    again.

    Args:
        runs: the folders of all shards, in any order.
        out: the folder of the merged run.
        baseline: the baseline to compare with: a name, a file, or `none` (default: the baseline the
            run was started with, else the suite's).

    Raises:
        UsageError: there is nothing to merge, one is not a run folder or that of a whole run, there
            is no such baseline, or `out` holds something else.
        IncomparableError: two are not parts of one run, each field is named; or, once the rows are
            merged, as `judge`.
        StoreError: a part or trials of one are missing, a trial has two different results, a folder
            is damaged, or `out` cannot be written.
    """
    from nw_eval.api.loaded_baselines import judging_baseline
    from nw_eval.api.reports import judged_rows, written
    from nw_eval.api.saved_run import saved_suite
    from nw_gate.results.ended import RunRows, wanted
    from nw_gate.results.merge import MergedArm, joined, merged_info, write_merged
    from nw_gate.results.run_folder import RunFolder

    folder = RunFolder(path=Path(out).resolve())
    sources, plan, remarks = _read(runs)
    first = sources[0]
    held = joined(sources, wanted(plan, first.info.stop), first.parts[0].shard.count)
    info = merged_info(sources, plan, name=folder.id, command=tuple(sys.argv))
    arm = MergedArm(info=info, held=held, sources=sources)
    control = _merged_control(sources, plan)
    info, lost = write_merged(folder.path, arm, _baseline(sources), control)
    suite = saved_suite(info)
    merged = RunRows(rows=tuple(one.row for one in held), remarks=(*remarks, *lost))
    del sources, plan, first, held, arm, control  # A million trials have hundreds of megabytes.
    against = judging_baseline(folder, info, suite, baseline)
    return written(judged_rows(folder, info, suite, against, merged), folder.report_md)


def _read(
    runs: Sequence[str | Path],
) -> tuple[list[MergeSource], tuple[Trial, ...], list[str]]:
    """Return what is merged, the trials of the whole plan in order, and remarks."""
    from nw_eval.api.saved_run import saved_suite, whole_plan
    from nw_eval.engine.order import in_order, plan_digest
    from nw_gate.results.ended import read_trials, wanted
    from nw_gate.results.merge import MergeSource, check_parts
    from nw_gate.results.provenance import read_run_info
    from nw_gate.results.request import Shard
    from nw_gate.results.run_folder import open_run_folder

    folders = [open_run_folder(Path(run)) for run in runs]
    opened = [MergeSource(folder=each, info=read_run_info(each.run_json)) for each in folders]
    check_parts(opened)
    first = opened[0]
    ordered = in_order(whole_plan(first.info, saved_suite(first.info)))
    if plan_digest(ordered) != first.parts[0].shard.plan:
        raise StoreError(
            f"{first}: its plan is not that of its suite and its scenes",
            fix="merge folders that nw-eval wrote",
        )
    trials = wanted(ordered, first.info.stop)
    sources: list[MergeSource] = []
    remarks: list[str] = []
    for source in opened:
        shard = source.info.shard
        own = trials
        if shard is not None:
            own = Shard(index=shard.index, count=shard.count).share(trials)
        recorded = read_trials(source.folder, source.info, own)
        sources.append(replace(source, rows=recorded.rows))
        remarks += [f"{source}: {remark}" for remark in recorded.remarks]
    return sources, ordered, remarks


def _merged_control(sources: Sequence[MergeSource], ordered: Sequence[Trial]) -> MergedArm | None:
    """Return the run of the baseline's own policy beside that of all parts; None if it had none.

    Args:
        sources: parts of one run, all of which found the same of the baseline on their machine.
        ordered: the trials of the whole plan.

    Raises:
        IncomparableError: the policy had other bits in one part than in another.
        StoreError: a part lacks trials of its control, or they are damaged.
        TrialError: one is an error.
    """
    from nw_base.files.inside import what_is
    from nw_eval.api.loaded_baselines import control_rows
    from nw_gate.results.merge import MergedArm, MergeSource, check_beside, joined, merged_info
    from nw_gate.results.provenance import StopInfo, read_run_info
    from nw_gate.results.request import Shard

    known = sources[0].info.baseline
    is_control = known is not None and known.checked == "control"
    arms: list[MergeSource] = []
    of_parts: list[tuple[MergeSource, Sequence[Row]]] = []
    for source in sources:
        nested, shard = source.folder.baseline, source.info.shard
        if not is_control and what_is(nested.run_json) != "file":
            continue
        own = read_run_info(nested.run_json)
        rows = control_rows(nested, own, source.folder)
        share = (
            ordered if shard is None else Shard(index=shard.index, count=shard.count).share(ordered)
        )
        names = {row.trial_id for row in rows}
        lacking = [trial.id for trial in share if trial.id not in names]
        if is_control and lacking:
            raise StoreError(
                f"{source} lacks {plural(len(lacking), 'trial')} of its control, the baseline's "
                f"policy {own.policy.name}, first {lacking[0]}",
                fix=f"--resume {source.folder.path} runs them",
            )
        own = own.model_copy(update={"shard": shard})
        of_parts.append((source, rows))
        arms.append(MergeSource(folder=nested, info=own, rows=rows))
    if not arms:
        return None
    check_beside(of_parts)
    there = {row.trial_id for arm in arms for row in arm.rows}
    trials = [trial for trial in ordered if trial.id in there]
    info = merged_info(arms, ordered, name=arms[0].folder.id, command=tuple(sys.argv))
    stop = None
    if len(trials) < len(ordered):
        places = tuple(trial.place for trial in trials if trial.place is not None)
        counts = dict(sorted(Counter(trial.scene for trial in trials).items()))
        stop = StopInfo(first=0, followed=places, trials=counts)
    info = info.model_copy(update={"stop": stop})
    return MergedArm(info=info, held=joined(arms, trials, count=1), sources=arms)


def _baseline(sources: Sequence[MergeSource]) -> LoadedBaseline | None:
    """Return the baseline that the parts were begun against, if any of them can still show it."""
    from nw_eval.api.loaded_baselines import kept_baseline

    for source in sources:
        try:
            return kept_baseline(source.folder, source.info)
        except (IncomparableError, StoreError):  # Judging reports it, if it is missing.
            continue
    return None
