"""Whether a run's rows and logs are as they were when it ended. Nothing is run, nothing written.

Rows are held against the digests of the run's end, in both files that have them, and logs against
the digests that their rows have of them. A root is no signature. Whoever can write a run's folder
can write another root into run.json; whom that concerns keeps the root elsewhere, or has trials run
again.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Literal

from nw_base.clean import clean
from nw_base.errors import StoreError
from nw_base.files.inside import OutsideError, inside, what_is
from nw_base.plural import plural
from nw_gate.results.evidence import Digests, log_sha256, read_digests, row_leaf, run_leaf
from nw_gate.results.journal import read_journal
from nw_gate.results.log_links import is_own_link, linked_name
from nw_gate.results.provenance import RunInfo
from nw_gate.results.row import COLUMNS, Row, rows_digest
from nw_gate.results.run_folder import RunFolder
from nw_gate.results.tables import read_rows_apart

What = Literal["changed", "missing", "extra", "unreadable"]


@dataclass(frozen=True, kw_only=True)
class Discrepancy:
    """Something that is not as it was when the run ended."""

    what: What
    file: str
    """Which file of the run's folder, relative to it."""
    trial: str = ""
    """Whose row or log; empty where it is a file as a whole."""
    about: str = ""
    """How it differs, in words; empty where there is nothing more to say."""


@dataclass(frozen=True, kw_only=True)
class CheckedFiles:
    """What looking at a run's files showed; nothing was run."""

    findings: tuple[Discrepancy, ...]
    remarks: tuple[str, ...]
    """Sentences: what could not be looked at, and why."""
    rows: int
    """Trials with a row."""
    logs: int
    """Logs whose digest a row has."""
    log_bytes: int
    """Of those that are there."""
    root: str
    """The Merkle root that run.json has, hex; empty where it has none."""


def check_files(
    folder: RunFolder, info: RunInfo, planned: Collection[str]
) -> tuple[CheckedFiles, Mapping[str, Row]]:
    """Return what a run's files show, and the rows of its plan, as far as they can be believed.

    Args:
        folder: of the run.
        info: its run.json.
        planned: ids of the trials of its plan.
    """
    planned = frozenset(planned)
    kept, findings = _kept(folder) if info.merkle_root else (None, [])
    copies = _copies_of(folder, planned, ended=bool(info.rows_digest))
    remarks = [copy.remark for copy in copies if copy.remark]
    sealed = None
    if info.merkle_root:
        sealed = _sealed(folder, info, copies, kept, findings)
        findings += _of_what(info, sealed)
        findings += _row_findings(copies, sealed)
        findings += _lines_besides(copies[0], info, findings)
    else:
        remarks.append(_without_root(info))
        findings += _by_rows_digest(copies, info)
    rows = believed(copies, sealed)
    if absent := sum(name not in rows for name in planned):
        remarks.append(f"{plural(absent, 'planned trial')} without a row")
    # In a run that goes on, a trial that ended in an error may be running again.
    still = (row for row in rows.values() if info.merkle_root or row.status == "ok")
    looked = look_at_logs(folder, still)
    findings += looked.findings
    extra = [*_unnamed_logs(folder, chain(rows.values(), copies[0].others))]
    if info.merkle_root and not info.interrupted:
        findings += (Discrepancy(what="extra", file=name) for name in extra)
    elif extra:  # Of trials that were under way.
        remarks.append(f"{plural(len(extra), 'log')} of trials without a row, first {extra[0]}")
    if unknown := sum(bool(row.mcap_path) and not row.mcap_sha256 for row in rows.values()):
        remarks.append(f"{plural(unknown, 'log')} not compared: their rows have no digest of them")
    remarks += lost_logs(rows.values())
    evidence = CheckedFiles(
        findings=tuple(findings),
        remarks=tuple(remarks),
        rows=len(rows),
        logs=looked.logs,
        log_bytes=looked.bytes,
        root=info.merkle_root,
    )
    return evidence, {name: row for name, row in rows.items() if name in planned}


