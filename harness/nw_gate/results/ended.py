"""A run's rows, from whichever of its two copies is whole: the journal, and the Parquet file.

The journal has every row from the moment on which its trial ended. trials.parquet has those that
are judged, once the run has ended, and run.json has the digests of both. A copy that is damaged
costs nothing while the other is whole; what neither can show is no result. Rows count that are of
the trials which the run planned, if they are what they say.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from hashlib import file_digest
from typing import Protocol, TypeVar

from nw_base.errors import StoreError
from nw_base.files.inside import regular
from nw_base.plural import plural
from nw_gate.results.evidence import Digests, row_leaf, run_leaf, write_digests
from nw_gate.results.journal import last_sum, read_journal
from nw_gate.results.provenance import RunInfo, StopInfo, write_run_info
from nw_gate.results.row import Row, rows_digest, self_contradiction
from nw_gate.results.run_folder import RunFolder

_NAMED = 3  # trials that a sentence names before it says "and more"


@dataclass(frozen=True, kw_only=True)
class RunRows:
    """The rows of a run that may be judged."""

    rows: tuple[Row, ...]
    remarks: tuple[str, ...]  # Sentences: what was left out, what was damaged.


def write_trials(folder: RunFolder, info: RunInfo, rows: Iterable[Row]) -> RunInfo:
    """Write the rows that are judged, and their digests; return what run.json is to say.

    Raises:
        StoreError: a file cannot be written.
    """
    kept = list(rows)
    leaves = {row.trial_id: row_leaf(row) for row in kept}
    digests = Digests(run=run_leaf(info), rows=leaves)
    write_digests(folder.digests, digests)
    ended = _write_table(folder, info, kept, rows_digest(kept))
    sums = {"journal_sum": last_sum(folder.journal), "merkle_root": digests.root}
    return ended.model_copy(update=sums)


def _write_table(folder: RunFolder, info: RunInfo, rows: Sequence[Row], digest: str) -> RunInfo:
    """Write trials.parquet alone: what a run was when it ended is not said anew."""
    from nw_gate.results.parquet import write_rows

    ended = info.model_copy(update={"rows_digest": digest})
    metadata = {
        "run_id": ended.id,
        "suite_digest": ended.suite_digest,
        "git": ended.code.commit,
        "code_digest": ended.code.digest,
        "engine": f"mujoco {ended.versions.get('mujoco', 'unknown')}",
        "renderer": ended.renderer,
        "rows_digest": ended.rows_digest,
        **({"labels": json.dumps(ended.labels)} if ended.labels else {}),
    }
    write_rows(folder.trials, rows, metadata)
    return ended.model_copy(update={"trials_sha256": _sha256(folder)})


def read_trials(
    folder: RunFolder,
    info: RunInfo,
    trials: Sequence[PlannedTrial],
    *,
    spare: Collection[str] = (),
    mend: bool = True,
) -> RunRows:
    """Return the rows of a run's planned trials; writes trials.parquet again if it is damaged.

    Args:
        folder: the run's folder.
        info: its run.json.
        trials: its plan.
        spare: trials by id that the run may have beyond those that were enough: nothing is said of
            them.
        mend: whether anything may be written.

    Raises:
        StoreError: neither copy of the rows is whole, what is there is of another run, or a row
            contradicts itself.
    """
    remarks: list[str] = []
    try:
        contents = read_journal(folder.journal)
        if contents.last_sum == info.journal_sum:
            rows, others = _of_names(contents.rows, trials)
        else:
            rows, others = _checked(contents.rows, info, trials, folder.journal.name)
    except StoreError as error:
        if not info.rows_digest:
            raise
        rows = _from_parquet(folder, info, trials, error)
        _check_each(rows, info)
        return RunRows(rows=tuple(rows), remarks=(f"judged from trials.parquet: {error.message}",))
    _check_each(rows, info)
    if contents.dropped:
        remarks.append(contents.dropped)
    if foreign := [row for row in others if row.trial_id not in spare]:
        remarks.append(_left_out(foreign))
    if info.rows_digest and mend:
        remarks += _mended(folder, info, rows)
    return RunRows(rows=tuple(rows), remarks=tuple(remarks))


def _check_each(rows: Sequence[Row], info: RunInfo) -> None:
    """Refuse rows that contradict themselves, whatever sums they have.

    Raises:
        StoreError: naming the first one, and in what.
    """
    wrong = [(row.trial_id, why) for row in rows if (why := self_contradiction(row)) is not None]
    if wrong:
        name, why = wrong[0]
        more = f", and {plural(len(wrong) - 1, 'more row')}" if len(wrong) > 1 else ""
        raise StoreError(
            f"run {info.id} cannot be judged: the row of trial {name} contradicts itself ({why})"
            f"{more}",
            fix="run again or restore the run's folder",
        )


def _from_parquet(
    folder: RunFolder, info: RunInfo, trials: Sequence[PlannedTrial], fault: StoreError
) -> list[Row]:
    try:
        return _parquet(folder, info, trials)
    except StoreError as error:
        raise StoreError(f"{fault.message}; and {error}") from None


def _parquet(folder: RunFolder, info: RunInfo, trials: Sequence[PlannedTrial]) -> list[Row]:
    from nw_gate.results.tables import read_rows_apart

    return _checked(read_rows_apart(folder.trials), info, trials, folder.trials.name)[0]


def _mended(folder: RunFolder, info: RunInfo, rows: list[Row]) -> list[str]:
    """Write trials.parquet again if it is not the file that run.json means; tell of it."""
    if _sha256(folder) == info.trials_sha256:
        return []
    if folder.trials.is_fifo():  # It may never be read.
        return ["judged from the journal: trials.parquet is a pipe"]
    fault = "trials.parquet is missing or damaged (its SHA-256 is not the one in run.json)"
    try:
        rewritten = _write_table(folder, info, rows, rows_digest(rows))
        if rewritten != info:  # Another version of Arrow writes the same rows as other bytes.
            write_run_info(folder.run_json, rewritten)
    except StoreError as error:
        return [f"judged from the journal: {fault}; {error.message}"]
    return [f"judged from the journal, and trials.parquet written again from it: {fault}"]


def _sha256(folder: RunFolder) -> str:
    """Return the hex digest of trials.parquet; empty if there is no such file, or a pipe."""
    try:
        with regular(folder.trials).open("rb") as stream:
            return file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


def _checked(
    rows: Iterable[Row], info: RunInfo, trials: Sequence[PlannedTrial], name: str
) -> tuple[list[Row], list[Row]]:
    """Return the rows of the plan, and the others, if run.json says so too."""
    mine, others = of_plan(rows, trials, checkpoint=info.policy.checkpoint_digest)
    if info.rows_digest not in {"", rows_digest(mine)}:
        raise StoreError(
            f"{name} has other rows than run.json records "
            f"({rows_digest(mine)[:8]}, not {info.rows_digest[:8]})",
            fix="--resume completes the run, or start a new one",
        )
    return mine, others


def _of_names(rows: Iterable[Row], trials: Sequence[PlannedTrial]) -> tuple[list[Row], list[Row]]:
    """Return the rows of the plan, and the others, of a journal that is as it was when it ended.

    They were looked at then. What a sum of 64 bits cannot tell is a forgery, and whoever can write
    the journal and run.json can write anything.
    """
    names = {trial.id for trial in trials}
    groups: tuple[list[Row], list[Row]] = ([], [])
    for row in rows:
        groups[row.trial_id not in names].append(row)
    return groups


def _left_out(rows: Sequence[Row]) -> str:
    names = [row.trial_id for row in rows]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (
        "not judged, because the run does not plan their trials: "
        f"{plural(len(names), 'row')} of the journal ({', '.join(names[:_NAMED])}{more})"
    )


class PlannedTrial(Protocol):
    """What a row must agree with; a `suite.Trial`."""

    @property
    def id(self) -> str: ...  # noqa: D102
    @property
    def scene(self) -> str: ...  # noqa: D102
    @property
    def task(self) -> str: ...  # noqa: D102
    @property
    def index(self) -> int: ...  # noqa: D102
    @property
    def seed(self) -> int: ...  # noqa: D102
    @property
    def scene_digest(self) -> str: ...  # noqa: D102
    @property
    def place(self) -> int | None: ...  # noqa: D102
    @property
    def perturbation(self) -> tuple[tuple[str, float], ...]: ...  # noqa: D102


_Planned = TypeVar("_Planned", bound=PlannedTrial)


def wanted(trials: Iterable[_Planned], stop: StopInfo | None) -> tuple[_Planned, ...]:
    """Return the trials of a plan that are judged: all where no trial was left out."""
    return tuple(trial for trial in trials if stop is None or stop.wants(trial.place))


def of_plan(
    rows: Iterable[Row], trials: Iterable[PlannedTrial], *, checkpoint: str
) -> tuple[list[Row], list[Row]]:
    """Return the rows of planned trials, and all others, which no verdict may count.

    Args:
        rows: in any order.
        trials: the plan.
        checkpoint: the digest of the policy that the plan is for, as rows have it.

    Raises:
        StoreError: a row has the name of a planned trial, but another scene, seed or policy.
    """
    plan = {trial.id: trial for trial in trials}
    mine: list[Row] = []
    others: list[Row] = []
    for row in rows:
        trial = plan.get(row.trial_id)
        if trial is None:
            others.append(row)
            continue
        if difference := _difference(row, trial, checkpoint):
            raise StoreError(
                f"the row of trial {row.trial_id} is not of this run: {difference}",
                fix="start a new run",
            )
        mine.append(row)
    return mine, others


def _difference(row: Row, trial: PlannedTrial, checkpoint: str) -> str | None:
    """Return in what a row contradicts its trial, or None."""
    pairs = {
        "scene": (row.scene, trial.scene),
        "task": (row.task, trial.task),
        "index": (row.seed_index, trial.index),
        "perturbation": (row.perturbation, trial.perturbation),
        "scene digest": (row.scene_digest, trial.scene_digest),
        "checkpoint digest": (row.checkpoint_digest, checkpoint),
        "seed": (row.seed, trial.seed),
    }
    for name, (actual, planned) in pairs.items():
        if actual != planned:
            return f"its {name} is {actual!r}, planned was {planned!r}"
    return None
