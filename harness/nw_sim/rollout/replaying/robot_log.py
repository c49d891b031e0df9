"""Readings of a robot's own log: an MCAP file, or the MCAP file of a ROS 2 bag.

Which topics are taken follows from what their messages are. They have rates of their own: each
reading is the newest message of its topic at the end of a physics step, as many of which stand in a
control step of 1 / 50 s as joints are logged, so that a score means what it means in simulation.
Readings that two sources tell otherwise, or that were not measured, are left out with the reason.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.decoder import DecoderFactory

from nw_base.clean import clean
from nw_base.errors import StoreError, UsageError, nearest
from nw_base.plural import plural
from nw_gate.scores.score import Array, Figures, Stretch
from nw_policies.cards.model import CONTROL_RATE
from nw_scenes.robots import RobotSpec, get_robot
from nw_sim.catalogue import get_scene
from nw_sim.physics import World
from nw_sim.rollout.mcap.reader import DAMAGE, CompressionError, foreign
from nw_sim.rollout.replaying.log_clock import Stamps, common, on_one_clock, stretches
from nw_sim.rollout.replaying.log_container import ROS_1
from nw_sim.rollout.replaying.log_doubts import Readings, doubt
from nw_sim.rollout.replaying.log_messages import (
    FIELDS,
    IMU,
    JOINTS,
    TARGETS,
    Values,
    decoded,
    frames_of,
    kind_of,
    noted_in,
    stamp_of,
    unreadable,
    values_of,
)

_SOURCES: dict[str, tuple[tuple[str, ...], ...]] = {
    "joints": tuple((kind,) for kind in JOINTS),
    "targets": tuple((kind,) for kind in TARGETS),
    "pose": (
        ("nav_msgs/msg/Odometry",),
        ("geometry_msgs/msg/PoseStamped",),
        ("foxglove.PoseInFrame",),
        (IMU,),
    ),
    "command": (("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"),),
}
"""What is looked for, and in which messages, the best first; equally good ones stand together."""
SOURCES = tuple(_SOURCES)
_TOLD = re.compile(
    r"^(actions?|desired|goals?|input|joy|ref|references?|teleop|cmd.*"
    r"|.*(cmds?|commands?|targets?|setpoints?))$"
)
"""Words in the name of a topic that says where the robot is to go."""
_MEASURED = frozenset(["actual", "encoders", "feedback", "measured", "state", "states"])
_NO_ANGLES = frozenset(["current", "effort", "efforts", "pwm", "torque", "torques", "velocity"])
_LONG_HELD = 1.0  # s that one command stands
_MOST_SUBSTEPS = 20  # 1 kHz
_FEWEST = 0.9 * CONTROL_RATE  # messages a second of joints and targets
_FEWEST_POSES = 4.5  # The trunk's way is sampled at 5 Hz.


@dataclass(frozen=True, kw_only=True)
class RobotLog:
    """What a log says, as scores are shown it."""

    figures: Figures
    stretches: tuple[Stretch, ...]
    """The control steps without a pause between them; readings that the log lacks are left out."""
    ends: Array
    """When each control step of all stretches ended, s from the first one's begin, (N,)."""
    fell: float | None
    """When the trunk lay on its side first, s; None where it never did."""
    topics: Mapping[str, str]
    """Topic by what was looked for, one of `SOURCES`."""
    empty: Mapping[str, str]
    """Readings that are not there, and why; those of a source by its name."""
    notes: tuple[str, ...]
    """What is doubtful, and what was left out."""
    unused: Mapping[str, str]
    """Why other topics were not read."""
    fields: Mapping[str, Mapping[str, str]]
    """By topic that was read, what became of the fields of its messages."""

    @property
    def seconds(self) -> float:
        """How much of the log is scored, s."""
        return len(self.ends) * self.figures.control_period

    def lacks(self, reading: str) -> str:
        """Return why there is no such reading."""
        if reading in self.empty:
            return self.empty[reading]
        source = _FROM.get(reading)
        if source is None:
            return f"no message has {reading.replace('_', ' ')}"
        if source in self.empty:
            return self.empty[source]
        if (topic := self.topics.get(source)) is not None:
            return f"{topic} has no {reading.replace('_', ' ')}"
        return f"no topic has {source}: {' or '.join(_kinds_of(source))}"


