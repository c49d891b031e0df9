"""A trial's log as a page shows it: what stands, what moves, what was seen, and what happened."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import PolicyError, StoreError
from nw_policies.cards.load import CARD_FILE, parse_card
from nw_policies.cards.observations import CameraObservation
from nw_scenes.robots import get_robot, know_robot
from nw_sim.rollout.mcap.topics import MOTION
from nw_sim.rollout.replaying.logged import LoggedTrial, read_logged_trial

F64 = NDArray[np.float64]

APART = 0.05
"""Metres between two trunks at one time, from which on the trials have diverged."""
_TOPICS = ("/scene", "/tf", "/waypoints", "/log", "/robot/joints", "/robot/command", "/nw/policy")


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """Numbers over time.

    Attributes:
        title: of the plot.
        times: (T,) s.
        values: (T, n).
        names: n of them.
    """

    title: str
    times: F64
    values: F64
    names: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One trial.

    Attributes:
        logged: the log.
        name: of the trial.
        times: (T,) s, of the poses.
        bodies: positions (T, 3) m and quaternions (T, 4) wxyz in the world, by name, the trunk
            first.
        entities: what stands in the scene and what hangs on a body, as the log has it.
        waypoints: (K, 3) m.
        events: times, s, and what happened then.
        series: what is plotted.
        frames: times, s, of the ego camera's pictures, ascending, and the pictures (H, W, 3); none
            where they were not kept.
        is_seen: whether the policy was given these pictures; None where that is not known.
        ghost: as `bodies`, where they should have been by the motion that was to be tracked; empty
            where none was.
    """

    logged: LoggedTrial
    name: str
    times: F64
    bodies: dict[str, tuple[F64, F64]]
    entities: tuple[Any, ...]
    waypoints: F64
    events: tuple[tuple[float, str], ...]
    series: tuple[Series, ...]
    frames: tuple[F64, tuple[NDArray[np.uint8], ...]]
    is_seen: bool | None
    ghost: dict[str, tuple[F64, F64]] = field(default_factory=dict[str, tuple[F64, F64]])

    @property
    def trunk(self) -> F64:
        """Where the trunk was, (T, 3) m."""
        return next(iter(self.bodies.values()))[0]

    @property
    def end(self) -> float:
        """The last time, s."""
        return float(self.times[-1])

    def at(self, time: float) -> int:
        """Return the number of the newest pose at a time; the first before it."""
        return max(0, int(np.searchsorted(self.times, time + 1e-6, side="right")) - 1)

    def picture(self, time: float) -> NDArray[np.uint8] | None:
        """Return the newest picture of the ego camera at a time, (H, W, 3)."""
        times, pictures = self.frames
        place = int(np.searchsorted(times, time + 1e-6, side="right")) - 1
        return pictures[place] if place >= 0 else None


def parting(one: Trace, other: Trace) -> float | None:
    """Return the first time, s, at which two robots are `APART`; None while both walk as one.

    Raises:
        ValueError: a trace has no poses.
    """
    count = min(len(one.times), len(other.times))
    off = np.linalg.norm(one.trunk[:count] - other.trunk[:count], axis=1) > APART
    return float(one.times[int(np.argmax(off))]) if off.any() else None


def read_trace(path: Path) -> Trace:
    """Read a trial's log.

    Raises:
        StoreError: it is no log, or damaged.
        UsageError: it is of a robot that is not known here.
    """
    logged = read_logged_trial(path)
    messages: defaultdict[str, list[tuple[float, Any]]] = defaultdict(list)
    for topic, time_ns, message in logged.log.messages(*_TOPICS):
        messages[topic].append((time_ns * 1e-9, message))
    try:
        trace = _trace(logged, messages)
        return replace(trace, ghost=_ghost(logged, trace.times))
    except (ValueError, LookupError) as error:
        reason = clean(error, at_most=200)
        raise StoreError(f"{path} is damaged: {reason}", fix="run the trial again") from error


