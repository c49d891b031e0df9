"""Which baseline a run is compared with: the one that is asked for, the suite's own, or none."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.errors import IncomparableError, TrialError
from nw_base.plural import plural
from nw_gate.results.request import Request

if TYPE_CHECKING:
    from nw_eval.suite import Suite
    from nw_gate.results.baseline import LoadedBaseline
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.row import Row
    from nw_gate.results.run_folder import RunFolder

NO_BASELINE = "none"
"""What is asked for where a suite names a baseline and none is wanted."""

_latest: dict[tuple[str, str], LoadedBaseline] = {}
"""The baseline that was read last, by its file's name and digest: a run is judged by the baseline
that it was planned with, and a process of its own takes a third of a second to read it."""


def wanted_baseline(request: Request, suite: Suite, *, own_policy: bool) -> LoadedBaseline | None:
    """Return the baseline to compare with; None when no baseline is wanted.

    Args:
        request: the options given.
        suite: the suite.
        own_policy: whether the policy is the suite's own. Its baseline counts for no other: a
            user's first verdict is about the user's policy.

    Raises:
        UsageError: there is no such baseline.
        StoreError: it is damaged.
        IncomparableError: it is not a baseline file, or has another version.
    """
    from nw_gate.results.baseline_file import find_baseline

    reference = request.baseline
    if reference is None and own_policy:
        reference = suite.gate.baseline
    if reference is None or reference == NO_BASELINE:
        return None
    return opened_baseline(find_baseline(reference, suite=suite.name))


def kept_baseline(
    folder: RunFolder, info: RunInfo, *, elsewhere: bool = True
) -> LoadedBaseline | None:
    """Return the baseline that a run was begun with, from the copy in its folder, or where it was.

    Args:
        folder: the run's folder.
        info: its run.json.
        elsewhere: whether the path that run.json names may be read.

    Raises:
        IncomparableError: it is in neither place, or not as it was.
    """
    if info.baseline is None:
        return None
    places = [
        folder.baseline_file(info.baseline.name),
        *([Path(info.baseline.path)] if elsewhere else []),
    ]
    for path in places:
        if path.is_file() and (digest := _digest(path.read_bytes())) == info.baseline.sha256:
            against = (_latest.get((path.name, digest)) or opened_baseline(path)).of_run(
                info.baseline
            )
            return _with_control(against, folder, info)
    raise IncomparableError(
        f"run {info.id} is compared with baseline {info.baseline.name}, and neither its copy of it "
        f"nor {info.baseline.path} is there as it was",
        fix="restore the file",
    )


def _with_control(against: LoadedBaseline, folder: RunFolder, info: RunInfo) -> LoadedBaseline:
    """Return a baseline with the trials of its policy that ran beside those of a run, if any did.

    Raises:
        StoreError: they are damaged.
        TrialError: one is an error.
    """
    from nw_base.files.inside import what_is
    from nw_gate.results.baseline import ControlArm
    from nw_gate.results.provenance import read_run_info

    nested, known = folder.baseline, info.baseline
    if known is None or known.checked != "control" or what_is(nested.run_json) != "file":
        return against
    own = read_run_info(nested.run_json)
    return replace(against, control=ControlArm(run=own, rows=control_rows(nested, own, folder)))


def control_rows(nested: RunFolder, own: RunInfo, folder: RunFolder) -> tuple[Row, ...]:
    """Return the rows of the baseline's run beside a candidate.

    Args:
        nested: its folder.
        own: its run.json.
        folder: of the candidate's run.

    Raises:
        TrialError: one is an error.
        StoreError: it is damaged.
    """
    from nw_eval.api.saved_run import saved_rows

    rows = saved_rows(nested, own)
    if errors := [row for row in rows if row.status == "error"]:
        raise TrialError(
            f"{plural(len(errors), 'trial')} of the baseline's policy {own.policy.name} ended in "
            f"errors, first {errors[0].trial_id}: {errors[0].error_text or errors[0].error_type}",
            fix=f"--resume {folder.path} tries them again",
        )
    return rows


def judging_baseline(
    folder: RunFolder, info: RunInfo, suite: Suite, reference: str | None
) -> LoadedBaseline | None:
    """Return the baseline to judge a run against; None when no baseline is wanted.

    Args:
        folder: the run's folder.
        info: its run.json.
        suite: its suite.
        reference: the baseline that is asked for; if None, that which the run was begun against, or
            else the one that the suite names for its own policy.

    Raises:
        UsageError, StoreError: as `wanted_baseline`.
        IncomparableError: as `kept_baseline`.
        TrialError: a trial of the control is an error.
    """
    if reference is None and info.baseline is not None:
        return kept_baseline(folder, info)
    against = wanted_baseline(Request(baseline=reference), suite, own_policy=info.own_policy)
    if against and info.baseline and against.info.sha256 == info.baseline.sha256:
        return _with_control(against, folder, info)
    return against


def resumed_baseline(
    folder: RunFolder, info: RunInfo, suite: Suite, request: Request
) -> LoadedBaseline | None:
    """Return the baseline to go on with in a run: the one that it was begun with.

    Args:
        folder: the run's folder.
        info: its run.json.
        suite: its suite.
        request: the options given now.

    Raises:
        UsageError, StoreError: as `wanted_baseline`.
        IncomparableError: as `kept_baseline`; or another baseline is asked for now.
    """
    kept = kept_baseline(folder, info)
    if request.baseline is None:
        return kept
    wanted = wanted_baseline(request, suite, own_policy=info.own_policy)
    if kept is None or (wanted is not None and wanted.info.sha256 == kept.info.sha256):
        return wanted
    asked = str(request.baseline) + ("" if wanted is None else f" ({wanted.info.sha256[:8]})")
    raise IncomparableError(
        f"run {info.id} was started against baseline {kept.info.name} ({kept.info.sha256[:8]}), "
        f"not {asked}",
        fix="start a new run without --resume",
    )


def check_rounds(against: LoadedBaseline, rounds: int, suite: Suite, request: Request) -> None:
    """Refuse more trials of each scene than a baseline has starts.

    Raises:
        IncomparableError: it has fewer.
    """
    from nw_gate.baseline.match import saving

    name, starts = against.info.name, against.results.manifest.starts
    if rounds > starts:
        policy = request.baseline_policy or against.results.manifest.policy.typed
        words = (str(request.suite or suite.name), policy, "--trials", str(rounds))
        raise IncomparableError(
            f"baseline {name} has {plural(starts, 'initial state')} in each scene, and {rounds} "
            "trials of each draw more",
            fix=f"--trials {starts}, or more initial states: `{saving(against.results, *words)}`",
        )


def opened_baseline(path: Path) -> LoadedBaseline:
    """Return the baseline in a file.

    Raises:
        UsageError, StoreError, IncomparableError: as `read_baseline`.
    """
    from nw_gate.results.baseline import LoadedBaseline
    from nw_gate.results.baseline_file import read_baseline
    from nw_gate.results.provenance import BaselineInfo

    baseline, content = read_baseline(path), path.read_bytes()
    info = BaselineInfo(
        name=baseline.manifest.name, path=str(path.resolve()), sha256=_digest(content)
    )
    _latest.clear()
    _latest[path.name, info.sha256] = against = LoadedBaseline(
        info=info, results=baseline, content=content
    )
    return against


def _digest(content: bytes) -> str:
    return sha256(content).hexdigest()
