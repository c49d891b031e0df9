"""Runs a recorded trial again: as it was, or with another policy that takes over.

A replay starts where the trial did or at a state in its middle, and compares bits; a takeover goes
on from exactly the recorded state. To attribute a failure, a baseline takes over the failed trial
at many moments, until the last is known that it completes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nw_base.errors import PolicyError, StoreError
from nw_gate.scores.own import is_code
from nw_scenes.robots import get_robot
from nw_sim.rollout.job import StageClock, TrialResult
from nw_sim.rollout.library import Library
from nw_sim.rollout.mcap.messages import SimState
from nw_sim.rollout.mcap.trial_log import TrialLog
from nw_sim.rollout.opening import OpenTrial, open_trial
from nw_sim.rollout.record import provenance
from nw_sim.rollout.record import verdict_metadata as as_metadata
from nw_sim.rollout.recorder import Recorder
from nw_sim.rollout.replaying.logged import (
    LoggedTrial,
    agreed,
    check_inside,
    check_start,
    read_logged_trial,
    step_at,
)
from nw_sim.rollout.replaying.policy_switch import (
    PolicySwitch,
    carried,
    driver,
    lead,
    lead_to,
    new_switch,
    run_on,
    switch_of,
)
from nw_sim.rollout.replaying.reports import (
    AttributionReport,
    Difference,
    Ending,
    ReplayReport,
    TakeoverReport,
    Try,
)
from nw_sim.sensors.build import check_card
from nw_sim.tasks import TrackSettings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path
    from typing import Any

    from nw_base.words import Record
    from nw_sim.physics import World
    from nw_sim.rollout.episode import Observer
    from nw_sim.rollout.job import TrialJob, TrialResult
    from nw_sim.rollout.opening import OpenTrial
    from nw_sim.rollout.replaying.film import Film


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """A trial that was run again, and its result."""

    logged: LoggedTrial
    result: TrialResult
    report: ReplayReport

    @property
    def is_identical(self) -> bool:
        """Whether the end is the recorded one, bit for bit."""
        return self.report.is_identical

    @property
    def start_step(self) -> int:
        """The control step from which on it was run."""
        return self.report.start_step


def replay(
    path: Path,
    *,
    start: float = 0.0,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    library: Library | None = None,
    film: Film | None = None,
) -> Replayed:
    """Run a recorded trial again and compare its end with the recorded one.

    The log may be untrusted, and so may the card that it names: what it says runs no code, opens
    no connection and writes nothing but caches. Only the caller's `allow_code` lets code run, and
    only a `policy` that the caller names is asked on a server.

    A trial that a policy took over is led there by its own log.

    Args:
        path: the trial's log.
        start: seconds; greater than 0 restores the last recorded state at or before it.
        policy: the bundle, where it has moved since, or is served elsewhere.
        checkpoint: weights that were used instead of the card's.
        allow_code: as for a run.
        library: scenes and bundles that are loaded already.
        film: takes pictures of what is run; None for none.

    Raises:
        StoreError: the log cannot be read, or has no state that early.
        PolicyError: the bundle is missing, is not the one that was recorded, or needs the caller's
            word.
        SceneError, UsageError: the scene is missing, or has changed; `start` is negative, no
            number, or not before the trial's end.
        TrialError: the recorded state does not fit.
    """
    check_start(start)
    library = library or Library()
    logged = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    check_inside(start, logged)
    job = logged.job
    with open_trial(job, library, StageClock()) as trial:
        earlier = switch_of(logged)
        if earlier is not None and step_at(start, logged.control_rate) < earlier.step:
            lead_to(earlier.step, trial, logged, library)
        elif start > 0.0:
            restore(trial, logged, start)
        start_step = trial.episode.step
        observers = () if film is None else (film.begun(trial, driver=driver(job)),)
        result = run_on(trial, *observers)
        if film is not None:
            film.end(result)
    was, replayed = logged.verdict, as_metadata(result)
    built, builds = logged.versions, provenance(is_planned=trial.bundle.card.is_planned)
    report = ReplayReport(
        trial=job.trial.id,
        start_step=start_step,
        steps=result.steps,
        end=replayed["outcome"] or replayed["error_type"],
        differences=_differences(
            (name for name in replayed if name != "error_text"), was, replayed
        ),
        versions=_differences(sorted({*built, *builds}), built, builds),
    )
    return Replayed(logged=logged, result=result, report=report)


def restore(trial: OpenTrial, logged: LoggedTrial, time: float) -> None:
    """Bring a trial to the last recorded state at or before `time` (s).

    Raises:
        StoreError: there is none.
        TrialError: the state does not fit the trial.
    """
    last = step_at(time, logged.control_rate)
    states = [state for state in logged.log.states() if state.step <= last]
    if not states:
        raise StoreError(f"{logged.path} has no state at or before {time:g} s", fix="run it all")
    trial.episode.restore(states[-1])


def _differences(
    names: Iterable[str], recorded: Mapping[str, str], replayed: Mapping[str, str]
) -> tuple[Difference, ...]:
    return tuple(
        Difference(name=name, recorded=recorded.get(name, ""), now=replayed.get(name, ""))
        for name in names
        if recorded.get(name) != replayed.get(name)
    )


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
    record: Record = "all",
) -> TakenOver:
    """Run a recorded trial in which another policy acts from a moment on.

    Until then the trial goes its recorded way, to the bit, and the other policy looks on (`lead`).

    Args:
        path: the trial's log.
        start: seconds, at least 0 and before the trial's end.
        policy: the bundle that takes over (default: the one that the log names).
        checkpoint: weights in place of those that its card names.
        allow_code: as for a run.
        library: scenes and bundles that are loaded already.
        out: where the log of the new trial goes; None = nowhere.
        film: takes pictures of all of it; None for none.
        record: whether that log keeps images: "all" or "none".

    Raises:
        StoreError: the log cannot be read, holds no card, or the trial does not go its recorded way
            here; the new log cannot be written.
        PolicyError: the bundle is missing, does not fit the robot, or needs the caller's word.
        SceneError, UsageError: the scene is missing, or has changed; `start` is not a time in the
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
    job = replace(job, mcap=out, record=record, attachments=carried(recorded, bundle, switch))
    with open_trial(job, library, StageClock()) as trial:
        result = _driven(trial, recorded, switch, library, film)
        was, replayed = recorded.verdict, as_metadata(result)
        last = _last_place(recorded, trial.robot.bodies[0])
        report = TakeoverReport(
            trial=job.trial.id,
            step=step,
            was=Ending.of(was, policy=driver(recorded.job), position=last),
            now=Ending.of(replayed, policy=driver(job), position=_xyz(trial.episode.world)),
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
    log = TrialLog(trial.job.mcap, record=trial.job.record)
    recorder = Recorder(trial, log, StageClock())
    observers: list[Observer] = [recorder]
    recorder.start()
    if film is not None:
        observers.append(film.begun(trial, driver=switch.policy))
    lead_to(switch.step, trial, recorded, library, *observers)
    text = f"{driver(trial.job)} takes over from {switch.policy}"
    log.event(trial.episode.world.time, "start", text, step=switch.step)
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
        StoreError, PolicyError: as `agreed`; or the policy does not fit the robot or the task.
    """
    job = agreed(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    ).job
    bundle = library.bundle_of(job)
    code_from = bundle.folder if allow_code else None
    check_card(bundle.card, get_robot(job.robot), where=bundle.card_path, code_from=code_from)
    if ("motion" in bundle.card.hears) != (job.task.kind == TrackSettings().kind):
        motion = "a motion" if "motion" in bundle.card.hears else "no motion"
        raise PolicyError(
            f"the policy {bundle.name!r} tracks {motion}, and the task of {path} is "
            f"{job.task.kind}",
            fix="let a policy take over that can do the recorded task",
        )
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


_MOST_KEPT = 256 * 2**20
"""Bytes of states that are kept; those of policies with stacked images have some 100 kB each."""
COARSE = 8
"""Intervals into which the moments are divided first."""


def attribute(
    path: Path,
    *,
    policy: str | None = None,
    checkpoint: Path | None = None,
    allow_code: bool = False,
    library: Library | None = None,
) -> AttributionReport:
    """Return from when on a recorded trial was lost to a baseline.

    The trial goes its recorded way once, the baseline looks on, and its states are kept; each try
    restores one of them and runs on. So it is what `take_over` gives at that moment, bit for bit.

    Args: as for `take_over`.

    Raises:
        StoreError, PolicyError, SceneError, UsageError, TrialError: as `take_over`.
    """
    library = library or Library()
    recorded = read_logged_trial(path)
    job = second_job(
        path, policy=policy, checkpoint=checkpoint, allow_code=allow_code, library=library
    )
    job = replace(job, mcap=None, scores=_looking_on(job))
    with open_trial(job, library, StageClock()) as trial:
        states, stride = _kept(lead(trial, recorded, library))
        if not states:
            raise StoreError(
                f"{path} does not record what was applied in its trial", fix="run the trial again"
            )
        limits = _limits(trial)
        tries: dict[int, Try] = {}

        def completes(step: int) -> bool:
            tries[step] = _tried(trial, states[step])
            return tries[step].completes

        order = search(sorted(states), completes)
    return AttributionReport(
        trial=job.trial.id,
        was=Ending.of(recorded.verdict, policy=driver(recorded.job), position=None),
        baseline=driver(job),
        tries=tuple(tries[step] for step in order),
        stride=stride,
        limits=limits,
    )


def _looking_on(job: TrialJob) -> tuple[str, ...]:
    """Return which scores look on: the trial's own, and the one that knows the robot's limits.

    A function of the suite does so only if its caller allows code.
    """
    if not job.scores:
        return ()
    allowed = (name for name in job.scores if job.allow_code or not is_code(name))
    return tuple(dict.fromkeys((*allowed, "limit_time")))


def _limits(trial: OpenTrial) -> dict[str, float]:
    """Return when limits were first passed in a trial until now, s, by score."""
    trial.episode.scores(None)  # Shows them the last steps.
    return trial.episode.limits_passed()


def _kept(states: Iterable[Any]) -> tuple[dict[int, bytes], int]:
    """Return states by control step, every n-th of them if all are too large, and n."""
    kept: dict[int, bytes] = {}
    stride, size = 1, 0
    for state in states:
        if state.step % stride:
            continue
        kept[state.step] = data = state.SerializeToString()
        size += len(data)
        while size > _MOST_KEPT:
            stride *= 2
            kept = {step: data for step, data in kept.items() if step % stride == 0}
            size = sum(map(len, kept.values()))
    return kept, stride


def _tried(trial: OpenTrial, state: bytes) -> Try:
    message = SimState.FromString(state)
    trial.episode.restore(message)
    result = run_on(trial)
    return Try(
        step=message.step,
        end=result.outcome or result.error_type or "",
        reason=result.end_reason or result.error_text,
        steps=result.steps,
        limits=_limits(trial),
    )


def search(moments: Sequence[int], holds: Callable[[int], bool]) -> dict[int, bool]:
    """Try some of many moments, so that the last one at which something holds is among them.

    First as many as divide all of them evenly, whatever comes of it; then by bisection between the
    last of these at which it holds and the next. It need not hold at all moments before: of what
    lies between two that were tried, nothing is known.

    Args:
        moments: in their order, at least one.
        holds: whether it does at a moment.

    Returns:
        What was tried, in the order of the moments, and whether it held.
    """
    last = len(moments) - 1
    grid = np.unique(np.linspace(0, last, COARSE + 1).round().astype(int)).tolist()
    tried = {place: holds(moments[place]) for place in grid}
    held = [place for place in grid if tried[place]]
    if held and held[-1] != last:
        low = held[-1]
        high = grid[grid.index(low) + 1]
        while high - low > 1:
            middle = (low + high) // 2
            tried[middle] = holds(moments[middle])
            low, high = (middle, high) if tried[middle] else (low, middle)
    return {moments[place]: tried[place] for place in sorted(tried)}


def most_tries(count: int) -> int:
    """Return how many of `count` moments `search` tries at most."""
    return min(count, COARSE + 1 + max(0, int(np.ceil(np.log2(max(1.0, count / COARSE))))))