def _kept(folder: RunFolder) -> tuple[Digests | None, list[Discrepancy]]:
    """Return what digests.json has, or None and why it cannot be read."""
    try:
        return read_digests(folder.digests), []
    except StoreError as error:
        what = "unreadable" if what_is(folder.digests) == "file" else "missing"
        about = error.message if what == "unreadable" else ""
        return None, [Discrepancy(what=what, file=folder.digests.name, about=about)]


def _sealed(
    folder: RunFolder,
    info: RunInfo,
    copies: Sequence[Copy],
    kept: Digests | None,
    findings: list[Discrepancy],
) -> Digests:
    """Return the digests of the run's end, and add what is wrong with the files that have them.

    They are those whose root run.json has: from digests.json, or else from rows that are as they
    were. Where nothing has that root, digests.json is what is left to go by.
    """
    name = folder.digests.name
    of_rows = [Digests(run=run_leaf(info), rows=copy.leaves) for copy in copies if not copy.fault]
    of_any = of_rows if kept is None else [kept, *of_rows]
    for each in of_any:
        if each.root == info.merkle_root:
            if kept is not None and each is not kept:
                findings.append(Discrepancy(what="changed", file=name, about="the rows were not"))
            return each
    about = f"merkle_root is {info.merkle_root[:12]}"
    about += "" if kept is None else f", {name} gives {kept.root[:12]}"
    findings.append(Discrepancy(what="changed", file=folder.run_json.name, about=about))
    return next(iter(of_any), Digests(run=run_leaf(info), rows={}))


def _of_what(info: RunInfo, sealed: Digests) -> Iterator[Discrepancy]:
    """Yield that run.json is of something else than the root."""
    if sealed.run != run_leaf(info):
        about = "its suite, policy, scenes, baseline or engine are not those of the root"
        yield Discrepancy(what="changed", file="run.json", about=about)


def _lines_besides(
    journal: Copy, info: RunInfo, findings: Sequence[Discrepancy]
) -> Iterator[Discrepancy]:
    """Yield that lines of the journal were changed besides those of the rows that count."""
    is_known = any(each.file == journal.file for each in findings)
    if not is_known and journal.last_sum != info.journal_sum:
        about = "its rows were not, but lines of earlier attempts or of other trials"
        yield Discrepancy(what="changed", file=journal.file, about=about)


def _without_root(info: RunInfo) -> str:
    if info.finished is None or not info.rows_digest:
        return "the run has not ended: it has no Merkle root yet, and its rows were not compared"
    return (
        "an older nw-eval made the run, without a Merkle root: which of its rows was changed "
        "cannot be told"
    )


def _by_rows_digest(copies: Sequence[Copy], info: RunInfo) -> Iterator[Discrepancy]:
    """Yield which copies have other results than an older run.json says."""
    for copy in copies:
        if copy.fault:
            yield Discrepancy(what="unreadable", file=copy.file, about=copy.fault)
        elif info.rows_digest not in {"", actual := rows_digest(copy.rows.values())}:
            about = f"rows_digest is {info.rows_digest[:12]}, its rows give {actual[:12]}"
            yield Discrepancy(what="changed", file=copy.file, about=about)


_SHOWN = 4  # columns that a sentence names


@dataclass(frozen=True, kw_only=True)
class Copy:
    """One of the files that have a run's rows."""

    file: str
    rows: Mapping[str, Row]
    """By trial; of the journal only those of the run's plan. A row that another copy has as well is
    the same object."""
    leaves: Mapping[str, str]
    """The hashes of its rows, by trial."""
    others: tuple[Row, ...] = ()
    """Those that are not of its plan: it was resumed with fewer trials."""
    fault: str = ""
    """Why it cannot be read, if it cannot."""
    remark: str = ""
    """A sentence about what was left out."""
    last_sum: str = ""
    """Of the journal's last line."""


