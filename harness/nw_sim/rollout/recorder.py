"""Looks on as an episode runs, and writes down what happens."""

from __future__ import annotations

from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_gate.scores.score import STRETCH
from nw_policies.cards.model import CONTROL_RATE
from nw_sim.rollout.driven import packed_programs
from nw_sim.rollout.episode import Observer
from nw_sim.rollout.job import policy_fault
from nw_sim.rollout.mcap.steps import Call, StepNote
from nw_sim.rollout.mcap.topics import ELEMENTS, SHUTTERS
from nw_sim.rollout.observed import LOG_CAMERA, LogCamera, Seen
from nw_sim.rollout.record import PROVENANCE, TRIAL, provenance, trial_metadata, verdict_metadata
from nw_sim.rollout.referenced import packed_motion
from nw_sim.sensors.proprio import velocity_at

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nw_sim.rollout.episode import Decision, Episode, Step
    from nw_sim.rollout.job import StageClock, TrialResult
    from nw_sim.rollout.mcap.trial_log import EventKind, TrialLog
    from nw_sim.rollout.opening import OpenTrial
    from nw_sim.tasks import TaskEvent

Array = NDArray[np.float64]

# Steps of 0.02 s between two restartable states in the log: 5 Hz, or 2 Hz for states that hold
# stacks of images, which would otherwise be most of the file. What lies between two is run again.
STATE_PERIOD, LARGE_STATE_PERIOD = 10, 25
LARGE_STATE = 32 * 1024  # bytes
# The walked path has a point at 10 Hz, and is written at 2 Hz.
PATH_PERIOD, PATH_SHOWN = 5, 25
# A camera image that the splat covers less than this is an event in the log.
_LOW_COVERAGE = 0.9


