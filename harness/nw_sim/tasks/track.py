"""The task `track`: follow the reference motion of the suite, or of the policy's card."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from nw_base.errors import PolicyError
from nw_base.memory import pack, unpack
from nw_base.words import Outcome
from nw_gate.scores import ScoreSpec
from nw_gate.scores.score import lower_better
from nw_sim.tasks.course import Limits, draw_start, touched_by
from nw_sim.tasks.reference import Errors, PlacedReference, conjugate, errors_of, product, turned
from nw_sim.tasks.task import (
    Goal,
    Place,
    Readings,
    StartPose,
    Streams,
    TaskEvent,
    TaskFault,
    TaskPart,
    TaskRobot,
    TaskRules,
    TaskSettings,
    TimedTask,
)

_OFF = np.array([0.05, 0.05, 0.01, 0.1, 0.1, 0.2])
"""m and rad of roll, pitch and yaw: the `pose_range` of whole_body_tracking."""
_JOINTS_OFF = 0.1
"""rad, its `joint_position_range`."""
_TRACKS = "give track a policy with a reference motion, or add `reference` to its card"
NAMED = "name it in the suite: `task: {kind: track, motion: {file: FILE}}`, or on the card"


AnySettings = TypeVar("AnySettings", bound=TaskSettings)


class Lost(TaskPart):
    """When the motion is lost: the terminations of whole_body_tracking, with its thresholds."""

    height: float = Field(default=0.25, gt=0.0, le=10.0)
    """m by which the anchor may be higher or lower than the motion's."""
    tilt: float = Field(default=0.8, gt=0.0, le=2.0)
    """By which the upright part of the anchor's z axis may differ, which is 1 upright and 0 lying.
    """
    ends: float = Field(default=0.25, gt=0.0, le=10.0)
    """m by which an end effector may be higher or lower than the motion's."""


class Motion(TaskPart):
    """A motion that a suite names, in place of the one of the policy's card."""

    file: str = Field(min_length=1, max_length=1024)
    """Path, from the suite's folder."""
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None
    """Hex digest that the file must have; null = whatever lies there is taken, and recorded."""
    rate: Annotated[float, Field(ge=1.0, le=2000.0)] | None = None
    """Frames per second, Hz, where the file does not say it."""
    joints: Annotated[tuple[str, ...], Field(min_length=1, max_length=500)] | None = None
    """The joints of the file in its order, where it does not name them; null = as for a card."""


