"""What the messages of a robot's log say: each field is used, passed over with a reason, or noted.

A value that was not measured is not a number here, however it is written: NaN, an empty array, a
quaternion of zeros, a covariance that begins with -1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import zstandard
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap_ros2.decoder import DecoderFactory

from nw_base.errors import UsageError
from nw_policies.drafting.configs import motor_names
from nw_scenes.robots import RobotSpec
from nw_sim.rollout.mcap.reader import MOST_MESSAGE, ForeignMessage

USED, NOTED = "used", "noted where it is not 0"
_TWIST = "linear.x+ linear.y+ linear.z! angular.x! angular.y! angular.z+"
_COVARIANCE = "scores do not weigh readings; -1 in front, not measured, is used"
_BOARD = (
    "head level_flag frame_reserve sn version bandwidth bms_state bms_cmd tick wireless_remote "
    "reserve crc"
)
_FIELDS = {
    "sensor_msgs/msg/JointState": "header.stamp+ header.frame_id name+ position+ velocity+ effort+",
    "foxglove.JointStates": "timestamp+ joints.name+ joints.position+ joints.velocity+ "
    "joints.effort+ joints.acceleration",
    "std_msgs/msg/Float64MultiArray": "layout.dim layout.data_offset! data+",
    "nav_msgs/msg/Odometry": "header.stamp+ header.frame_id+ child_frame_id+ pose.pose.position+ "
    "pose.pose.orientation+ pose.covariance twist.twist.linear+ twist.twist.angular+ "
    "twist.covariance",
    "geometry_msgs/msg/PoseStamped": "header.stamp+ header.frame_id+ pose.position+ "
    "pose.orientation+",
    "foxglove.PoseInFrame": "timestamp+ frame_id+ pose.position+ pose.orientation+",
    "sensor_msgs/msg/Imu": "header.stamp+ header.frame_id+ orientation+ orientation_covariance "
    "angular_velocity+ angular_velocity_covariance linear_acceleration+ "
    "linear_acceleration_covariance",
    "unitree_go/msg/LowState": f"motor_state+ {_BOARD} imu_state foot_force foot_force_est "
    "bit_flag adc_reel temperature_ntc1 temperature_ntc2 power_v power_a fan_frequency",
    "unitree_hg/msg/LowState": f"motor_state+ {_BOARD} imu_state mode_pr mode_machine",
    "unitree_go/msg/LowCmd": f"motor_cmd+ {_BOARD} led fan gpio",
    "unitree_hg/msg/LowCmd": f"motor_cmd+ {_BOARD} mode_pr mode_machine",
    "geometry_msgs/msg/Twist": _TWIST,
    "geometry_msgs/msg/TwistStamped": "header.stamp+ header.frame_id twist."
    + _TWIST.replace(" ", " twist."),
}
"""Fields by kind of message: `+` is used, `!` is noted where it is not 0, others have no effect."""
_NO_EFFECT = {
    "header.frame_id": "a joint has no frame, and a command is meant in the robot's yaw frame",
    "joints.acceleration": "no score is of it",
    "layout.dim": "labels; the numbers are taken in the robot's order of joints",
    "imu_state": "scores read the trunk's attitude from topics of poses",
    **dict.fromkeys(
        f"{_BOARD} foot_force foot_force_est bit_flag adc_reel temperature_ntc1 temperature_ntc2 "
        "power_v power_a fan_frequency mode_pr mode_machine led fan gpio".split(),
        "of the robot's electronics",
    ),
}
FIELDS: Mapping[str, Mapping[str, str]] = {
    kind: {
        name.rstrip("+!"): USED
        if name.endswith("+")
        else NOTED
        if name.endswith("!")
        else _NO_EFFECT.get(name, _COVARIANCE)
        for name in names.split()
    }
    for kind, names in _FIELDS.items()
}
"""Of each kind of message that is read, what becomes of its fields."""
_PROTOBUF: dict[str, Any] = {
    "foxglove.JointStates": JointStates,
    "foxglove.PoseInFrame": PoseInFrame,
}
_LOW_STATES = ("unitree_go/msg/LowState", "unitree_hg/msg/LowState")
_LOW_COMMANDS = ("unitree_go/msg/LowCmd", "unitree_hg/msg/LowCmd")
JOINTS = ("sensor_msgs/msg/JointState", "foxglove.JointStates", *_LOW_STATES)
TARGETS = (*JOINTS[:2], *_LOW_COMMANDS, "std_msgs/msg/Float64MultiArray")
IMU = "sensor_msgs/msg/Imu"
_ZSTD = b"\x28\xb5\x2f\xfd"
Values = dict[str, "list[float] | str"]
"""A reading's numbers, or why a message has none, by reading."""


