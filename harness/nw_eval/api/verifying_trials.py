"""Runs trials of a run again, in a folder of their own, by the run's own plan, and compares them.

A row and its log are held against those of the same trial now: what differs, and of logs from which
control step on.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

from pydantic import TypeAdapter, ValidationError

from nw_base.clean import clean
from nw_base.confinement import Rules
from nw_base.errors import IncomparableError, NwEvalError, PolicyError, UsageError
from nw_eval.engine.order import draw
from nw_gate.results.evidence import log_sha256
from nw_gate.results.evidence_check import log_path
from nw_gate.results.journal import JournalHeader, read_journal
from nw_gate.results.provenance import read_run_info
from nw_gate.results.row import COLUMNS, MEASURED
from nw_sim.rollout.confined.isolated import call_isolated
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.record import VERDICT
from nw_sim.rollout.replaying.logged import recorded_rate
from nw_sim.rollout.replaying.reports import Difference, Kind, RepeatedTrial, Repeats

if TYPE_CHECKING:
    from nw_eval.engine.how import How
    from nw_eval.engine.plan import Plan
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.request import Request
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder


def run_again(
    folder: RunFolder,
    info: RunInfo,
    rows: Mapping[str, Row],
    request: Request,
    *,
    sample: str,
    seed: int,
    how: How,
) -> Repeats:
    """Run trials of a run again, and compare their results with their rows and logs.

    Args:
        folder: of the run, in which nothing is written.
        info: its run.json.
        rows: of its trials, by their ids.
        request: where the policy lies, if not where it did, and whether code is allowed.
        sample: how many trials, as `verifying.check_sample` has it.
        seed: draws them.
        how: how they are run.
    """
    ended = [name for name, row in rows.items() if row.status == "ok"]
    if not ended:
        return Repeats(seed=seed, of=0)
    try:
        plan = _plan(folder, info, request)
        chosen = _part(plan, draw(ended, sample, seed), rows)
        with TemporaryDirectory(prefix="nw-eval-verify-") as temporary:
            return _repeats_of(chosen, Path(temporary), folder, rows, seed, len(ended), how)
    except NwEvalError as error:
        return Repeats(seed=seed, of=len(ended), unable=error)


def _plan(folder: RunFolder, info: RunInfo, request: Request) -> Plan:
    """Return the plan of a run, if its trials give the same bits here.

    Raises:
        IncomparableError: policy, scenes, versions, kind of CPU or code are others.
        PolicyError: the policy cannot be run again, or is on a server that the run alone names.
        UsageError: CUDA must draw, and the caller does not allow code.
    """
    from nw_eval.api.continuing import continued
    from nw_eval.engine.provenance import journal_header

    if request.policy is None and not info.policy.card:
        raise PolicyError(
            f"policy {info.policy.name!r} was an object of the process that ran it",
            fix="give the same policy with --policy",
        )
    plan = continued(folder.path, request, again=True)
    if request.policy is None and plan.bundle.card.adapter == "remote":
        raise PolicyError(
            f"{plan.bundle.where}, which run.json names, asks a policy on a server",
            fix=f"add --policy {plan.bundle.where} if you trust it",
        )
    if plan.renders and plan.render == "cuda" and not request.allow_code:
        raise UsageError(
            "its pictures were drawn with CUDA, which cannot be confined",
            fix="add --allow-code if you trust the run and its policy",
        )
    if differences := JournalHeader.of_run(info).differences(journal_header(plan)):
        raise IncomparableError(
            f"trials cannot be compared exactly here: {', '.join(differences)} changed",
            fix="verify the run with the nw-eval and on the kind of machine that made it",
        )
    return plan


def _part(plan: Plan, names: tuple[str, ...], rows: Mapping[str, Row]) -> Plan:
    """Return a plan with some of its trials, and nothing to compare them with but their rows."""
    trials = tuple(trial for trial in plan.trials if trial.id in names)
    scenes = {trial.scene for trial in trials}
    return replace(
        plan,
        trials=trials,
        found=tuple(each for each in plan.found if each.scene.name in scenes),
        arm=rows[names[0]].arm,
        against=None,
        is_baseline=False,
    )


def _repeats_of(
    plan: Plan,
    temporary: Path,
    folder: RunFolder,
    rows: Mapping[str, Row],
    seed: int,
    of: int,
    how: How,
) -> Repeats:
    """Run a plan and compare each of its rows."""
    from nw_eval.engine import session

    repeat_run = session.carry_out(
        plan,
        replace(how, cache=False),  # It may have taken in the very results that are to be verified.
        out=temporary / "run",
    )
    repeated = {row.trial_id: row for row in read_journal(repeat_run.journal).rows}
    return Repeats(
        seed=seed,
        of=of,
        trials=tuple(
            compared(rows[name], repeated[name], run=folder, repeat_run=repeat_run)
            for name in sorted(repeated)
        ),
        interrupted=read_run_info(repeat_run.run_json).interrupted,
    )


def compared(row: Row, repeated: Row, *, run: RunFolder, repeat_run: RunFolder) -> RepeatedTrial:
    """Compare a trial of a run with its result now.

    Args:
        row: one of the run's.
        repeated: the row of the trial that was run again.
        run: the folder of the run, and
        repeat_run: folder of the run that ran the trial again.
    """
    fault = "" if repeated.status == "ok" else f"{repeated.error_type}: {repeated.error_text}"
    if repeated.cached:  # What an earlier run says of it shows nothing.
        fault = "its result comes from another run; it did not run"
    log, parted = _logs(row, repeated, run, repeat_run)
    return RepeatedTrial(
        trial=row.trial_id,
        steps=repeated.steps,
        differences=() if fault else _differences(row, repeated),
        partings={} if fault else parted,
        log=log,
        fault=fault,
    )


def _differences(row: Row, repeated: Row) -> tuple[Difference, ...]:
    # What a failing policy said may name a process or the time.
    loose = {*MEASURED, *({"error_text"} if row.outcome == "policy_failed" else ())}
    pairs = [
        (name, getattr(row, name), getattr(repeated, name)) for name in COLUMNS if name not in loose
    ]
    return tuple(
        Difference(name=name, recorded=_text(was), now=_text(value))
        for name, was, value in pairs
        if was != value
    )


def _logs(
    row: Row, repeated: Row, run: RunFolder, repeat_run: RunFolder
) -> tuple[Literal["same", "compared", "gone"], dict[Kind, int]]:
    """Compare logs: by their bytes, or else, where both can be read, message by message.

    Equal trials make equal bytes. Where a policy lies elsewhere now, or an attempt was repeated,
    what a log says besides differs. Of a log that is gone or damaged, the row knows the digest.
    """
    recorded, written = log_path(run, row), log_path(repeat_run, repeated)
    is_known = repeated.mcap_sha256 != "" and repeated.mcap_sha256 == row.mcap_sha256
    there = "" if recorded is None else log_sha256(recorded)
    if repeated.mcap_sha256 != there and recorded is not None and written is not None:
        parted = partings_apart(recorded, written)
        if parted is not None:
            return "compared", parted
    return ("same" if is_known or there == repeated.mcap_sha256 != "" else "gone"), {}


def _text(value: object) -> str:
    return "" if value is None else clean(value)


_Entry = tuple[int, bytes]
"""Time in ns, and a digest of what was logged then."""
_PROCESSOR_SECONDS = 60
"""For two logs, which take less than one."""
_KEPT_AT_WILL = ("/camera/", "/observation/")
"""Topics whose messages are in a log only if its images were kept."""


def partings_apart(recorded: Path, repeated: Path) -> dict[Kind, int] | None:
    """As `partings`, in a confined process: the recorded log may be anybody's. None if it cannot.

    Args:
        recorded: the log of the run.
        repeated: the log of the same trial run again.
    """
    rules = Rules(reads=(recorded.resolve(), repeated.resolve()), seconds=_PROCESSOR_SECONDS)
    try:
        answer = call_isolated(
            _partings,
            subject=str(recorded),
            rules=rules,
            recorded=str(recorded),
            repeated=str(repeated),
        )
        return TypeAdapter(dict[Kind, int]).validate_python(answer)
    except (NwEvalError, OSError, ValidationError):
        return None


def _partings(*, recorded: str, repeated: str) -> dict[Kind, int]:
    return partings(Path(recorded), Path(repeated))


def partings(recorded: Path, repeated: Path) -> dict[Kind, int]:
    """Return the first control step, from 0, at which two logs differ, for each kind of content.

    Images that only one of them has kept are not compared: that is the recording's choice.

    Raises:
        StoreError: one of them cannot be read.
    """
    control_rate = recorded_rate(LogReader(recorded).metadata().get(VERDICT, {}))
    was, is_ = _entries(recorded), _entries(repeated)
    partings: dict[Kind, int] = {}
    for key in {*was, *is_}:
        kind, topic = key
        if not (key in was and key in is_) and topic.startswith(_KEPT_AT_WILL):
            continue
        if (time_ns := _first_difference(was[key], is_[key])) is not None:
            step = round(time_ns * 1e-9 * control_rate)
            partings[kind] = min(step, partings.get(kind, step))
    return partings


def _first_difference(was: list[_Entry], is_: list[_Entry]) -> int | None:
    for one, other in zip_longest(was, is_):
        if one != other:
            return min(entry[0] for entry in (one, other) if entry is not None)
    return None


def _entries(log: Path) -> defaultdict[tuple[Kind, str], list[_Entry]]:
    """Return digests of all messages, by kind and topic."""
    entries: defaultdict[tuple[Kind, str], list[_Entry]] = defaultdict(list)
    for topic, time_ns, message in LogReader(log).messages():
        for kind, content in _contents(topic, message):
            entries[kind, topic].append((time_ns, sha256(content).digest()))
    return entries


def _contents(topic: str, message: Any) -> Iterator[tuple[Kind, bytes]]:
    """Yield what a message holds, by kind; `/nw/policy` holds two."""
    if topic == "/nw/policy":
        yield "observation", message.observation_digest
        message.ClearField("observation_digest")
        yield "action", message.SerializeToString(deterministic=True)
    else:
        for field, value in message.ListFields():
            if isinstance(value, str):  # A reused trial may have run for another suite.
                setattr(message, field.name, _OF_SUITE.sub(" of a suite", value))
        yield _kind(topic), message.SerializeToString(deterministic=True)


_OF_SUITE = re.compile(r" of suite \S+$")
"""The end of the first event of a log: which suite its trial was of."""


def _kind(topic: str) -> Kind:
    if topic.startswith("/camera/"):
        return "image"
    if topic.startswith("/observation/"):
        return "observation"
    return "state" if topic in {"/nw/state", "/tf"} or topic.startswith("/robot/") else "other"