def _copies_of(folder: RunFolder, planned: Collection[str], *, ended: bool) -> tuple[Copy, ...]:
    """Return the journal's rows and, once the run has ended, those of trials.parquet."""
    journal = _journal(folder, planned)
    return (journal, _parquet(folder, journal)) if ended else (journal,)


def _row_findings(copies: Collection[Copy], sealed: Digests) -> Iterator[Discrepancy]:
    """Yield what is wrong with each row of each copy.

    Args:
        copies: of the rows.
        sealed: the digests of the run's end.
    """
    for copy in copies:
        if copy.fault:
            yield Discrepancy(what="unreadable", file=copy.file, about=copy.fault)
            continue
        changed = {name for name, leaf in copy.leaves.items() if sealed.rows.get(name) != leaf}
        for trial in sorted(changed.union(name for name in sealed.rows if name not in copy.leaves)):
            leaf, known = copy.leaves.get(trial), sealed.rows.get(trial)
            if known is None:
                yield Discrepancy(what="extra", file=copy.file, trial=trial)
            elif leaf is None:
                yield Discrepancy(what="missing", file=copy.file, trial=trial)
            else:
                about = _against_the_other(copy, trial, known, copies)
                yield Discrepancy(what="changed", file=copy.file, trial=trial, about=about)


def believed(copies: Sequence[Copy], sealed: Digests | None) -> dict[str, Row]:
    """Return the row of each trial that the digests speak for, or else what any copy says."""
    first, *others = copies
    rows = dict(first.rows)
    for copy in others:
        for trial, leaf in copy.leaves.items():
            is_sealed = sealed is not None and sealed.rows.get(trial) == leaf
            if trial not in first.leaves or (is_sealed and first.leaves[trial] != leaf):
                rows[trial] = copy.rows[trial]
    return rows


def _journal(folder: RunFolder, planned: Collection[str]) -> Copy:
    name = folder.journal.name
    try:
        contents = read_journal(folder.journal)
    except StoreError as error:
        return Copy(file=name, rows={}, leaves={}, fault=error.message)
    rows = {row.trial_id: row for row in contents.rows if row.trial_id in planned}
    return Copy(
        file=name,
        rows=rows,
        leaves={trial: row_leaf(row) for trial, row in rows.items()},
        others=tuple(row for row in contents.rows if row.trial_id not in planned),
        remark=contents.dropped or "",
        last_sum=contents.last_sum,
    )


def _parquet(folder: RunFolder, journal: Copy) -> Copy:
    name, rows, leaves = folder.trials.name, dict[str, Row](), dict[str, str]()
    fault = ""
    try:
        for row in read_rows_apart(folder.trials):
            trial, leaf = row.trial_id, row_leaf(row)
            fault = fault or ("it has two rows of one trial" if trial in leaves else "")
            leaves[trial] = leaf
            rows[trial] = journal.rows[trial] if journal.leaves.get(trial) == leaf else row
    except StoreError as error:
        fault = error.message
    return Copy(file=name, rows={} if fault else rows, leaves={} if fault else leaves, fault=fault)


def _against_the_other(copy: Copy, trial: str, leaf: str, copies: Collection[Copy]) -> str:
    """Return which columns were changed, if another copy has the row as it was."""
    other = next((each for each in copies if each.leaves.get(trial) == leaf), None)
    if other is None:
        return ""
    row, was = copy.rows[trial], other.rows[trial]
    changed = [name for name in COLUMNS if getattr(row, name) != getattr(was, name)]
    shown = [
        f"{name} is {_short(getattr(row, name))}, was {_short(getattr(was, name))}"
        for name in changed[:_SHOWN]
    ]
    more = len(changed) - _SHOWN
    return "; ".join([*shown, *([f"and {plural(more, 'column')} more"] if more > 0 else [])])


def _short(value: object) -> str:
    return clean(value if value not in {"", None} else "none", at_most=40)


@dataclass(frozen=True, kw_only=True)
class LookedAt:
    """Logs, and what was found of them."""

    logs: int
    """Those whose digest a row has."""
    bytes: int
    """Of those that are there."""
    findings: tuple[Discrepancy, ...]