def kind_of(message: ForeignMessage) -> str:
    """Return the name of a message's schema; a ROS 2 name in its full form."""
    name = "" if message.schema is None else message.schema.name
    short = message.encoding == "cdr" and name.count("/") == 1
    return name.replace("/", "/msg/") if short else name


def unreadable(message: ForeignMessage) -> str:
    """Return why a message cannot be read; nothing where it can."""
    kind, schema = kind_of(message), "" if message.schema is None else message.schema.encoding
    if (message.encoding, schema) not in {("cdr", "ros2msg"), ("protobuf", "protobuf")}:
        return f"{kind} is encoded as {message.encoding} ({schema}), not ROS 2 or protobuf"
    return "" if kind in FIELDS else f"{kind} is not read"


def decoded(message: ForeignMessage, decoders: DecoderFactory) -> Any:
    """Return the content of a message that is not `unreadable`.

    Raises:
        ValueError and others: it is damaged, or too large.
    """
    data = message.data
    if data.startswith(_ZSTD):  # `ros2 bag record --compression-mode message`
        if not 0 <= (size := zstandard.frame_content_size(data)) <= MOST_MESSAGE:
            raise ValueError(f"a message of {message.topic} unpacks to {size} bytes")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=MOST_MESSAGE)
    if len(data) > MOST_MESSAGE:
        raise ValueError(f"a message of {message.topic} has over {MOST_MESSAGE // 2**20} MiB")
    if (kind := _PROTOBUF.get(kind_of(message))) is not None:
        return kind.FromString(data)
    if (decode := decoders.decoder_for(message.encoding, message.schema)) is None:
        raise ValueError(f"messages of {message.topic} have no schema")
    return decode(data)


def noted_in(message: Any, kind: str) -> list[str]:
    """Return what is in a message that nothing is made of."""
    uses = FIELDS[kind]
    if kind in _PROTOBUF:
        return [f"a field {each.field_number} of no name" for each in UnknownFieldSet(message)]
    return [
        f"{path}, which is not read"
        for path, value in _leaves(message, uses)
        if path not in uses or (uses[path] == NOTED and value)
    ]