class Recorder(Observer):
    """Writes one trial's log. Where there is no log, it does nothing.

    Args:
        trial: stands at its first control step.
        log: where to write.
        clock: writing counts as `log`.
    """

    def __init__(self, trial: OpenTrial, log: TrialLog, clock: StageClock) -> None:
        self._trial = trial
        self._episode = trial.episode
        self._log = log
        self._clock = clock
        self._events = Events(trial.episode, log)
        self._seen = Seen(
            card=trial.bundle.card,
            sensors=trial.episode.sensors,
            world=trial.episode.world,
            log=log,
        )
        self._camera = LogCamera(
            needed=not self._seen.views,
            world=trial.episode.world,
            scene=trial.scene,
            renderer=trial.renderer,
            log=log,
            clock=clock,
        )
        own = (LOG_CAMERA,) if self._camera.is_on else ()
        self._mounts = tuple(dict.fromkeys((*(view.mount for view in self._seen.views), *own)))
        self._state_due = True
        self._measures = bool(trial.job.scores)
        self._share = trial.episode.world.control_rate / CONTROL_RATE
        self._state_period = self._steps(STATE_PERIOD)
        self._path_period = self._steps(PATH_PERIOD)
        self._policy_digest = b""  # of the policy, where this step has a state

    def start(self) -> None:
        """Write what does not change, and that the trial begins."""
        job = self._trial.job
        if not self._log.is_open:
            return
        x, y, _ = self._episode.world.trunk_position.tolist()
        shutters = self._seen.shutters()
        placed = self._episode.task.reference
        self._log.start(
            robot=self._trial.robot,
            mesh=self._trial.scene.mesh(),
            start=(x, y, self._trial.scene.spawn.position[2]),
            trail=self._episode.task.goal.waypoints,
            bodies=self._episode.world.bodies,
            in_model=self._episode.world.body_count,
            cameras={mount: self._episode.world.mounted(mount) for mount in self._mounts},
            seen=self._seen.rows,
            command=partial(velocity_at, self._trial.bundle.card.command),
            metadata={
                TRIAL: trial_metadata(job),
                PROVENANCE: provenance(is_planned=self._trial.bundle.card.is_planned),
                ELEMENTS: self._seen.elements(),
                **({SHUTTERS: shutters} if shutters else {}),
            },
            attachments=job.attachments,
            motion=b"" if placed is None else packed_motion(placed.motion),
            motors=packed_programs(self._episode.world.drives),
            props=self._trial.scene.props,
            prop_bodies=self._episode.world.props,
        )
        self._seen.calibrate()
        self._camera.calibrate()
        self._events.write("start", f"trial {job.trial.id} of suite {job.trial.suite}")

    def before(self) -> None:
        """Write a restartable state, where it is time for one."""
        episode = self._episode
        if self._log.is_open and (self._state_due or episode.step % self._state_period == 0):
            with self._clock("log"):
                saved = episode.saved()
                if saved.exceeds(LARGE_STATE):
                    self._state_period = self._steps(LARGE_STATE_PERIOD)
                self._log.state(episode.world.time, saved)
                self._policy_digest = sha256(saved.policy).digest()

    def decided(self, decision: Decision) -> None:
        """Write where the robot is, what the policy saw and what it answered."""
        if self._log.is_open:
            with self._clock("log"):
                self._write(decision)

    def advanced(self, step: Step) -> None:
        """Write what happened in the step."""
        self._state_due = False
        if self._log.is_open and self._measures and self._episode.step % STRETCH == 0:
            with self._clock("log"):
                self._log.scores(self._episode.world.time, self._episode.scores_so_far())
        if self._log.is_open and self._events.is_due(step.events):
            with self._clock("log"):
                self._state_due = self._events.notice(step.events)

    def end(self, result: TrialResult) -> None:
        """Write how the trial ended and close the log."""
        if not self._log.is_open:
            return
        episode = self._episode
        world = episode.world
        data = b"".join(map(np.ndarray.tobytes, (*world.moving(), world.torques)))
        self._log.step(StepNote(world.time, data, path="shown"))
        if result.status == "ok":
            self._log.state(episode.world.time, episode.saved())
            if self._measures:
                self._log.scores(episode.world.time, dict(result.scores))
            reached = (
                f"{result.waypoints_reached} of {result.waypoints_total} waypoints"
                if result.waypoints_total
                else episode.task.standing
            )
            self._events.write("end", f"{result.outcome} ({result.end_reason}): {reached}")
        else:
            fault = policy_fault(result)
            kind = result.error_type if fault is None else f"policy_failed ({fault})"
            self._events.write("error", f"{kind}: {result.error_text}")
        failed = result.outcome != "completed"
        keep = self._trial.job.record == "all" or failed
        self._log.finish(keep_images=keep, verdict=verdict_metadata(result))

    def _steps(self, count: int) -> int:
        """Return how many control steps last as long as `count` of 0.02 s, or about so."""
        return max(1, round(count * self._share))

    def _write(self, decision: Decision) -> None:
        step, moment = self._episode.step, decision.moment
        digest, rows = self._seen.rows.note(decision.observation)
        world = self._episode.world
        outputs = world.torques, decision.action, decision.applied, decision.targets
        data = b"".join((*map(np.ndarray.tobytes, (*world.moving(), *outputs)), *rows))
        error = None if moment is None else moment.delta_yaw
        asked = self._episode.task.command
        call = Call(step, self._policy_digest, error, digest, self._seen.new, asked)
        self._policy_digest = b""
        shown = self._path_period * (PATH_SHOWN // PATH_PERIOD)
        path = "none" if step % self._path_period else "point" if step % shown else "shown"
        self._log.step(StepNote(world.time, data, call, path))
        if self._seen.shows_pictures:
            self._seen.record_images(decision.observation)
        if self._camera.is_on:
            self._camera.record(step)


class Events:
    """Writes an event when something begins, not again while it lasts.

    Args:
        episode: that is watched.
        log: where events are written.
    """

    def __init__(self, episode: Episode, log: TrialLog) -> None:
        self._episode = episode
        self._log = log
        self._cameras = [each for each in episode.sensors.values() if each.is_image]
        self._touching = False
        self._covered = True

    def is_due(self, events: Sequence[TaskEvent]) -> bool:
        """Whether `notice` might find anything: it is cheaper to ask."""
        touches = self._episode.world.monitored_force() > 0.0
        return bool(events) or touches != self._touching or bool(self._cameras)

    def notice(self, events: Sequence[TaskEvent]) -> bool:
        """Write what began in the step that was just made.

        Args:
            events: of the task.

        Returns:
            Whether it is worth a restartable state: an event of the task, or a contact.
        """
        episode = self._episode
        for event in events:
            if event.kind == "waypoint":
                self._log.waypoints(episode.world.time, reached=episode.task.reached)
            self.write(event.kind, event.text, number=event.number)
        force = episode.world.monitored_force()
        touches = force > 0.0 and not self._touching
        if touches:
            forces = episode.world.monitored_forces()
            geom = max(forces, key=forces.__getitem__)
            self.write("contact", f"{geom} touches with {force:.1f} N", value=force)
        self._touching = force > 0.0
        self._notice_coverage()
        return bool(events) or touches

    def write(self, kind: EventKind, text: str, *, number: int = -1, value: float = 0.0) -> None:
        """Write an event of now."""
        episode = self._episode
        self._log.event(
            episode.world.time, kind, text, step=episode.step, waypoint=number, value=value
        )

    def _notice_coverage(self) -> None:
        if not self._cameras:
            return
        shares = [camera.coverage for camera in self._cameras if camera.coverage is not None]
        share = min(shares, default=1.0)
        covered = share >= _LOW_COVERAGE
        if self._covered and not covered:
            self.write("coverage", f"the splat covers {share:.0%} of the image", value=share)
        self._covered = covered