_LOGS_AT_ONCE = 1000


def look_at_logs(folder: RunFolder, rows: Iterable[Row]) -> LookedAt:
    """Compare the log of every row that has its digest.

    Args:
        folder: of the run.
        rows: of a plan, one for each trial.
    """
    known = (row for row in rows if row.mcap_sha256)
    logs = size = 0
    findings: list[Discrepancy] = []
    with ThreadPoolExecutor() as pool:  # Hashing holds no lock.
        while some := list(islice(known, _LOGS_AT_ONCE)):
            for of_log, finding in pool.map(lambda row: _look_at(folder, row), some):
                size += of_log
                findings += [] if finding is None else [finding]
            logs += len(some)
    return LookedAt(logs=logs, bytes=size, findings=tuple(findings))


def _unnamed_logs(folder: RunFolder, rows: Iterable[Row]) -> Iterator[str]:
    """Yield the logs that no row names, relative to the run's folder.

    Where a trial ended in an error, its worker may have left a log that it could not speak of.
    """
    named: set[str] = set()
    taken: dict[str, str] = {}
    for row in rows:
        named.add(row.mcap_path)
        if (link := linked_name(row)) is not None:
            taken[link] = row.mcap_sha256
        if row.status == "error":
            named.add(folder.relative(folder.mcap(row.scene, row.trial_id)))
    for log in sorted(folder.logs.rglob("*.mcap")):
        if (name := folder.relative(log)) in named:
            continue
        if name not in taken or not _is_taken_over(log, name, taken[name]):
            yield name


def _is_taken_over(log: Path, name: str, digest: str) -> bool:
    """Return whether a log is that of a trial that was taken over: its link, or a copy through it.

    What the link leads to is compared as the log of its row.
    """
    if log.is_symlink():
        return is_own_link(log, name)
    return what_is(log) == "file" and log_sha256(log) == digest != ""


def lost_logs(rows: Iterable[Row]) -> list[str]:
    """Return a sentence of the results whose logs could not be written; none where all were."""
    lost = [row.trial_id for row in rows if row.lost_its_log]
    if not lost:
        return []
    first = f"{plural(len(lost), 'log')} lost, which could not be written (first that of {lost[0]})"
    return [f"{first}: --resume runs these trials again"]


def log_path(folder: RunFolder, row: Row) -> Path | None:
    """Return where a row's log lies; None where it names none within the folder."""
    try:
        return inside(folder.path, row.mcap_path) if row.mcap_path else None
    except OutsideError:
        return None


def present_logs(folder: RunFolder, rows: Iterable[Row]) -> dict[str, Path]:
    """Return where logs lie, by trial, as far as there are any in the folder."""
    paths = ((row.trial_id, log_path(folder, row)) for row in rows)
    return {trial: path for trial, path in paths if path is not None and what_is(path) == "file"}


def _look_at(folder: RunFolder, row: Row) -> tuple[int, Discrepancy | None]:
    """Return the bytes of a row's log, 0 where there is none, and what is wrong with it."""
    path = log_path(folder, row)
    if path is None:
        return _wrong(row, "unreadable", "its row names no file of this folder")
    try:
        size = path.stat().st_size if what_is(path) == "file" else None
    except OSError:  # It was there a moment ago.
        size = None
    if size is None:
        return _wrong(row, "missing")
    digest = log_sha256(path)
    if not digest:
        return _wrong(row, "unreadable", "check its rights", size)
    if digest != row.mcap_sha256:
        sizes = f"{size:,} bytes, not {row.mcap_bytes:,}; " if size != row.mcap_bytes else ""
        about = f"{sizes}SHA-256 {digest[:12]}, not {row.mcap_sha256[:12]}"
        return _wrong(row, "changed", about, size)
    return size, None


def _wrong(row: Row, what: What, about: str = "", size: int = 0) -> tuple[int, Discrepancy | None]:
    finding = Discrepancy(what=what, file=row.mcap_path, trial=row.trial_id, about=about)
    return size, finding
