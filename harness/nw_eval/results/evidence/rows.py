"""A run's rows held against the digests of its end, in both files that have them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.plural import plural
from nw_eval.results.evidence.digests import Digests
from nw_eval.results.evidence.discrepancy import Discrepancy
from nw_eval.results.evidence.leaves import row_leaves
from nw_eval.results.journal import read_journal
from nw_eval.results.parquet_apart import read_rows_apart
from nw_eval.results.row import COLUMNS, Row, texts_of
from nw_eval.results.run_folder import RunFolder

_SHOWN = 4  # columns that a sentence names


@dataclass(frozen=True, kw_only=True)
class Copy:
    """One of the files that have a run's rows."""

    file: str
    rows: Mapping[str, Row]
    """By trial; only those of the run's plan."""
    leaves: Mapping[str, str]
    """Their hashes."""
    others: tuple[Row, ...] = ()
    """Those that are not of its plan: it was resumed with fewer trials."""
    fault: str = ""
    """Why it cannot be read, if it cannot."""
    remark: str = ""
    """A sentence about what was left out."""
    last_sum: str = ""
    """Of the journal's last line."""


def copies_of(folder: RunFolder, planned: Collection[str], *, ended: bool) -> tuple[Copy, ...]:
    """Return the journal's rows and, once the run has ended, those of trials.parquet."""
    journal = _journal(folder, planned)
    return (journal, _parquet(folder)) if ended else (journal,)


def row_findings(copies: Collection[Copy], sealed: Digests) -> Iterator[Discrepancy]:
    """Yield what is wrong with each row of each copy.

    Args:
        copies: of the rows.
        sealed: the digests of the run's end.
    """
    for copy in copies:
        if copy.fault:
            yield Discrepancy(what="unreadable", file=copy.file, about=copy.fault)
            continue
        for trial in sorted({*copy.leaves, *sealed.rows}):
            leaf, known = copy.leaves.get(trial), sealed.rows.get(trial)
            if leaf == known:
                continue
            if known is None:
                yield Discrepancy(what="extra", file=copy.file, trial=trial)
            elif leaf is None:
                yield Discrepancy(what="missing", file=copy.file, trial=trial)
            else:
                about = _against_the_other(copy, trial, known, copies)
                yield Discrepancy(what="changed", file=copy.file, trial=trial, about=about)


def believed(copies: Collection[Copy], sealed: Digests | None) -> dict[str, Row]:
    """Return the row of each trial that the digests speak for, or else what any copy says."""
    found: dict[str, Row] = {}
    for copy in copies:
        for trial, row in copy.rows.items():
            if trial not in found or (sealed and sealed.rows.get(trial) == copy.leaves[trial]):
                found[trial] = row
    return found


def _journal(folder: RunFolder, planned: Collection[str]) -> Copy:
    name = folder.journal.name
    try:
        contents = read_journal(folder.journal)
    except StoreError as error:
        return Copy(file=name, rows={}, leaves={}, fault=error.message)
    rows = [row for row in contents.rows if row.trial_id in planned]
    return replace(
        _copy(name, rows),
        others=tuple(row for row in contents.rows if row.trial_id not in planned),
        remark=contents.dropped or "",
        last_sum=contents.last_sum,
    )


def _parquet(folder: RunFolder) -> Copy:
    name = folder.trials.name
    try:
        return _copy(name, read_rows_apart(folder.trials))
    except (StoreError, ValueError) as error:
        return Copy(file=name, rows={}, leaves={}, fault=clean(error))


def _copy(file: str, rows: Collection[Row]) -> Copy:
    by_trial = {row.trial_id: row for row in rows}
    leaves: dict[str, str] = {}
    for texts in texts_of(list(by_trial.values())):
        leaves |= row_leaves(texts)
    fault = "" if len(by_trial) == len(rows) else "it has two rows of one trial"
    return Copy(file=file, rows=by_trial, leaves=leaves, fault=fault)


def _against_the_other(copy: Copy, trial: str, leaf: str, copies: Collection[Copy]) -> str:
    """Return which columns were changed, if another copy has the row as it was."""
    other = next((each for each in copies if each.leaves.get(trial) == leaf), None)
    if other is None:
        return ""
    now, was = copy.rows[trial], other.rows[trial]
    changed = [name for name in COLUMNS if getattr(now, name) != getattr(was, name)]
    shown = [
        f"{name} is {_short(getattr(now, name))}, was {_short(getattr(was, name))}"
        for name in changed[:_SHOWN]
    ]
    more = len(changed) - _SHOWN
    return "; ".join([*shown, *([f"and {plural(more, 'column')} more"] if more > 0 else [])])


def _short(value: object) -> str:
    return clean(value if value not in {"", None} else "none", at_most=40)
