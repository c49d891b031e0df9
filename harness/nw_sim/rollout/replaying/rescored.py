"""Scores of a log, by the code that measures trials as they run.

The log of a run leads its trial once more: the robot is moved by what the log says was applied, no
policy is asked, and the scores look on as they do in a run. So each score can be had that this
nw-eval knows, whatever the run's suite declared, and those that it did declare come out the same.

A robot's log (`robot_log`) has readings only, and gives the scores that those allow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError

from nw_base.errors import StoreError, UsageError
from nw_base.words import Outcome
from nw_gate.scores import (
    BUILT_IN,
    MissingReadingError,
    Score,
    ScoreSpec,
    TrialEnd,
    score_class,
    score_names,
    specs_of,
)
from nw_gate.scores.own import is_code
from nw_scenes.robots import know_robot
from nw_sim.rollout.confined.access import running_rules
from nw_sim.rollout.confined.isolated import call_isolated
from nw_sim.rollout.library import Library
from nw_sim.rollout.mcap.reader import LogReader
from nw_sim.rollout.record import TRIAL
from nw_sim.rollout.replaying.log_container import as_mcap
from nw_sim.rollout.replaying.logged import read_logged_trial
from nw_sim.rollout.replaying.policy_switch import (
    decisions,
    open_replayed,
    replay_bundle,
    switch_of,
)
from nw_sim.rollout.replaying.robot_log import RobotLog, read_robot_log
from nw_sim.tasks import declared_by

if TYPE_CHECKING:
    from nw_sim.rollout.replaying.logged import LoggedTrial

_TIME_LIMIT = 600.0
"""Seconds; to lead a trial of a minute takes some ten."""


@dataclass(frozen=True, kw_only=True)
class LogScores:
    """The scores of one log."""

    log: Path
    seconds: float
    """Simulated, or measured on the robot's clock."""
    values: Mapping[str, float]
    """Of those that the log allows and that are defined, by name, each in its unit."""
    moments: Mapping[str, float]
    """When a limit was first passed, s: of `limit_time`, and of what the suite expects."""
    missing: Mapping[str, str]
    """Why the others are not there, by name."""
    specs: Mapping[str, ScoreSpec]
    """Declarations of all that were asked for."""
    topics: Mapping[str, str]
    """Of a robot's log: which topic each reading was taken from."""
    recorded: Mapping[str, float]
    """Of a run's log: what the run itself measured."""
    restored: int = 0
    """Of a run's log: how often the trial went another way here than recorded, as on a CPU of
    another kind, and went on from the next state of the log."""
    unused: Mapping[str, str] = field(default_factory=dict[str, str])
    """Of a robot's log: why other topics were not read."""
    fields: Mapping[str, Mapping[str, str]] = field(default_factory=dict[str, Mapping[str, str]])
    """Of a robot's log: by topic that was read, what became of the fields of its messages."""
    notes: Sequence[str] = ()
    """Of a robot's log: what is doubtful, and what was left out."""


def scores_of_log(
    path: Path,
    *,
    names: Sequence[str],
    robot: str | None,
    topics: Mapping[str, str],
    allow_code: bool = False,
) -> LogScores:
    """Return the scores of a log; a run's is led in a process of its own.

    Args:
        path: an MCAP file, or the folder of a bag with one.
        names: of the scores; empty = all.
        robot: whose log it is; of a run's, the log says it.
        topics: of a robot's log, from which readings are taken: see `read_robot_log`.
        allow_code: whether Python functions that the log of a run holds may run.

    Raises:
        CodeError: such a function was asked for, and may not.
        StoreError: the log cannot be read.
        UsageError: there is no such score or robot, or a robot's log names none.
        SceneError: the scene of the trial is not here.
    """
    with as_mcap(path) as log:
        return replace(_scores_of(log, names, robot, topics, allow_code=allow_code), log=path)


def _scores_of(
    path: Path,
    names: Sequence[str],
    robot: str | None,
    topics: Mapping[str, str],
    *,
    allow_code: bool,
) -> LogScores:
    asked = tuple(dict.fromkeys(names))
    if TRIAL in LogReader(path).metadata():
        if topics or robot is not None:
            raise UsageError(
                f"{path} is the log of a run and names its robot and topics",
                fix="drop --robot and --topic",
            )
        logged = read_logged_trial(path)
        own = {each.name: each for each in declared_by(logged.job.task)}
        texts = {
            each.partition("=")[0]: each
            for each in logged.job.scores
            if "=" in each and (asked or allow_code or not is_code(each))
        }
        specs = {
            **own,
            **{name: score_class(each, allow_code=allow_code).spec for name, each in texts.items()},
            **specs_of(name for name in asked or score_names() if name not in {*own, *texts}),
        }
        specs = {name: specs[name] for name in asked} if asked else specs
        measured = tuple(texts.get(name, name) for name in specs if name not in own)
        return _of_run(logged, measured, specs, allow_code=allow_code)
    names = asked or score_names()
    return _of_robot(path, names, specs_of(names), robot, topics)


