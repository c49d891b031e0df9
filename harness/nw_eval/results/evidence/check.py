"""Whether a run's rows and logs are as they were when it ended. Nothing is run, nothing written.

A root is no signature. Whoever can write a run's folder can write another root into run.json; whom
that concerns keeps the root elsewhere, or has trials run again.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from nw_eval.errors import StoreError
from nw_eval.files.inside import what_is
from nw_eval.plural import plural
from nw_eval.results.evidence.digests import Digests, read_digests
from nw_eval.results.evidence.discrepancy import CheckedFiles, Discrepancy
from nw_eval.results.evidence.leaves import run_leaf
from nw_eval.results.evidence.logs import look_at_logs, lost_logs, unnamed_logs
from nw_eval.results.evidence.rows import Copy, believed, copies_of, row_findings
from nw_eval.results.provenance import RunInfo
from nw_eval.results.row import Row, rows_digest
from nw_eval.results.run_folder import RunFolder


def check_files(
    folder: RunFolder, info: RunInfo, planned: Collection[str]
) -> tuple[CheckedFiles, dict[str, Row]]:
    """Return what a run's files show, and its rows by trial, as far as they can be believed.

    Args:
        folder: of the run.
        info: its run.json.
        planned: ids of the trials of its plan.
    """
    copies = copies_of(folder, planned, ended=bool(info.rows_digest))
    remarks = [copy.remark for copy in copies if copy.remark]
    findings: list[Discrepancy] = []
    sealed = None
    if info.merkle_root:
        sealed, findings = _sealed(folder, info, copies)
        findings += _of_what(info, sealed)
        findings += row_findings(copies, sealed)
        findings += _lines_besides(copies[0], info, findings)
    else:
        remarks.append(_without_root(info))
        findings += _by_rows_digest(copies, info)
    rows = believed(copies, sealed)
    if absent := len({*planned} - rows.keys()):
        remarks.append(f"{plural(absent, 'planned trial')} without a row")
    # In a run that goes on, a trial that ended in an error may be running again.
    still = [row for row in rows.values() if info.merkle_root or row.status == "ok"]
    looked = look_at_logs(folder, still)
    findings += (each.finding for each in looked if each.finding is not None)
    extra = [*unnamed_logs(folder, [*rows.values(), *copies[0].others])]
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
        logs=len(looked),
        log_bytes=sum(each.bytes for each in looked),
        root=info.merkle_root,
    )
    return evidence, rows


def _sealed(
    folder: RunFolder, info: RunInfo, copies: Sequence[Copy]
) -> tuple[Digests, list[Discrepancy]]:
    """Return the digests of the run's end, and what is wrong with the files that have them.

    They are those whose root run.json has: from digests.json, or else from rows that are as they
    were. Where nothing has that root, digests.json is what is left to go by.
    """
    name = folder.digests.name
    kept, findings = None, list[Discrepancy]()
    try:
        kept = read_digests(folder.digests)
    except StoreError as error:
        what = "unreadable" if what_is(folder.digests) == "file" else "missing"
        about = error.message if what == "unreadable" else ""
        findings.append(Discrepancy(what=what, file=name, about=about))
    of_rows = [Digests(run=run_leaf(info), rows=copy.leaves) for copy in copies if not copy.fault]
    of_any = of_rows if kept is None else [kept, *of_rows]
    for each in of_any:
        if each.root == info.merkle_root:
            if kept is not None and each is not kept:
                findings.append(Discrepancy(what="changed", file=name, about="the rows were not"))
            return each, findings
    about = f"merkle_root is {info.merkle_root[:12]}"
    about += "" if kept is None else f", {name} gives {kept.root[:12]}"
    findings.append(Discrepancy(what="changed", file=folder.run_json.name, about=about))
    return next(iter(of_any), Digests(run=run_leaf(info), rows={})), findings


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