class TrackSettings(TaskSettings):
    """`task: track`."""

    kind: Literal["track"] = "track"
    start: Literal["drawn"] | Annotated[float, Field(ge=0.0)] = Field(
        default="drawn", union_mode="left_to_right"
    )
    """s into the motion where a trial begins, before its end; or `drawn`: evenly over the motion,
    by the trial's seed, so that `least` of it is left."""
    least: float = Field(default=1.0, gt=0.0, le=600.0)
    """s of the motion that a drawn start leaves."""
    jitter: float = Field(default=0.0, ge=0.0, le=2.0)
    """Share of the published ranges by which a start may differ from its frame: 0.05 m in the
    ground plane, 0.01 m of height, 0.1 rad of roll and pitch, 0.2 rad of yaw, and 0.1 rad of each
    joint."""
    lost: Lost = Lost()
    motion: Motion | None = None
    """The motion, in place of the card's; null = the card's."""

    @model_serializer(mode="wrap")
    def _without_absent(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out a motion that is not given: suites without one keep their digest."""
        fields: dict[str, Any] = dump(self)
        return {key: value for key, value in fields.items() if key != "motion" or value is not None}


def with_motion(task: AnySettings, place: Callable[[str], str]) -> AnySettings:
    """Return a task whose motion, if it names one, lies where `place` says of its file."""
    motion = getattr(task, "motion", None)
    if not isinstance(motion, Motion):
        return task
    return task.model_copy(
        update={"motion": motion.model_copy(update={"file": place(motion.file)})}
    )


class TrackTask(TimedTask):
    """Track a motion from a frame of it to its end, or until the trial's time is over.

    The robot begins in the pose and with the velocities of the frame. The trial ends when the
    motion is lost: as `fell` if the anchor is too low or tilted, as `off_course` if it is too high
    or an end effector is off; as `collided` by the robot's limit, if the suite has that; else as
    `completed`. Only heights count, as published: the position may drift, which a score shows.
    """

    kind = "track"
    settings = TrackSettings
    declared = (
        ScoreSpec(
            name="motion_tracked",
            unit="",
            better="higher",
            low=0.0,
            high=1.0,
            undefined=0.0,
            meaning="share of the motion from its start in the trial on until it was lost",
        ),
        lower_better(
            "joint_error", "rad", 1.0, "mean difference of the joints from those of the motion"
        ),
        lower_better(
            "body_position_error",
            "m",
            0.5,
            "mean distance of the bodies from those of the motion, brought to the robot's anchor",
        ),
        lower_better(
            "body_orientation_error",
            "rad",
            1.6,
            "mean angle between the bodies and those of the motion, turned to the robot's heading",
        ),
        lower_better(
            "anchor_error", "m", 2.0, "mean distance of the anchor from that of the motion"
        ),
    )

    def __init__(self, settings: TrackSettings, rules: TaskRules | None = None) -> None:
        super().__init__(rules)
        self._settings = settings
        self._limits = Limits()
        self._placed: PlacedReference | None = None
        self._sums = np.zeros(4)  # of the errors that scores average

    @classmethod
    def fault(
        cls, settings: TaskSettings, *, hears: frozenset[str], rules: TaskRules
    ) -> TaskFault | None:
        """Return that the policy's card names no motion."""
        del settings, rules
        if "motion" in hears:
            return None
        return TaskFault(
            ("kind",),
            "the policy tracks no motion: its card has no `reference`, and observes none",
            _TRACKS,
        )

    def reset(self, streams: Streams, scene: Place, robot: TaskRobot) -> Goal:
        """Draw the first frame, and how far from it the robot is.

        Raises:
            PolicyError: the policy has no motion, or one that ends before `start`.
        """
        motion = self._rules.reference
        if motion is None:
            raise PolicyError("neither the suite nor the policy's card names a motion", fix=NAMED)
        self._limits = Limits.of(robot)
        period, chosen = self._rules.control_period, self._settings.start
        last = len(motion) - 1
        if chosen == "drawn":
            most = max(last - max(1, round(self._settings.least / period)), 0)
            first = int(streams.generator("motion").integers(0, most + 1))
        else:
            if chosen / period > last - 1 + 1e-6:
                raise PolicyError(
                    f"task.start is {chosen:g} s, and the policy's motion has {last * period:g} s",
                    fix=f"give at most {(last - 1) * period:g}, or `start: drawn`",
                )
            first = round(chosen / period)
        spawn = scene.spawn
        goal = draw_start(
            streams,
            protocol=self._rules.protocol,
            spawn=(*spawn.position[:2], spawn.yaw),
            jitter=(spawn.x_jitter, spawn.y_jitter, spawn.yaw_jitter),
            trail=np.zeros((0, 3)),
            waypoint_noise=(0.0, 0.0),
        )
        place = (goal.x, goal.y, float(spawn.position[2]))
        self._placed = PlacedReference(motion, start=first, place=place, yaw=goal.yaw)
        self.steps = max(1, min(last - first, round(self._rules.duration / period)))
        self._begin_anew()
        self._sums[:] = 0.0
        self.goal = Goal(x=goal.x, y=goal.y, yaw=goal.yaw, pose=self._pose(streams))
        return self.goal

    def _pose(self, streams: Streams) -> StartPose:
        placed = self._tracked
        frame = placed.at(0)
        linear, angular = placed.velocities(0)
        position, quat, joints = frame.root_position, frame.root_quat, frame.joint_positions
        if self._settings.jitter:
            drawn = streams.generator("jitter").uniform(-1.0, 1.0, len(_OFF) + len(joints))
            drawn = drawn * self._settings.jitter
            x, y, z, *angles = (drawn[: len(_OFF)] * _OFF).tolist()
            position = position + np.array([x, y, z])
            for axis, turn in enumerate(angles):
                spin = np.zeros(4)
                spin[0], spin[1 + axis] = math.cos(turn / 2.0), math.sin(turn / 2.0)
                quat = product(spin, quat)
            joints = joints + drawn[len(_OFF) :] * _JOINTS_OFF
        rates = turned(conjugate(quat), angular)
        return StartPose(position, quat, linear, rates, joints, frame.joint_velocities)

    @property
    def _tracked(self) -> PlacedReference:
        assert self._placed is not None, "reset comes first"
        return self._placed

    @property
    def reference(self) -> PlacedReference | None:
        """The motion, where it lies in the trial."""
        return self._placed

    def update(self, readings: Readings) -> tuple[TaskEvent, ...]:
        """Compare the robot with the frame of the control step, and look whether it is lost.

        Raises:
            PolicyError: the motion was over before; another policy's, which was longer, was not.
        """
        if self.step >= self.steps:
            period = self._rules.control_period
            raise PolicyError(
                f"the policy's motion is over {self.steps * period:g} s after the trial's start, "
                f"and the policy begins to act after {self.step * period:g} s",
                fix="let it take over earlier, or give it a longer motion",
            )
        self.step += 1
        motion = self._tracked.motion
        place, quat = readings.body_poses((motion.anchor,))
        errors = errors_of(
            self._tracked.at(self.step),
            motion.ends,
            joint_positions=readings.joint_positions,
            anchor=(place[0], quat[0]),
            bodies=readings.body_poses(motion.bodies),
        )
        self._sums += errors.joints, errors.position, errors.orientation, errors.anchor
        has_collided = readings.monitored_force() > self._limits.monitored_force
        self._contact_steps += has_collided
        self._ended, self._reason = self._lost_by(errors)
        if self._ended is None and has_collided and self._rules.contact_termination:
            self._ended, self._reason = "collided", touched_by(readings)
        if self._ended is None and self.step >= self.steps:
            is_whole = self._tracked.start + self.step >= len(motion) - 1
            self._ended, self._reason = "completed", "end of the motion" if is_whole else "time"
        return ()

    def _lost_by(self, errors: Errors) -> tuple[Outcome | None, str]:
        lost = self._settings.lost
        if errors.tilt > lost.tilt:
            return "fell", "anchor tilt"
        if abs(errors.height) > lost.height:
            return ("fell" if errors.height > 0.0 else "off_course"), "anchor height"
        worst = int(errors.ends.argmax()) if len(errors.ends) else -1
        if worst >= 0 and errors.ends[worst] > lost.ends:
            motion = self._tracked.motion
            return "off_course", f"height of {motion.bodies[motion.ends[worst]]}"
        return None, ""

    @property
    def standing(self) -> str:
        """How much of the motion is tracked, in words."""
        period = self._rules.control_period
        first = self._tracked.start * period
        now, last = (first + count * period for count in (self.step, self.steps))
        return f"at {now:.2f} s of the motion, from {first:.2f} to {last:.2f} s"

    def scores(self) -> dict[str, float]:
        """Return the errors, averaged over the time until the motion was lost."""
        names = ("joint_error", "body_position_error", "body_orientation_error", "anchor_error")
        if not self.step:
            return {}
        done = self.step if self._ended in {"completed", None} else self.step - 1
        means = (self._sums / self.step).tolist()
        return {"motion_tracked": done / self.steps, **dict(zip(names, means, strict=True))}

    def state(self) -> dict[str, bytes]:
        """Return what it counts."""
        counts = np.array([self.step, self._contact_steps], dtype=np.int64)
        return {"track": pack({"counts": counts, "sums": self._sums})}

    def restore(self, state: Mapping[str, bytes]) -> None:
        """Go back, or on, to a `state`."""
        arrays = unpack(state["track"])
        self.step, self._contact_steps = arrays["counts"].tolist()
        self._sums[:] = arrays["sums"]