def _leaves(message: Any, uses: Mapping[str, str], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the fields of a ROS message, those within messages too, down to what has a use."""
    for name in message.__slots__:
        inner, value = f"{path}{name}", getattr(message, name)
        if inner in uses or not hasattr(value, "__slots__"):
            yield inner, value
        else:
            yield from _leaves(value, uses, f"{inner}.")


def stamp_of(message: Any, kind: str) -> int | None:
    """Return when a message was measured, ns; None where it does not say so."""
    if kind in _PROTOBUF:
        return message.timestamp.ToNanoseconds() or None
    stamp = message.header.stamp if hasattr(message, "header") else None
    if stamp is None or not 0 <= stamp.nanosec < 10**9:
        return None
    return (stamp.sec * 10**9 + stamp.nanosec) or None


def frames_of(message: Any, kind: str) -> tuple[str, str]:
    """Return the frames of a message of a pose: that of its numbers, and whose pose it is."""
    frame = message.frame_id if kind in _PROTOBUF else message.header.frame_id
    return frame.lstrip("/"), getattr(message, "child_frame_id", "").lstrip("/")


def values_of(
    source: str, message: Any, kind: str, robot: RobotSpec, orders: dict[Any, Any], topic: str
) -> Values:
    """Return what a message of a topic that was taken for a source says of each reading.

    `orders` keeps where joints are in messages. UsageError: it cannot be of this robot.
    """
    values = _VALUES[source](message, kind, robot, orders, topic)
    return {
        name: value
        if isinstance(value, str) or all(map(math.isfinite, value))
        else "NaN or infinite numbers"
        for name, value in values.items()
    }


def _joints(
    message: Any, kind: str, robot: RobotSpec, orders: dict[Any, Any], topic: str
) -> Values:
    fields = {"joint_positions": "position", "joint_rates": "velocity", "torques": "effort"}
    if kind in {*_LOW_STATES, *_LOW_COMMANDS}:
        # Motors beyond the joints are spare places; the others are counted as their maker does.
        motors = message.motor_cmd if kind in _LOW_COMMANDS else message.motor_state
        names, motors = motor_names(robot), motors[: len(robot.joints)]
        tau = "tau" if kind in _LOW_COMMANDS else "tau_est"
        columns = {
            reading: [getattr(each, field) for each in motors]
            for reading, field in zip(fields, ("q", "dq", tau), strict=True)
        }
    elif kind == "foxglove.JointStates":
        names = tuple(joint.name for joint in message.joints)
        columns = {
            reading: [getattr(each, field) for each in message.joints if each.HasField(field)]
            for reading, field in fields.items()
        }
    else:
        names = tuple(message.name)
        columns = {reading: list(getattr(message, field)) for reading, field in fields.items()}
    if names not in orders:
        orders[names] = _order(names, robot, topic)
    order = orders[names]
    if isinstance(order, str):
        return dict.fromkeys(columns, order)
    return {
        reading: [column[index] for index in order]
        if len(column) == len(names)
        else f"{len(column)} numbers of {fields[reading]} for {len(names)} joints"
        for reading, column in columns.items()
    }


def _order(names: Sequence[str], robot: RobotSpec, topic: str) -> list[int] | str:
    """Return where the joints of a robot are in a message, or which one is not."""
    short = [name.removesuffix("_joint") for name in names]
    own = [joint.removesuffix("_joint") for joint in robot.joints]
    for joint, name in zip(robot.joints, own, strict=True):
        if short.count(name) > 1:
            raise UsageError(
                f"{topic} has joint {joint!r} {short.count(name)} times in one message",
                fix="record the joints of one robot, or name another topic with --topic",
            )
        if name not in short:
            return f"no joint {joint!r} of {robot.name} among {', '.join(names)}"
    return [short.index(name) for name in own]


def _targets(
    message: Any, kind: str, robot: RobotSpec, orders: dict[Any, Any], topic: str
) -> Values:
    if kind != "std_msgs/msg/Float64MultiArray":
        values = _joints(message, kind, robot, orders, topic)
        return {"targets": values["joint_positions"], "target_torques": values["torques"]}
    numbers, wanted = list(message.data), len(robot.joints)
    if len(numbers) != wanted:
        return {"targets": f"{len(numbers)} numbers for the {wanted} joints of {robot.name}"}
    return {"targets": numbers}


def _pose(message: Any, kind: str, *_: Any) -> Values:
    if kind == IMU:
        parts = {
            "rotation": (_rotation(message.orientation), message.orientation_covariance),
            "rates": (_xyz(message.angular_velocity), message.angular_velocity_covariance),
            "acceleration": (
                _xyz(message.linear_acceleration),
                message.linear_acceleration_covariance,
            ),
        }
    elif kind == "nav_msgs/msg/Odometry":
        pose, twist = message.pose, message.twist
        parts = {
            "position": (_xyz(pose.pose.position), pose.covariance),
            "rotation": (_rotation(pose.pose.orientation), pose.covariance),
            "world_velocity": (_xyz(twist.twist.linear), twist.covariance),
            "rates": (_xyz(twist.twist.angular), twist.covariance),
        }
    else:
        parts = {
            "position": (_xyz(message.pose.position), (0.0,)),
            "rotation": (_rotation(message.pose.orientation), (0.0,)),
        }
    return {
        reading: value if covariance[0] != -1.0 else "its covariance begins with -1"
        for reading, (value, covariance) in parts.items()
    }


def _command(message: Any, kind: str, *_: Any) -> Values:
    twist = message.twist if kind == "geometry_msgs/msg/TwistStamped" else message
    return {"command": [twist.linear.x, twist.linear.y, twist.angular.z]}


_VALUES: dict[str, Callable[..., Values]] = {
    "joints": _joints,
    "targets": _targets,
    "pose": _pose,
    "imu": _pose,
    "command": _command,
}


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _rotation(quat: Any) -> list[float] | str:
    """Return the rotation matrix of a quaternion, which need not be normalised, row by row."""
    numbers = np.array([quat.w, quat.x, quat.y, quat.z])
    size = float(np.linalg.norm(numbers))
    if not 0.5 < size < 2.0:
        return f"a quaternion of length {size:.3g}"
    w, x, y, z = (numbers / size).tolist()
    return [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