_FROM = {
    "torques": "joints",
    "joint_rates": "joints",
    "joint_positions": "joints",
    "targets": "targets",
    "position": "pose",
    "rotation": "pose",
    "world_velocity": "pose",
    "rates": "pose",
    "command": "command",
}


def _kinds_of(source: str) -> tuple[str, ...]:
    return tuple(kind for rank in _SOURCES[source] for kind in rank)


def read_robot_log(path: Path, *, robot: str, topics: Mapping[str, str]) -> RobotLog:
    """Return the readings of a log.

    Args:
        path: an MCAP file.
        robot: whose it is, as a suite names it.
        topics: by what is looked for, one of `SOURCES`; those that are left out are found.

    Raises:
        StoreError: the log is missing or damaged.
        UsageError: there is no such robot or topic, several topics could be meant, a message lacks
            a joint of the robot, joints are logged too seldom, or no time of them is known.
    """
    spec = get_robot(robot)
    if unknown := [name for name in topics if name not in _SOURCES]:
        raise UsageError(f"--topic {unknown[0]}=... is unknown", fix=nearest(unknown[0], SOURCES))
    if len(set(topics.values())) < len(topics):
        raise UsageError("--topic names one topic for two readings", fix="name another for one")
    try:
        kinds, unused = _kinds(path)
        chosen = _chosen(path, kinds, unused, topics)
        read = _read(path, spec, chosen)
    except UsageError as error:
        if str(path) in error.message:
            raise
        raise UsageError(f"{path}: {error.message}", fix=error.fix) from None
    except CompressionError as error:
        raise UsageError(f"{path}: {error}", fix="convert it: `mcap compress IN -o OUT`") from None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check the path") from None
    except DAMAGE as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(
            f"{path} is damaged, or no MCAP file: {reason}",
            fix="save what is left with `mcap recover`",
        ) from error
    if not read:
        wanted = ", ".join(dict.fromkeys(kind for name in SOURCES for kind in _kinds_of(name)))
        there = "; ".join(f"{name}: {why}" for name, why in unused.items()) or "no messages"
        raise UsageError(
            f"{path} has no topic that scores are computed from: {clean(there, at_most=600)}",
            fix=ROS_1 if "(ros1msg)" in there else f"log one of {wanted}, or name it with --topic",
        )
    return _gridded(path, spec, read, unused)


def _kinds(path: Path) -> tuple[dict[str, str], dict[str, str]]:
    """Return the kind of message of each topic that can be read, and why others cannot."""
    kinds, others = dict[str, str](), dict[str, str]()
    with path.open("rb") as stream:
        for each in foreign(stream):
            kind, reason = kind_of(each), unreadable(each)
            if kinds.setdefault(each.topic, kind) != kind:
                reason = f"its messages are of two kinds, {kinds[each.topic]} and {kind}"
            if reason:
                others[each.topic] = clean(reason, at_most=200)
    return {topic: kind for topic, kind in kinds.items() if topic not in others}, others


