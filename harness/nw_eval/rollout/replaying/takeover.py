"""Runs a recorded trial in which another policy takes over, from exactly the recorded state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from nw_eval.errors import StoreError
from nw_eval.robots import get_robot
from nw_eval.rollout.library import Library
from nw_eval.rollout.mcap.trial_log import TrialLog
from nw_eval.rollout.prepare import OpenTrial, open_trial
from nw_eval.rollout.record import verdict_metadata as as_metadata
from nw_eval.rollout.recorder import Recorder
from nw_eval.rollout.replaying.logged import (
    LoggedTrial,
    agreed,
    check_inside,
    check_start,
    read_logged_trial,
    step_at,
)
from nw_eval.rollout.replaying.policy_switch import (
    PolicySwitch,
    carried,
    driver,
    lead_to,
    new_switch,
    run_on,
)
from nw_eval.rollout.replaying.reports import Ending, TakeoverReport
from nw_eval.rollout.result import StageClock
from nw_eval.sensors.check import check_card

if TYPE_CHECKING:
    from pathlib import Path

    from nw_eval.rollout.episode import Observer
    from nw_eval.rollout.job import TrialJob
    from nw_eval.rollout.replaying.film import Film
    from nw_eval.rollout.result import TrialResult
    from nw_eval.sim import World

OPTION = "--from"


@dataclass(frozen=True, kw_only=True)
class TakenOver:
    """A trial that was taken over, and its result."""

    result: TrialResult
    report: TakeoverReport


def take_over(
    path: Path,
    *,
    start: float,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    library: Library | None = None,
    out: Path | None = None,
    film: Film | None = None,
) -> TakenOver:
    """Run a recorded trial in which another policy acts from a moment on.

    Until then the trial goes its recorded way, to the bit, and the other policy looks on (`lead`).

    Args:
        path: the trial's log.
        start: seconds, at least 0 and before the trial's end.
        policy: the bundle that takes over; the one that the log names if None.
        checkpoint: weights in place of those that its card names.
        allow_code: as for a run.
        library: scenes and bundles that are loaded already.
        out: where the log of the new trial goes; None = nowhere.
        film: takes pictures of all of it; None for none.

    Raises:
        StoreError: the log cannot be read, holds no card, or the trial does not go its recorded way
            here; the new log cannot be written.
        PolicyError: the bundle is missing, does not fit the robot, or needs the caller's word.
        SceneError, UsageError: the scene is missing, or has changed; `start` is no time in the
            trial, or behind where it was taken over already.
        TrialError: the policy fails while it looks on.
    """
    check_start(start, option=OPTION)
    library = library or Library()
    recorded = read_logged_trial(path)
    check_inside(start, recorded, option=OPTION)
    step = step_at(start, recorded.control_rate)
    switch = new_switch(recorded, step)
    job = second_job(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    bundle = library.bundle_of(job)
    job = replace(job, mcap=out, record="all", attachments=carried(recorded, bundle, switch))
    with open_trial(job, library, StageClock()) as trial:
        result = _driven(trial, recorded, switch, library, film)
        was, now = recorded.verdict, as_metadata(result)
        last = _last_place(recorded, trial.robot.bodies[0])
        report = TakeoverReport(
            trial=job.trial.id,
            step=step,
            was=Ending.of(was, policy=driver(recorded.job), position=last),
            now=Ending.of(now, policy=driver(job), position=_xyz(trial.episode.world)),
        )
    return TakenOver(result=result, report=report)


def _driven(
    trial: OpenTrial,
    recorded: LoggedTrial,
    switch: PolicySwitch,
    library: Library,
    film: Film | None,
) -> TrialResult:
    """Lead a trial to where its policy takes over, let it, and record and film all of that."""
    log = TrialLog(trial.job.mcap, record="all")
    recorder = Recorder(trial, log, StageClock())
    observers: list[Observer] = [recorder]
    recorder.start()
    if film is not None:
        observers.append(film.begun(trial, driver=switch.policy))
    lead_to(switch.step, trial, recorded, library, *observers)
    words = f"{driver(trial.job)} takes over from {switch.policy}"
    log.event(trial.episode.world.time, "start", words, step=switch.step)
    if film is not None:
        film.hand_over(driver(trial.job))
    result = run_on(trial, *observers)
    recorder.end(result)
    if film is not None:
        film.end(result)
    if log.error:
        raise StoreError(f"the log of the new trial is lost: {log.error}")
    return result


def second_job(
    path: Path,
    *,
    policy: str | None,
    checkpoint: Path | None,
    allow_code: bool,
    library: Library,
) -> TrialJob:
    """Return the trial of a log as one of the policy that is to take over; as for `take_over`.

    Raises:
        StoreError, PolicyError: as `agreed`; or the policy does not fit the robot.
    """
    job = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    ).job
    bundle = library.bundle_of(job)
    code_from = bundle.folder if allow_code else None
    check_card(bundle.card, get_robot(job.robot), where=bundle.card_path, code_from=code_from)
    digest = "" if bundle.card.adapter == "remote" else bundle.checkpoint_digest
    return replace(job, policy_name=bundle.name, checkpoint_digest=digest)


def _xyz(world: World) -> tuple[float, float, float]:
    x, y, z = world.trunk_position.tolist()
    return x, y, z


def _last_place(recorded: LoggedTrial, trunk: str) -> tuple[float, float, float] | None:
    """Return where the recorded trial ended."""
    last = None
    for _, poses in recorded.log.poses():
        last = poses.get(trunk)
    if last is None:
        return None
    x, y, z = last[0].tolist()
    return x, y, z
