"""What must be true of a case that was hit and has come to its verdict."""

import fcntl
import signal
import time

from case import send

from nw_gate.results.evidence_check import look_at_logs
from nw_gate.results.row import rows_digest
from nw_gate.results.run_folder import RunFolder

_PATIENCE = 10.0  # s until all processes must be gone


def is_lost(row, now):
    """Whether a result is gone: only one without its log gives way, to the same one with it."""
    made_again = now is not None and row.lost_its_log and now.digest == row.digest
    return now != row and not made_again


def faults_of(case, origin, kept):
    """Return what is wrong with a case that has ended, in sentences.

    Args:
        case: the case.
        origin: the undisturbed run.
        kept: rows that it had before it was resumed.
    """
    rows, wrong = case.rows(), list(case.wrong)
    wrong += other_results(case, origin)
    if any(row.status == "ok" and is_lost(row, rows.get(name)) for name, row in kept.items()):
        wrong.append("a finished trial was lost")
    said = "".join(run.said for run in case.runs)
    if "Traceback" in said:
        wrong.append(f"a traceback: {said[said.index('Traceback') :][:1500]}")
    if left := that_stay(case.relatives):
        wrong.append(f"{len(left)} processes left")
        send(left, signal.SIGKILL)
    if not _is_free(case.journal):
        wrong.append("the journal is still held")
    logs = {row.mcap_path for row in rows.values()}
    torn = [path.name for path in case.folder.rglob("*.partial") if _has_whole(path, logs, case)]
    if torn:
        wrong.append(f"torn logs: {', '.join(torn)}")
    return wrong


def other_results(case, origin):
    """Return how rows and logs of a run differ from what they must be, in sentences."""
    rows = case.rows().values()
    if rows_digest(rows) != origin.digest:
        yield "other rows"
    for finding in look_at_logs(RunFolder(path=case.folder), rows).findings:
        yield f"log {finding.what}: {finding.file} {finding.about}"


def that_stay(found):
    """Return the processes that do not end by themselves.

    Args:
        found: returns the processes that there are.
    """
    deadline = time.monotonic() + _PATIENCE
    while (left := found()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return left


def _is_free(journal):
    try:
        with journal.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _has_whole(path, logs, case):
    """Whether half of a log lies beside the whole; where it does not, it is all the evidence."""
    return path.with_suffix("").relative_to(case.folder).as_posix() in logs