def _fits(source: str, topic: str, kind: str) -> str:
    """Return why a topic's name is not that of a source; nothing where it may be.

    Its last part decides whether it says where the robot is to go; of joints and commands, the
    parts before it where the last says neither.
    """
    *before, last = (
        {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", part)}
        for part in topic.strip("/").split("/")
    )
    if source == "targets" and kind not in TARGETS[:-1] and _NO_ANGLES & set().union(*before, last):
        return "its name means numbers that are not angles"
    told = any(map(_TOLD.match, last))
    if not told and source != "pose" and any(map(_TOLD.match, set[str]().union(*before))):
        if last & _MEASURED:
            return f"its name fits both: --topic joints={topic} or targets={topic}"
        told = True
    if told == (source in {"targets", "command"}):
        return ""
    return "its name means the robot's goal" if told else "its name does not say a command"


def _chosen(
    path: Path, kinds: Mapping[str, str], unused: dict[str, str], topics: Mapping[str, str]
) -> dict[str, str]:
    """Return the topic of each source that has one; note why others are not taken."""
    chosen: dict[str, str] = {}
    for source, ranks in _SOURCES.items():
        if (topic := topics.get(source)) is not None:
            if topic not in kinds:
                there = f"cannot be read: {unused[topic]}" if topic in unused else "is not there"
                raise UsageError(f"{path}: topic {topic!r} {there}", fix=nearest(topic, kinds))
            if kinds[topic] not in _kinds_of(source):
                raise UsageError(
                    f"{path}: {topic} has {clean(kinds[topic], at_most=80)!r}, not {source}",
                    fix=f"name a topic of {' or '.join(_kinds_of(source))}",
                )
            chosen[source] = topic
            continue
        for rank in ranks:
            free = [each for each in kinds if kinds[each] in rank and each not in topics.values()]
            whys = {each: _fits(source, each, kinds[each]) for each in free}
            unused.update({each: reason for each, reason in whys.items() if reason})
            fitting = [each for each, reason in whys.items() if not reason]
            if len(fitting) > 1:
                raise UsageError(
                    f"{path}: {' and '.join(sorted(fitting))} could all be {source}",
                    fix=f"name one: --topic {source}={min(fitting)}",
                )
            if fitting:
                chosen[source] = fitting[0]
                break
    _beside(kinds, unused, chosen)
    return chosen


def _beside(kinds: Mapping[str, str], unused: dict[str, str], chosen: dict[str, str]) -> None:
    """Add an IMU that the pose is compared with; note why other topics are not read."""
    imus = [topic for topic in kinds if kinds[topic] == IMU]
    if len(imus) == 1 and "pose" in chosen and chosen["pose"] not in imus:
        chosen["imu"] = imus[0]
    for topic, kind in kinds.items():
        if topic in chosen.values():
            unused.pop(topic, None)
        else:
            unused.setdefault(topic, f"{kind}, beside the topics that are used")


@dataclass
class _Source:
    """The messages of one topic, in the order of the file."""

    topic: str
    kind: str
    times: list[tuple[int | None, int]] = field(default_factory=list)  # stamp, logged; ns
    values: list[Values] = field(default_factory=list)
    frames: set[tuple[str, str]] = field(default_factory=set)
    noted: Counter[str] = field(default_factory=Counter)
    seen: set[tuple[int, int]] = field(default_factory=set)


def _read(path: Path, robot: RobotSpec, chosen: Mapping[str, str]) -> dict[str, _Source]:
    decoders = DecoderFactory()
    by_topic = {topic: source for source, topic in chosen.items()}
    sources: dict[str, _Source] = {}
    orders: dict[Any, Any] = {}
    with path.open("rb") as stream:
        for each in foreign(stream):
            if (source := by_topic.get(each.topic)) is None:
                continue
            kind, message = kind_of(each), decoded(each, decoders)
            into = sources.setdefault(source, _Source(each.topic, kind))
            if (stamp := stamp_of(message, kind)) is not None:
                if (key := (stamp, hash(each.data))) in into.seen:
                    into.noted["are there twice"] += 1
                    continue
                into.seen.add(key)
            if source in {"pose", "imu"}:
                into.frames.add(frames_of(message, kind))
            into.noted.update(f"have {what}" for what in noted_in(message, kind))
            into.times.append((stamp, each.time_ns))
            into.values.append(values_of(source, message, kind, robot, orders, each.topic))
    return {source: sources[source] for source in (*_SOURCES, "imu") if source in sources}


def _tracks(path: Path, robot: RobotSpec, read: Mapping[str, _Source]) -> Readings:
    """Return every reading on its times; note which messages lack one."""
    topics = {source: each.topic for source, each in read.items()}
    frames = {source: each.frames for source, each in read.items() if each.frames}
    readings = Readings(robot=robot, topics=topics, frames=frames)
    middle = sorted(time for each in read.values() for _, time in each.times)
    origin = middle[len(middle) // 2]
    stamps = {
        source: Stamps(
            each.topic,
            *(
                np.array([np.nan if time is None else (time - origin) * 1e-9 for time in column])
                for column in zip(*each.times, strict=True)
            ),
            steady=source != "command",
        )
        for source, each in read.items()
    }
    clock, faults = on_one_clock(stamps, readings.notes)
    for source, fault in faults.items():
        readings.empty[source] = (
            f"when messages of {topics[source]} were measured is unknown: {fault}"
        )
    if "joints" in faults or not clock:
        raise UsageError(
            f"{path}: {readings.empty.get('joints') or next(iter(readings.empty.values()))}",
            fix="record stamps in the headers, or cut the log where its clock was set",
        )
    for source, times in clock.items():
        _add_tracks(readings, read[source], times, "imu_" if source == "imu" else "")
    lacking = {readings.empty.get(name, "") for name, source in _FROM.items() if source == "joints"}
    if all(": no joint " in reason for reason in lacking):
        fix = "name another robot with --robot, or a topic with --topic"
        raise UsageError(lacking.pop(), fix=fix)
    return readings


def _add_tracks(readings: Readings, each: _Source, times: Array, prefix: str) -> None:
    count, topic = len(times), each.topic
    order = np.argsort(times, kind="stable")[: np.count_nonzero(np.isfinite(times))].tolist()
    each.noted["have no time and are left out"] = count - len(order)
    readings.notes += [
        f"{n} of {count} messages of {topic} {what}" for what, n in each.noted.items() if n
    ]
    lacks: dict[str, list[str]] = {}
    for reading in dict.fromkeys(name for values in each.values for name in values):
        said = [values.get(reading, "is missing") for values in each.values]
        whys = Counter(clean(value, at_most=200) for value in said if isinstance(value, str))
        why = max(whys, key=whys.__getitem__, default="")
        name = reading.replace("_", " ")
        kept = [index for index in order if not isinstance(said[index], str)]
        if not kept:
            readings.empty[f"{prefix}{reading}"] = f"{topic} has no {name}: {why}"
            continue
        if whys and reading != "target_torques":
            lacks.setdefault(f"{whys.total()} of {count} messages, {why}", []).append(name)
        last = np.append(np.diff(times[kept]) > 0.0, True)
        readings.tracks[f"{prefix}{reading}"] = (
            times[kept][last],
            np.array([said[index] for index in kept])[last],
        )
    readings.notes += [
        f"{topic} has no {', '.join(names)} in {why}" for why, names in lacks.items()
    ]


def _slow(readings: Readings, path: Path) -> dict[str, list[tuple[float, float]]]:
    """Drop what is logged too seldom; return where the others have no pause, and the rates."""
    spans: dict[str, list[tuple[float, float]]] = {}
    fastest: dict[str, float] = {}
    alone: dict[str, int] = {}
    for reading, (times, _) in tuple(readings.tracks.items()):
        source = _FROM.get(reading, "")
        if source == "command" or not source:
            continue
        spans[reading], rate, alone[source] = stretches(times)
        fastest[source] = max(fastest.get(source, 0.0), rate)
        if rate < (fewest := _FEWEST_POSES if source == "pose" else _FEWEST):
            readings.drop(
                reading,
                f"{readings.topics[source]} has it {rate:.1f} times a second, under {fewest:.3g}",
            )
            del spans[reading]
    for source, rate in fastest.items():
        if source != "pose" and rate < _FEWEST:
            raise UsageError(
                f"{path}: {readings.topics[source]} has {rate:.1f} messages a second, scores are "
                f"of {CONTROL_RATE} control steps a second",
                fix="log it at 50 Hz or more",
            )
    for source, count in alone.items():
        if count:
            readings.notes.append(
                f"{plural(count, 'message')} of {readings.topics[source]} left out: far from "
                "all others in time"
            )
    return spans


def _gridded(
    path: Path, robot: RobotSpec, read: Mapping[str, _Source], unused: Mapping[str, str]
) -> RobotLog:
    """Return all readings at the ends of control and physics steps."""
    readings = _tracks(path, robot, read)
    doubt(readings)
    spans = _slow(readings, path)
    tracks = {name: readings.tracks[name] for name in _FROM if name in readings.tracks}
    if not tracks:
        raise UsageError([f"{path} has no reading that can be used", *readings.empty.values()])
    substeps = 1
    for name in ("torques", "joint_rates"):
        if name in spans:
            ratio = round(stretches(tracks[name][0])[1] / CONTROL_RATE)
            substeps = min(max(ratio, 1), _MOST_SUBSTEPS)
            break
    # Where all are known; a command may come later, or be none.
    whole = [(float(tracks[name][0][0]), float(tracks[name][0][-1])) for name in tracks]
    parts = [
        (begin, steps)
        for begin, end in common(list(spans.values()) or [[each] for each in whole])
        if (steps := int((end - begin) * CONTROL_RATE + 1e-6)) >= 2
    ]
    if not parts:
        raise UsageError(
            f"{path}: its topics have no two control steps of 0.02 s in common",
            fix="name other topics with --topic",
        )
    first, last = parts[0][0], parts[-1][0] + parts[-1][1] / CONTROL_RATE
    ends = np.concatenate(
        [begin - first + np.arange(1, steps + 1) / CONTROL_RATE for begin, steps in parts]
    )
    if (paused := last - first - len(ends) / CONTROL_RATE) > 0.5 / CONTROL_RATE:
        readings.notes.append(
            f"{paused:.4g} s in {plural(len(parts) - 1, 'pause')} of the log are left out"
        )
    if "command" in tracks:
        given = tracks["command"][0]
        since, held = given[0] - first, np.diff(given, append=max(last, given[-1])).max()
        readings.notes += [
            f"{readings.topics['command']} {what}"
            for what, seconds in (
                (f"begins {since:.3g} s late: tracking is scored from there on", since),
                (f"says nothing for {held:.3g} s: its last command is held", held),
            )
            if seconds > _LONG_HELD
        ]
    with World(robot, get_scene(_FLAT)) as world:
        mass, gravity = world.mass, world.gravity
    figures = Figures(
        control_period=1.0 / CONTROL_RATE,
        timestep=1.0 / (CONTROL_RATE * substeps),
        mass=mass,
        gravity=gravity,
        torque_limits=np.array(robot.torque_limits),
        joint_ranges=np.array(robot.joint_ranges),
    )
    return RobotLog(
        figures=figures,
        stretches=tuple(_stretch(figures, readings, begin, steps) for begin, steps in parts),
        ends=ends,
        fell=None if readings.fell is None else readings.fell - first,
        topics=readings.topics,
        empty=readings.empty,
        notes=tuple(readings.notes),
        unused=unused,
        fields={each.topic: FIELDS[each.kind] for each in read.values()},
    )


_FLAT = "flat/carpet_room"
"""Where the robot's mass is weighed."""


def _stretch(figures: Figures, log: Readings, begin: float, steps: int) -> Stretch:
    """Return the readings of control steps from a time on: the newest at the end of each."""
    count = steps * (substeps := round(figures.control_period / figures.timestep))
    # The hair lets a message count that comes at the very end of a step.
    fine = begin + np.arange(1, count + 1) * figures.timestep + 1e-6
    readings: dict[str, Array] = {}
    for name in _FROM.keys() & log.tracks.keys():
        times, values = log.tracks[name]
        newest = np.searchsorted(times, fine, side="right") - 1
        held = values[np.maximum(newest, 0)]
        held[newest < 0] = np.nan
        shaped = held.reshape(steps, substeps, -1)
        at_physics_rate = name in {"torques", "joint_rates"}
        readings[name] = shaped if at_physics_rate else shaped[:, -1]
    return Stretch(figures, **readings)
