"""A row and its log beside those of the same trial run again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from nw_eval.api.verifying.logs import partings_apart
from nw_eval.api.verifying.result import Kind, RepeatedTrial
from nw_eval.clean import clean
from nw_eval.results.evidence import log_sha256
from nw_eval.results.evidence_check import log_path
from nw_eval.results.row import COLUMNS, MEASURED
from nw_eval.rollout.replaying.report import Difference

if TYPE_CHECKING:
    from nw_eval.results.row import Row
    from nw_eval.results.run_folder import RunFolder


def compared(row: Row, again: Row, *, run: RunFolder, now: RunFolder) -> RepeatedTrial:
    """Compare a trial of a run with what it comes to now.

    Args:
        row: of the run.
        again: of the trial that was run again.
        run: the folder of the run, and
        now: the one that the trial was run in.
    """
    fault = "" if again.status == "ok" else f"{again.error_type}: {again.error_text}"
    if again.cached:  # What an earlier run says of it shows nothing.
        fault = "it was taken over from another run, and not run"
    log, parted = _logs(row, again, run, now)
    return RepeatedTrial(
        trial=row.trial_id,
        steps=again.steps,
        differences=() if fault else _differences(row, again),
        partings={} if fault else parted,
        log=log,
        fault=fault,
    )


def _differences(row: Row, again: Row) -> tuple[Difference, ...]:
    # What a failing policy said may name a process or the time.
    loose = {*MEASURED, *({"error_text"} if row.outcome == "policy_failed" else ())}
    pairs = [
        (name, getattr(row, name), getattr(again, name)) for name in COLUMNS if name not in loose
    ]
    return tuple(
        Difference(name=name, recorded=_text(was), now=_text(now))
        for name, was, now in pairs
        if was != now
    )


def _logs(
    row: Row, again: Row, run: RunFolder, now: RunFolder
) -> tuple[Literal["same", "compared", "gone"], dict[Kind, int]]:
    """Compare logs: by their bytes, or else, where both can be read, message by message.

    Equal trials make equal bytes. Where a policy lies elsewhere now, or an attempt was repeated,
    what a log says besides differs. Of a log that is gone or damaged, the row knows the digest.
    """
    recorded, written = log_path(run, row), log_path(now, again)
    is_known = again.mcap_sha256 != "" and again.mcap_sha256 == row.mcap_sha256
    there = "" if recorded is None else log_sha256(recorded)
    if again.mcap_sha256 != there and recorded is not None and written is not None:
        parted = partings_apart(recorded, written)
        if parted is not None:
            return "compared", parted
    return ("same" if is_known or there == again.mcap_sha256 != "" else "gone"), {}


def _text(value: object) -> str:
    return "" if value is None else clean(value)