def _trace(logged: LoggedTrial, messages: dict[str, list[tuple[float, Any]]]) -> Trace:
    entities = tuple(e for _, update in messages["/scene"] for e in update.entities)
    frames = {e.frame_id: e.id for e in entities if e.id.startswith(("robot/", "prop/"))}
    names = [name for name in _bodies(logged) if name in frames]
    names += [name for name, entity in frames.items() if entity == name]  # A prop's.
    times, bodies = _poses(messages["/tf"], names)
    discs = messages["/waypoints"][0][1].entities
    points = [each.cylinders[0].pose.position for each in discs]
    ego = [(time, picture) for time, picture in logged.log.frames("ego") if picture.ndim == 3]
    return Trace(
        logged=logged,
        name=clean(logged.job.trial.id, at_most=200),
        times=times,
        bodies=bodies,
        entities=entities,
        waypoints=np.array([(p.x, p.y, p.z) for p in points]).reshape(-1, 3),
        # The first line says which trial it is.
        events=tuple(
            (time, clean(line.message, at_most=200))
            for time, line in messages["/log"]
            if time > 0.0
        ),
        series=_series(messages, logged.log.elements()),
        frames=(np.array([time for time, _ in ego]), tuple(picture for _, picture in ego)),
        is_seen=_is_seen(logged),
    )


def _ghost(logged: LoggedTrial, times: F64) -> dict[str, tuple[F64, F64]]:
    """Return where the bodies of a robot should have been at times, s; empty without a motion."""
    if MOTION not in logged.log.attachments():
        return {}
    from nw_sim.rollout.library import Library
    from nw_sim.rollout.replaying.policy_switch import open_replayed

    with open_replayed(logged, Library()) as trial:
        world, placed = trial.episode.world, trial.episode.task.reference
        if placed is None:
            return {}
        frames = [placed.at(round(time * world.control_rate)) for time in times.tolist()]
        root = np.array([[*one.root_position, *one.root_quat] for one in frames])
        angles = np.array([one.joint_positions for one in frames])
        places, quats = world.kinematics(root, angles, world.robot.bodies)
    return {
        name: (places[:, number], quats[:, number])
        for number, name in enumerate(world.robot.bodies)
    }


def _is_seen(logged: LoggedTrial) -> bool | None:
    """Whether the policy was given the pictures of the ego camera, as the card in the log says.

    For a policy that is given no camera's image, the log has a camera of its own there.
    """
    text = logged.log.attachments().get(CARD_FILE, b"").decode("utf-8", "replace")
    try:
        card = parse_card(text, file=CARD_FILE)
    except PolicyError:  # A log of another version, or of no card: then nothing is claimed.
        return None
    return any(isinstance(seen, CameraObservation) for seen in card.observations.values())


def _bodies(logged: LoggedTrial) -> tuple[str, ...]:
    know_robot(logged.job.robot, logged.job.robot_folder)
    return get_robot(logged.job.robot).bodies


def _poses(
    messages: list[tuple[float, Any]], frames: list[str]
) -> tuple[F64, dict[str, tuple[F64, F64]]]:
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in frames}
    times: list[float] = []
    for time, message in messages:
        times.append(time)
        for each in message.transforms:
            if each.child_frame_id in rows:
                p, q = each.translation, each.rotation
                rows[each.child_frame_id].append((p.x, p.y, p.z, q.w, q.x, q.y, q.z))
    poses = {name: np.array(row) for name, row in rows.items()}
    if not times or not poses or any(len(row) != len(times) for row in poses.values()):
        raise ValueError("a body has no pose at some time")
    return np.array(times), {name: (row[:, :3], row[:, 3:]) for name, row in poses.items()}


def _series(
    messages: dict[str, list[tuple[float, Any]]], elements: dict[str, tuple[str, ...]]
) -> tuple[Series, ...]:
    joints, commands = messages["/robot/joints"], messages["/robot/command"]
    actions = messages["/nw/policy"]
    series: list[Series] = []
    if joints:
        series.append(
            Series(
                title="Joint angles, rad",
                times=np.array([time for time, _ in joints]),
                values=np.array([[joint.position for joint in m.joints] for _, m in joints]),
                names=tuple(joint.name.removesuffix("_joint") for joint in joints[0][1].joints),
            )
        )
    if commands:
        series.append(
            Series(
                title="Command, m/s and rad",
                times=np.array([time for time, _ in commands]),
                values=np.array([[m.forward, m.heading_error] for _, m in commands]),
                names=("forward", "heading error"),
            )
        )
    if actions:
        series.append(
            Series(
                title="Action",
                times=np.array([time for time, _ in actions]),
                values=np.array([list(m.action) for _, m in actions]),
                names=elements.get("/nw/policy.action", ()),
            )
        )
    return tuple(series)
