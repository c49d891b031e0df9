"""Films of the baseline's policy from the initial states of the worst trials.

A film stands beside the candidate's on the report: the same robot, scene and initial state, up to
the waypoint that the candidate missed. Where the baseline's policy ran beside the candidate, its
logs are there. Elsewhere its trial is run now, in a confined process, from the initial state that
the candidate's log holds. This needs the policy itself, with the digests that the baseline names;
where it is not at hand the page says so. Films are kept in the user's cache.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nw_base.clean import clean
from nw_base.digest import digest_of
from nw_base.errors import IncomparableError, NwEvalError
from nw_eval.api.evidence import KeptEvidence, WantedLog
from nw_eval.api.evidence_drawn import (
    FILM_BYTES,
    Drawn,
    drawn_apart,
    film_of,
    keep_drawn,
    read_drawn,
)
from nw_gate.results.evidence_check import present_logs
from nw_gate.results.row import Row

if TYPE_CHECKING:
    from nw_eval.api.evidence_log import ReadClip
    from nw_eval.reporting.html.evidence import Clip, LogEvidence
    from nw_eval.reporting.tables import Rivals
    from nw_gate.results.baseline import BaselinePolicy
    from nw_gate.results.provenance import RunInfo
    from nw_gate.results.run_folder import RunFolder
    from nw_policies import Bundle

_SECONDS = 300.0
"""Wall time of such a trial, at most: a report is not to wait for a policy that hangs."""
_AT_ONCE = 2
"""Trials of the baseline's policy that run at a time, each in a process of its own."""


def with_baseline_films(
    evidence: LogEvidence,
    folder: RunFolder,
    run: RunInfo,
    rows: Mapping[str, Row],
    logs: Mapping[str, Path],
    *,
    policy: BaselinePolicy,
    rivals: Rivals,
    kept: KeptEvidence | None,
    runs: bool,
) -> LogEvidence:
    """Return evidence whose films from outside have the baseline's beside them, where they can.

    Args:
        evidence: of the candidate's logs, with its films.
        folder: of the run.
        run: its run.json.
        rows: its trials, by name.
        logs: where the candidate's logs lie, by trial.
        policy: the baseline's.
        rivals: what the baseline's policy did from the same initial states; those that ran beside
            the candidate have logs.
        kept: where films are kept; None = nowhere.
        runs: whether the baseline's policy may run now: the run is this machine's own.
    """
    filmed = [each for each in evidence.clips if each.outside is not None]
    name = "" if run.baseline is None else run.baseline.name
    is_same = policy.checkpoint_digest == run.policy.checkpoint_digest
    if not filmed or not name or (is_same and policy.card_digest == run.policy.card_digest):
        return evidence
    wanted = [
        _Wanted.of(clip, rows[clip.trial_id], logs[clip.trial_id], policy, kept)
        for clip in filmed
        if clip.trial_id in rows and clip.trial_id in logs
    ]
    films = {each.trial: film for each in wanted if (film := _kept_film(kept, each.key))}
    missing = [each for each in wanted if each.trial not in films]
    remarks: tuple[str, ...] = ()
    if missing and runs:
        try:
            made = _made(missing, folder, policy, rivals, run)
        except (NwEvalError, OSError) as error:
            why = clean(str(error), at_most=300)
            remarks = (f"The baseline's policy is not shown beside the worst trials: {why}.",)
            made = {}
        else:
            if lost := [each.trial for each in missing if each.trial not in made]:
                which = ", ".join(lost)
                why = "its trial could not be run or drawn"
                remarks = (f"The baseline's policy is not shown beside {which}: {why}.",)
        for each in missing:
            if (film := made.get(each.trial)) is not None:
                films[each.trial] = film
                keep_drawn(kept, each.key, Drawn(films=(film,)))
    return replace(
        evidence,
        clips=tuple(
            _beside(each, films[each.trial_id], rows[each.trial_id], name)
            if each.trial_id in films
            else each
            for each in evidence.clips
        ),
        remarks=(*evidence.remarks, *remarks),
    )


@dataclass(frozen=True, kw_only=True)
class _Wanted:
    """A trial of the baseline's policy that is to be filmed."""

    trial: str
    """The candidate's."""
    log: Path
    """The candidate's, which holds the initial state."""
    scene: str
    waypoint: int
    """The one that the candidate missed, from 1; 0 = there is none."""
    key: str
    """Under which the film is kept; empty = it is not."""

    @classmethod
    def of(
        cls, clip: Clip, row: Row, log: Path, policy: BaselinePolicy, kept: KeptEvidence | None
    ) -> _Wanted:
        missed = row.waypoints_reached + 1
        waypoint = missed if missed <= row.waypoints_total else 0
        wanted = WantedLog(path=log, scene=row.scene, clip=True, waypoint=waypoint)
        key = "" if kept is None else kept.key([wanted], {"baseline": FILM_BYTES})
        return cls(
            trial=clip.trial_id,
            log=log,
            scene=row.scene,
            waypoint=waypoint,
            key=digest_of([key, policy.checkpoint_digest, policy.card_digest]) if key else "",
        )


