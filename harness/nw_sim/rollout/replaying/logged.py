"""What a log says about its trial, read back."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.errors import PolicyError, StoreError, UsageError
from nw_base.files.inside import what_is
from nw_policies.bundle import was_instance
from nw_policies.cards.model import CONTROL_RATE
from nw_sim.rollout.job import TrialJob
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.record import PROVENANCE, TRIAL, VERDICT, job_from_metadata

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_sim.rollout.library import Library


@dataclass(frozen=True, kw_only=True)
class LoggedTrial:
    """What a log says about its trial, read back; of a replay, with what its caller chose."""

    path: Path
    job: TrialJob
    verdict: Mapping[str, str]
    versions: Mapping[str, str]

    @property
    def control_rate(self) -> float:
        """Control steps in a second, Hz."""
        return recorded_rate(self.verdict)

    @property
    def log(self) -> LogReader:
        """The log itself, for its states, pictures and poses."""
        return LogReader(self.path)


def read_logged_trial(path: Path) -> LoggedTrial:
    """Return what a log says about its trial.

    Raises:
        StoreError: the file is missing, damaged, or no log of a trial.
    """
    metadata = LogReader(path).metadata()
    if TRIAL not in metadata or VERDICT not in metadata:
        raise StoreError(f"{path} is not the log of a finished trial", fix="name a file of mcap/")
    try:
        job = job_from_metadata(metadata[TRIAL])
    except ValueError as error:
        raise StoreError(f"{path}: {error}", fix="run the trial again") from None
    return LoggedTrial(
        path=path, job=job, verdict=metadata[VERDICT], versions=metadata.get(PROVENANCE, {})
    )


def agreed(
    path: Path,
    *,
    policy: str | None,
    checkpoint: Path | None,
    allow_code: bool,
    library: Library,
) -> LoggedTrial:
    """Return what a log says about its trial, with what its caller chose; arguments as `replay`.

    Raises:
        StoreError: the log cannot be read.
        PolicyError: the bundle is missing, or is on a server that the log alone names.
    """
    logged = read_logged_trial(path)
    recorded = logged.job
    if policy is None and was_instance(recorded.policy):
        name = clean(recorded.policy_name, at_most=100)
        raise PolicyError(
            f"{path}: policy {name!r} was an object of the process that ran it",
            fix="give the same policy with --policy",
        )
    job = replace(
        recorded,
        policy=policy or _policy_path(recorded),
        checkpoint=checkpoint or (None if policy else recorded.checkpoint),
        operator="" if policy or checkpoint else recorded.operator,
        allow_code=allow_code,
    )
    logged = replace(logged, job=job)
    if policy is None:
        _refuse_servers(logged, library)
    return logged


def _refuse_servers(logged: LoggedTrial, library: Library) -> None:
    bundle = library.bundle_of(logged.job)
    if bundle.card.adapter == "remote":
        raise PolicyError(
            f"{logged.path}: {bundle.where}, which the log names, asks a policy on a server",
            fix=f"add --policy {bundle.where} if you trust it",
        )


def _policy_path(job: TrialJob) -> str:
    """Return the recorded bundle's path, or its name where the path is of another machine."""
    known = what_is(Path(job.policy)) != "nothing" or not job.policy_name
    return job.policy if known else job.policy_name


def recorded_rate(verdict: Mapping[str, str]) -> float:
    """Return the control steps in a second, Hz, of a trial that a verdict tells of."""
    said = verdict.get("control_rate", "")  # an untrusted word
    if not re.fullmatch(r"[0-9]{1,4}(\.[0-9]{1,17})?", said):
        return CONTROL_RATE
    return max(float(said), 1.0)


def step_at(time: float, control_rate: float = CONTROL_RATE) -> int:
    """Return the control step that begins at a time (s), or the last one that began before it."""
    # The hair makes 0.58 s the 29th step of 50 in a second, which it is not in floating point.
    return math.floor(time * control_rate + 1e-6)


def check_start(start: float, *, option: str = "--start") -> None:
    """Refuse what is not a time in a trial.

    Raises:
        UsageError: it is negative or no number.
    """
    if not 0.0 <= start < math.inf:
        raise UsageError(f"{option} {start:g}", fix="give seconds, at least 0")


def check_inside(start: float, logged: LoggedTrial, *, option: str = "--start") -> None:
    """Refuse a time that the trial did not reach: from its end on there is nothing to compare.

    Raises:
        UsageError: it is the trial's end, or later.
    """
    steps = logged.verdict.get("steps", "")  # an untrusted word
    if start > 0.0 and re.fullmatch(r"[0-9]{1,9}", steps):
        length = int(steps) / logged.control_rate
        if start >= length:
            raise UsageError(
                f"{option} {start:g}: {logged.path} ends at {length:g} s", fix="give less"
            )
