"""Readings of a robot's own log: an MCAP file, or the MCAP file of a ROS 2 bag.

Which topics are taken follows from what their messages are. They have rates of their own: each
reading is the newest message of its topic at the end of a physics step, as many of which stand in a
control step of 1 / 50 s as joints are logged, so that a score means what it means in simulation.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdError

from nw_eval.cards.model import CONTROL_RATE
from nw_eval.catalogue import get_scene
from nw_eval.clean import clean
from nw_eval.errors import StoreError, UsageError, nearest
from nw_eval.files.inside import regular
from nw_eval.robots import RobotSpec, get_robot
from nw_eval.rollout.mcap.reader import MOST_MESSAGE, ForeignMessage, foreign
from nw_eval.scores.score import Array, Figures, Stretch
from nw_eval.sim import World

_JOINTS = ("sensor_msgs/msg/JointState", "foxglove.JointStates")
_SOURCES: dict[str, tuple[str, ...]] = {
    "joints": _JOINTS,
    "targets": (*_JOINTS, "std_msgs/msg/Float64MultiArray"),
    "pose": (
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/PoseStamped",
        "foxglove.PoseInFrame",
        "sensor_msgs/msg/Imu",
    ),
    "command": ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"),
}
"""What is looked for, and in which messages, the best first."""
SOURCES = tuple(_SOURCES)
_TOLD = ("command", "cmd", "target", "desired", "action")
"""In the name of a topic of joints that says where they are to go."""
_PROTOBUF: dict[str, Any] = {
    "foxglove.JointStates": JointStates,
    "foxglove.PoseInFrame": PoseInFrame,
}
_MOST_SUBSTEPS = 20  # 1 kHz
_FEWEST = 0.9 * CONTROL_RATE  # messages a second of joints and targets
_DAMAGE = (
    ArithmeticError,
    AttributeError,
    DecodeError,
    EOFError,
    LookupError,
    McapError,
    MemoryError,
    TypeError,
    ValueError,
    ZstdError,
    struct.error,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotLog:
    """What a log says, as scores are shown it."""

    figures: Figures
    stretch: Stretch
    """All control steps; readings that the log lacks are left out."""
    seconds: float
    topics: Mapping[str, str]
    """Topic by what was looked for, one of `SOURCES`."""
    empty: Mapping[str, str]
    """Readings that a topic could have and does not, and why."""

    def lacks(self, reading: str) -> str:
        """Return why there is no such reading."""
        if reading in self.empty:
            return self.empty[reading]
        source = _FROM.get(reading)
        if source is None:
            return f"no message has {reading.replace('_', ' ')}"
        if (topic := self.topics.get(source)) is not None:
            return f"{topic} has no {reading.replace('_', ' ')}"
        return f"no topic has {source}: {' or '.join(_SOURCES[source])}"


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


class _Track(NamedTuple):
    times: Array  # (N,) s
    values: dict[str, Array]  # (N, ...) by reading


def read_robot_log(path: Path, *, robot: str, topics: Mapping[str, str]) -> RobotLog:
    """Return the readings of a log.

    Args:
        path: an MCAP file.
        robot: whose it is, as a suite names it.
        topics: by what is looked for, one of `SOURCES`; those that are left out are found.

    Raises:
        StoreError: the log is missing or damaged.
        UsageError: there is no such robot or topic, several topics could be meant, a message lacks
            a joint of the robot, or joints are logged too seldom.
    """
    spec = get_robot(robot)
    if unknown := [name for name in topics if name not in _SOURCES]:
        raise UsageError(f"--topic {unknown[0]}=... is unknown", fix=nearest(unknown[0], SOURCES))
    try:
        kinds = _kinds(path)
        chosen = _chosen(path, kinds, topics)
        tracks = _tracks(path, spec, chosen, kinds)
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check the path") from None
    except _DAMAGE as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(
            f"{path} is damaged, or no MCAP file: {reason}",
            fix="save what is left with `mcap recover`; lz4 becomes zstd with `mcap compress`",
        ) from error
    if not tracks:
        wanted = ", ".join(dict.fromkeys(kind for each in _SOURCES.values() for kind in each))
        raise UsageError(
            f"{path} has no topic that scores are computed from",
            fix=f"log one of {wanted}, or name it with --topic",
        )
    return _gridded(path, spec, chosen, tracks)


def _kinds(path: Path) -> dict[str, str]:
    """Return the schema of each topic."""
    with regular(path).open("rb") as stream:
        return {each.topic: _kind(each) for each in foreign(stream)}


def _kind(message: ForeignMessage) -> str:
    return "" if message.schema is None else message.schema.name


def _chosen(path: Path, kinds: Mapping[str, str], topics: Mapping[str, str]) -> dict[str, str]:
    """Return the topic of each source that has one."""
    chosen: dict[str, str] = {}
    for source, wanted in _SOURCES.items():
        if source in topics:
            if (topic := topics[source]) not in kinds:
                raise UsageError(f"{path} has no topic {topic!r}", fix=nearest(topic, tuple(kinds)))
            if kinds[topic] not in wanted:
                raise UsageError(
                    f"{path}: {topic} has {clean(kinds[topic], at_most=80)!r}, not {source}",
                    fix=f"name a topic of {' or '.join(wanted)}",
                )
            chosen[source] = topic
            continue
        for kind in wanted:
            found = [topic for topic in kinds if kinds[topic] == kind]
            if source in {"joints", "targets"}:
                told = source == "targets"
                found = [
                    topic for topic in found if any(word in topic.lower() for word in _TOLD) == told
                ]
            if len(found) > 1:
                raise UsageError(
                    f"{path}: {' and '.join(sorted(found))} could all be {source}",
                    fix=f"name one: --topic {source}={min(found)}",
                )
            if found:
                chosen[source] = found[0]
                break
    return chosen


def _tracks(
    path: Path, robot: RobotSpec, chosen: Mapping[str, str], kinds: Mapping[str, str]
) -> dict[str, _Track]:
    decoders = DecoderFactory()
    by_topic = {topic: source for source, topic in chosen.items()}
    seen: dict[str, list[tuple[float, dict[str, list[float]]]]] = {}
    orders: dict[tuple[str, ...], list[int]] = {}
    with path.open("rb") as stream:
        for each in foreign(stream):
            source = by_topic.get(each.topic)
            if source is None:
                continue
            message = _decoded(each, decoders)
            values = _VALUES[source](message, kinds[each.topic], robot, orders, each.topic)
            if any(not np.isfinite(value).all() for value in values.values()):
                raise ValueError(f"{each.topic} has numbers that are not finite")
            seen.setdefault(source, []).append((each.time_ns * 1e-9, values))
    tracks: dict[str, _Track] = {}
    for source, rows in seen.items():
        rows.sort(key=lambda row: row[0])
        names = [name for name in rows[0][1] if all(name in values for _, values in rows)]
        tracks[source] = _Track(
            np.array([time for time, _ in rows]),
            {name: np.array([values[name] for _, values in rows]) for name in names},
        )
    return tracks


def _decoded(message: ForeignMessage, decoders: DecoderFactory) -> Any:
    if len(message.data) > MOST_MESSAGE:
        raise ValueError(f"a message of {message.topic} has over {MOST_MESSAGE // 2**20} MiB")
    if (kind := _PROTOBUF.get(_kind(message))) is not None:
        return kind.FromString(message.data)
    decode = decoders.decoder_for(message.encoding, message.schema)
    if decode is None:
        raise ValueError(f"messages of {message.topic} are encoded as {message.encoding!r}")
    return decode(message.data)


def _joints(
    message: Any,
    kind: str,
    robot: RobotSpec,
    orders: dict[tuple[str, ...], list[int]],
    topic: str,
) -> dict[str, list[float]]:
    if kind == "foxglove.JointStates":
        names = tuple(joint.name for joint in message.joints)
        columns = {
            "joint_positions": [joint.position for joint in message.joints],
            "joint_rates": [joint.velocity for joint in message.joints],
            "torques": [joint.effort for joint in message.joints],
        }
    else:
        names = tuple(message.name)
        columns = {
            "joint_positions": list(message.position),
            "joint_rates": list(message.velocity),
            "torques": list(message.effort),
        }
    if names not in orders:
        orders[names] = _order(names, robot, topic)
    order = orders[names]
    return {
        name: [column[index] for index in order]
        for name, column in columns.items()
        if len(column) == len(names)
    }


def _order(names: Sequence[str], robot: RobotSpec, topic: str) -> list[int]:
    """Return where the joints of a robot are in a message."""
    short = [name.removesuffix("_joint") for name in names]
    found: list[int] = []
    for joint in robot.joints:
        if (own := joint.removesuffix("_joint")) not in short:
            raise UsageError(
                f"{topic} has no joint {joint!r} of {robot.name}; it has "
                f"{clean(', '.join(names), at_most=200)}",
                fix="name another robot with --robot, or another topic with --topic",
            )
        found.append(short.index(own))
    return found


def _targets(
    message: Any,
    kind: str,
    robot: RobotSpec,
    orders: dict[tuple[str, ...], list[int]],
    topic: str,
) -> dict[str, list[float]]:
    if kind in _JOINTS:
        values = _joints(message, kind, robot, orders, topic)
        return {"targets": values.get("joint_positions") or values["torques"]}
    values = list(message.data)
    if len(values) != len(robot.joints):
        raise UsageError(
            f"{topic} has {len(values)} numbers, {robot.name} has {len(robot.joints)} joints",
            fix="name another topic with --topic",
        )
    return {"targets": values}


def _pose(message: Any, kind: str, *_: Any) -> dict[str, list[float]]:
    values: dict[str, list[float]] = {}
    if kind == "sensor_msgs/msg/Imu":
        turned, twist = message.orientation, None
        values["rates"] = _xyz(message.angular_velocity)
    elif kind == "nav_msgs/msg/Odometry":
        turned, twist = message.pose.pose.orientation, message.twist.twist
        values["position"] = _xyz(message.pose.pose.position)
        values["rates"] = _xyz(twist.angular)
    else:
        turned, twist = message.pose.orientation, None
        values["position"] = _xyz(message.pose.position)
    rotation = _rotation(turned)
    values["rotation"] = rotation.ravel().tolist()
    if twist is not None:  # In the frame of the trunk.
        values["world_velocity"] = (rotation @ _xyz(twist.linear)).tolist()
    return values


def _command(message: Any, kind: str, *_: Any) -> dict[str, list[float]]:
    twist = message.twist if kind == "geometry_msgs/msg/TwistStamped" else message
    return {"command": [twist.linear.x, twist.linear.y, twist.angular.z]}


_VALUES: dict[str, Any] = {
    "joints": _joints,
    "targets": _targets,
    "pose": _pose,
    "command": _command,
}


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _rotation(quat: Any) -> Array:
    """Return the rotation matrix of a quaternion, which need not be normalised."""
    numbers = np.array([quat.w, quat.x, quat.y, quat.z])
    w, x, y, z = numbers / np.linalg.norm(numbers)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _gridded(
    path: Path, robot: RobotSpec, chosen: Mapping[str, str], tracks: Mapping[str, _Track]
) -> RobotLog:
    """Return all readings at the ends of control and physics steps."""
    for source in ("joints", "targets"):
        if source in tracks and (rate := _rate(tracks[source].times)) < _FEWEST:
            raise UsageError(
                f"{path}: {chosen[source]} has {rate:.1f} messages a second, scores are of "
                f"{CONTROL_RATE} control steps a second",
                fix="log it at 50 Hz or more",
            )
    substeps = 1
    if "joints" in tracks:
        ratio = round(_rate(tracks["joints"].times) / CONTROL_RATE)
        substeps = min(max(ratio, 1), _MOST_SUBSTEPS)
    # From when on all are known; a command may come later, or be none.
    moving = [track.times for source, track in tracks.items() if source != "command"]
    moving = moving or [track.times for track in tracks.values()]
    begin = max(float(times[0]) for times in moving)
    end = min(float(times[-1]) for times in moving)
    steps = int((end - begin) * CONTROL_RATE + 1e-6)
    if steps < 2:
        raise UsageError(f"{path}: its topics have no time in common", fix="name other topics")
    # The hair lets a message count that comes at the very end of a step.
    fine = begin + np.arange(1, steps * substeps + 1) / (CONTROL_RATE * substeps) + 1e-6
    readings: dict[str, Array] = {}
    for source, track in tracks.items():
        newest = np.searchsorted(track.times, fine, side="right") - 1
        for name, values in track.values.items():
            held = values[np.maximum(newest, 0)]
            held[newest < 0] = np.nan
            shaped = held.reshape(steps, substeps, -1)
            at_physics_rate = name in {"torques", "joint_rates"}
            readings[name] = shaped if at_physics_rate else shaped[:, -1]
        del source
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
    empty = {
        reading: f"{chosen[source]} has no {reading.replace('_', ' ')}"
        for reading, source in _FROM.items()
        if source in chosen and reading not in readings
    }
    return RobotLog(
        figures=figures,
        stretch=Stretch(figures, **readings),
        seconds=steps / CONTROL_RATE,
        topics=dict(chosen),
        empty=empty,
    )


_FLAT = "flat/carpet_room"
"""Where the robot's mass is weighed."""


def _rate(times: Array) -> float:
    return (len(times) - 1) / max(float(times[-1] - times[0]), 1e-9)