def _of_run(
    logged: LoggedTrial,
    names: Sequence[str],
    specs: Mapping[str, ScoreSpec],
    *,
    allow_code: bool,
) -> LogScores:
    if switch_of(logged) is not None:
        raise StoreError(
            f"{logged.path} is of a trial that switched to another policy",
            fix="name the log of a run",
        )
    Library().scene(logged.job.scene, logged.job.collision)  # Its cache is out of reach there.
    folder = logged.job.robot_folder
    know_robot(logged.job.robot, folder)
    rules = running_rules(
        replay_bundle(logged),
        scenes=[logged.job.scene],
        also=[logged.path, *logged.job.also],
    )
    answer = call_isolated(
        _lead,
        subject=str(logged.path),
        rules=rules,
        time_limit=_TIME_LIMIT,
        log=str(logged.path.resolve()),
        names=list(names),
        allow_code=allow_code,
    )
    try:
        scores = TypeAdapter(_Rescored).validate_python(answer)
    except ValidationError:
        raise StoreError(f"{logged.path} gave no scores that can be read") from None
    missing = {name: "undefined in this trial" for name in specs if name not in scores.values}
    return LogScores(
        log=logged.path,
        seconds=scores.seconds,
        values={name: scores.values[name] for name in specs if name in scores.values},
        moments=scores.moments,
        missing=missing,
        specs=specs,
        topics={},
        recorded={name: value for name, value in _recorded(logged).items() if name in specs},
        restored=scores.restored,
    )


def _recorded(logged: LoggedTrial) -> dict[str, float]:
    try:
        return TypeAdapter(dict[str, float]).validate_json(logged.verdict.get("scores", "{}"))
    except ValidationError:
        return {}


@dataclass(frozen=True, kw_only=True)
class _Rescored:
    values: dict[str, float]
    moments: dict[str, float]
    seconds: float
    restored: int


def _lead(*, log: str, names: Sequence[str], allow_code: bool) -> dict[str, Any]:
    """Lead a trial along its log; return what was measured as plain values."""
    logged = read_logged_trial(Path(log))
    logged = replace(logged, job=replace(logged.job, scores=tuple(names), allow_code=allow_code))
    know_robot(logged.job.robot, logged.job.robot_folder)
    states = {state.step: state for state in logged.log.states()}
    restored, outcome = 0, None
    with open_replayed(logged, Library()) as replayed:
        leader = replayed.episode
        for decision in decisions(logged.log, joints=len(replayed.robot.joints)):
            state = states.get(leader.step)
            if state is not None:
                parts = {part.name: part.data for part in state.parts}
                if parts.get("state_digest") != leader.state_digest.state():
                    restored += 1
                    leader.world.restore(state.world)
                    leader.task.restore(parts)
                    leader.state_digest.restore(parts["state_digest"])
            outcome = leader.advance(decision).outcome
            if outcome is not None:
                break
        word = logged.verdict.get("outcome", "")
        if word in get_args(Outcome):
            outcome = cast("Outcome", word)
        values = dict(leader.scores(outcome))
        moments, seconds = leader.limits_passed(), leader.world.time
    return asdict(_Rescored(values=values, moments=moments, seconds=seconds, restored=restored))


def _of_robot(
    path: Path,
    names: Sequence[str],
    specs: Mapping[str, ScoreSpec],
    robot: str | None,
    topics: Mapping[str, str],
) -> LogScores:
    if robot is None:
        raise UsageError(
            f"{path} is not the log of a run, and does not name its robot",
            fix="name the robot with --robot",
        )
    read = read_robot_log(path, robot=robot, topics=topics)
    values: dict[str, float] = {}
    missing: dict[str, str] = {}
    moments: dict[str, float] = {}
    fell = "" if read.fell is None else f"the trunk lies on its side at {read.fell:.4g} s"
    end = TrialEnd(outcome="fell" if fell else None, seconds=read.seconds, success=float("nan"))
    for name in names:
        score = score_class(name)(read.figures)
        try:
            value = _value(score, read, end)
        except MissingReadingError as error:
            missing[name] = read.lacks(error.reading)
            continue
        if name == "time_to_finish":
            missing[name] = "undefined: the log does not say how the task ended"
        elif name == "distance_before_fall" and (fell or len(read.stretches) > 1):
            missing[name] = f"undefined: {fell or 'the way in a pause of the log is unknown'}"
        elif value is None or not np.isfinite(value):
            unknown = fell if value is None else read.empty.get("tilt")
            missing[name] = unknown or "undefined in this log"
        else:
            values[name] = float(value)
            if (moment := score.moment()) is not None:
                moments[name] = float(read.ends[round(moment / read.figures.control_period) - 1])
    return LogScores(
        log=path,
        seconds=read.seconds,
        values=values,
        moments=moments,
        missing=missing,
        specs=specs,
        topics=read.topics,
        unused=read.unused,
        fields=read.fields,
        notes=(*read.notes, fell) if fell else read.notes,
        recorded={},
    )


def _value(score: Score, read: RobotLog, end: TrialEnd) -> float | None:
    """Return the value of a score; None, too, of a package's in a log with pauses."""
    if len(read.stretches) > 1 and not score.joined and score.spec.name not in BUILT_IN:
        return None
    fresh = score.state()
    for stretch in read.stretches:
        for joined in score.joined:
            setattr(score, joined, fresh[joined])
        score.update(stretch)
    return score.value(end)