def _kept_film(kept: KeptEvidence | None, key: str) -> ReadClip | None:
    old = read_drawn(kept, key)
    return old.films[0] if old is not None and len(old.films) == 1 else None


def _beside(clip: Clip, film: ReadClip, row: Row, name: str) -> Clip:
    missed = row.waypoints_reached + 1
    until = ", until its trial ends"
    if missed <= row.waypoints_total:
        until = f", until it reaches waypoint {missed} or its trial ends"
    return replace(
        clip,
        baseline=film_of(film),
        baseline_caption=f"baseline {name} from the same initial state{until}",
    )


def _made(
    wanted: Sequence[_Wanted],
    folder: RunFolder,
    policy: BaselinePolicy,
    rivals: Rivals,
    run: RunInfo,
) -> dict[str, ReadClip]:
    """Return films by the candidate's trial, run and drawn now.

    Raises:
        NwEvalError: the baseline's policy is not there, or a trial of it failed.
    """
    from nw_sim.catalogue import open_scene
    from nw_sim.rollout.replaying.apart import scratch_folder, take_over_apart
    from nw_sim.rollout.replaying.logged import read_logged_trial

    beside = _beside_logs(wanted, folder, rivals)
    to_run = [each for each in wanted if each.trial not in beside]
    allows = run.request is not None and run.request.allow_code
    with scratch_folder() as scratch:
        found = dict(beside)
        if to_run:
            bundle = _bundle(policy, str(run.suite.get("robot", "")), allow_code=allows)

            faults: list[NwEvalError] = []

            def run_one(number: int) -> Path | None:
                out = scratch / f"{number}.mcap"
                try:
                    take_over_apart(
                        to_run[number].log,
                        start=0.0,
                        policy=bundle.reference,
                        allow_code=allows,
                        out=out,
                        record="none",
                        time_limit=_SECONDS,
                    )
                except NwEvalError as error:  # It costs its own film alone.
                    faults.append(error)
                    return None
                return out

            with ThreadPoolExecutor(max_workers=_AT_ONCE) as pool:
                made = list(pool.map(run_one, range(len(to_run))))
            found |= {each.trial: path for each, path in zip(to_run, made, strict=True) if path}
            if not found:
                raise faults[0]
        wanted = [each for each in wanted if each.trial in found]
        jobs = {each.trial: read_logged_trial(found[each.trial]).job for each in wanted}
        scenes = {
            each.scene: (job.scene, open_scene(job.scene, job.collision))
            for each in wanted
            for job in [jobs[each.trial]]
        }
        robots = {job.robot_folder for job in jobs.values() if job.robot_folder is not None}
        drawn = drawn_apart(
            [
                WantedLog(
                    path=found[each.trial], scene=each.scene, clip=True, waypoint=each.waypoint
                )
                for each in wanted
            ],
            [],
            scenes,
            [folder.path.resolve(), scratch, *sorted(robots)],
        )
    films = zip(wanted, drawn.films, strict=True)
    return {each.trial: film for each, film in films if film is not None}


def _beside_logs(wanted: Sequence[_Wanted], folder: RunFolder, rivals: Rivals) -> dict[str, Path]:
    """Return logs of trials that the baseline's policy ran beside the candidate."""
    rows = {each.trial: rivals.get(each.trial) for each in wanted}
    known = {trial: row for trial, row in rows.items() if isinstance(row, Row)}
    logs = present_logs(folder.baseline, known.values())
    return {trial: logs[row.trial_id] for trial, row in known.items() if row.trial_id in logs}


def _bundle(policy: BaselinePolicy, robot: str, *, allow_code: bool) -> Bundle:
    """Return the baseline's policy.

    Raises:
        PolicyError: it is not there, or cannot be used.
        IncomparableError: it is another one.
    """
    from nw_policies import find_card, load_bundle
    from nw_sim.rollout.confined.vetting import vet_bundle

    bundle = load_bundle(find_card(policy.card or policy.name))
    if (bundle.checkpoint_digest, bundle.digest) != (policy.checkpoint_digest, policy.card_digest):
        raise IncomparableError(
            f"{bundle.where} is no longer the policy that the baseline was saved with"
        )
    if bundle.card.adapter == "remote":
        raise IncomparableError(f"{bundle.where} is on a server, which a report does not ask")
    return vet_bundle(bundle, robot, allow_code=allow_code)
