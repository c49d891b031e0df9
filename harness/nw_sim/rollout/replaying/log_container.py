"""Logs that lie in another container than MCAP: ROS 2 bags in SQLite, and compressed files.

A bag of rosbag2's storage `sqlite3` has the tables `topics` (id, name, type, serialization_format)
and `messages` (topic_id, timestamp, data). From Iron on it has the definitions of its messages in
`message_definitions`; before, they were on the robot alone. Those that are read here are known.
"""

from __future__ import annotations

import errno
import gzip
import re
import sqlite3
import stat
import struct
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, TYPE_CHECKING, Any

import lz4.frame
import zstandard
from mcap.writer import CompressionType, Writer

from nw_base.clean import clean
from nw_base.confinement import Rules
from nw_base.errors import NwEvalError, StoreError, UsageError
from nw_sim.rollout.confined.isolated import call_isolated
from nw_sim.rollout.replaying.log_messages import FIELDS

if TYPE_CHECKING:
    from collections.abc import Generator

_SQLITE = b"SQLite format 3\0"
_STREAMS: Mapping[bytes, Callable[[IO[bytes]], Any]] = {
    b"\x28\xb5\x2f\xfd": lambda stream: zstandard.ZstdDecompressor().stream_reader(stream),
    b"\x1f\x8b": lambda stream: gzip.GzipFile(fileobj=stream),
    b"\x04\x22\x4d\x18": lz4.frame.open,
}
"""How a file that begins so is unpacked."""
ROS_1 = "convert it: `rosbags-convert --src BAG --dst OUT --dst-storage mcap`"
_OTHERS = (
    (b"#ROSBAG", "a ROS 1 bag", ROS_1),
    (b"PK\x03\x04", "a zip archive", "unpack it first"),
    (b"version https://git-lfs", "a Git LFS pointer, not the file", "get the file: `git lfs pull`"),
)
"""What else a file may be: its first bytes, what that is, and what to do."""
_BAGS = (".mcap", ".db3")
_PACKED = frozenset({".zst", ".zstd", ".gz", ".lz4"})
_BLOCK = 2**20
_MOST = 4 * 2**30
"""Bytes of a log, unpacked."""
_MOST_TOPICS = 10_000
_TIME_LIMIT = 900.0
"""Seconds; 4 GiB take some of them."""
_LINE = "=" * 80
_HEADER = "std_msgs/Header header"
_TWIST = "geometry_msgs/Vector3 linear; geometry_msgs/Vector3 angular"
_GO = "uint8[2] head; uint8 level_flag; uint8 frame_reserve; uint32[2] sn; uint32[2] version"
_IMU = "float32[4] quaternion; float32[3] gyroscope; float32[3] accelerometer; float32[3] rpy"
_MOTOR = "uint8 mode; float32 q; float32 dq"
_XYZ = "float64 x; float64 y; float64 z"
_DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec; uint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp; string frame_id",
    "std_msgs/MultiArrayDimension": "string label; uint32 size; uint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim; uint32 data_offset",
    "std_msgs/Float64MultiArray": "std_msgs/MultiArrayLayout layout; float64[] data",
    "geometry_msgs/Point": _XYZ,
    "geometry_msgs/Vector3": _XYZ,
    "geometry_msgs/Quaternion": f"{_XYZ}; float64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position; geometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": f"{_HEADER}; geometry_msgs/Pose pose",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose; float64[36] covariance",
    "geometry_msgs/Twist": _TWIST,
    "geometry_msgs/TwistStamped": f"{_HEADER}; geometry_msgs/Twist twist",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist; float64[36] covariance",
    "nav_msgs/Odometry": f"{_HEADER}; string child_frame_id; "
    "geometry_msgs/PoseWithCovariance pose; geometry_msgs/TwistWithCovariance twist",
    "sensor_msgs/JointState": f"{_HEADER}; string[] name; float64[] position; float64[] velocity; "
    "float64[] effort",
    "sensor_msgs/Imu": f"{_HEADER}; geometry_msgs/Quaternion orientation; "
    "float64[9] orientation_covariance; geometry_msgs/Vector3 angular_velocity; "
    "float64[9] angular_velocity_covariance; geometry_msgs/Vector3 linear_acceleration; "
    "float64[9] linear_acceleration_covariance",
    "unitree_go/IMUState": f"{_IMU}; int8 temperature",
    "unitree_go/MotorState": f"{_MOTOR}; float32 ddq; float32 tau_est; float32 q_raw; "
    "float32 dq_raw; float32 ddq_raw; int8 temperature; uint32 lost; uint32[2] reserve",
    "unitree_go/MotorCmd": f"{_MOTOR}; float32 tau; float32 kp; float32 kd; uint32[3] reserve",
    "unitree_go/BmsState": "uint8 version_high; uint8 version_low; uint8 status; uint8 soc; "
    "int32 current; uint16 cycle; int8[2] bq_ntc; int8[2] mcu_ntc; uint16[15] cell_vol",
    "unitree_go/BmsCmd": "uint8 off; uint8[3] reserve",
    "unitree_go/LowState": f"{_GO}; uint16 bandwidth; unitree_go/IMUState imu_state; "
    "unitree_go/MotorState[20] motor_state; unitree_go/BmsState bms_state; int16[4] foot_force; "
    "int16[4] foot_force_est; uint32 tick; uint8[40] wireless_remote; uint8 bit_flag; "
    "float32 adc_reel; int8 temperature_ntc1; int8 temperature_ntc2; float32 power_v; "
    "float32 power_a; uint16[4] fan_frequency; uint32 reserve; uint32 crc",
    "unitree_go/LowCmd": f"{_GO}; uint16 bandwidth; unitree_go/MotorCmd[20] motor_cmd; "
    "unitree_go/BmsCmd bms_cmd; uint8[40] wireless_remote; uint8[12] led; uint8[2] fan; "
    "uint8 gpio; uint32 reserve; uint32 crc",
    "unitree_hg/IMUState": f"{_IMU}; int16 temperature",
    "unitree_hg/MotorState": f"{_MOTOR}; float32 ddq; float32 tau_est; int16[2] temperature; "
    "float32 vol; uint32[2] sensor; uint32 motorstate; uint32[4] reserve",
    "unitree_hg/MotorCmd": f"{_MOTOR}; float32 tau; float32 kp; float32 kd; uint32 reserve",
    "unitree_hg/LowState": "uint32[2] version; uint8 mode_pr; uint8 mode_machine; uint32 tick; "
    "unitree_hg/IMUState imu_state; unitree_hg/MotorState[35] motor_state; "
    "uint8[40] wireless_remote; uint32[4] reserve; uint32 crc",
    "unitree_hg/LowCmd": "uint8 mode_pr; uint8 mode_machine; unitree_hg/MotorCmd[35] motor_cmd; "
    "uint32[4] reserve; uint32 crc",
}
"""Fields of ROS 2 messages, as ros2/common_interfaces and unitreerobotics/unitree_ros2 state them.
"""
_DAMAGE = (
    *(AttributeError, LookupError, OverflowError, TypeError, ValueError),
    *(sqlite3.Error, struct.error),
)
_ALLOWED = {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ}


def log_files(path: Path) -> tuple[Path, ...]:
    """Return the files of a log: itself, or the parts of the bag in a folder, in their order.

    Raises:
        StoreError: there is nothing, or no file.
        UsageError: it is a log in another form, or the folder has no log, or several.
    """
    files = (path,)
    if path.is_dir():
        logs = {each: _kind(each) for each in path.iterdir()}
        kinds = [[each for each in logs if logs[each] == kind] for kind in _BAGS]
        files = tuple(sorted(next((each for each in kinds if each), []), key=_by_number))
        if not files or (len(files) > 1 and _kind(files[0]) == _BAGS[0]):
            names = ", ".join(each.name for each in files[:5]) or "no MCAP file and no .db3"
            raise UsageError(
                f"{path} is a folder with {clean(names, at_most=300)}",
                fix="name one MCAP file; `mcap merge` puts the parts of a bag together",
            )
    for each in files:
        _check(each)
    return files


def _kind(path: Path) -> str:
    """Return the ending of a log, before that of its compression."""
    inner = path.with_suffix("") if path.suffix in _PACKED else path
    return inner.suffix


def _by_number(path: Path) -> tuple[int, str]:
    """Return where a part of a bag stands: rosbag2 counts them, `walk_0.db3` to `walk_10.db3`."""
    found = re.search(r"_(\d+)\.", path.name)
    return (int(found[1]) if found else -1, path.name)


def _check(path: Path) -> None:
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # A pipe may never end.
            raise StoreError(f"{path} is not a file", fix="name an MCAP file or a bag")
        with path.open("rb") as stream:
            start = stream.read(64)
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}", fix="check the path") from None
    if not start:
        raise UsageError(f"{path} is empty", fix="name another log")
    for magic, what, fix in _OTHERS:
        if start.startswith(magic):
            raise UsageError(f"{path} is {what}", fix=fix)
    beside = path.with_name(f"{path.name}-wal")
    if start.startswith(_SQLITE) and beside.is_file() and beside.stat().st_size:
        raise UsageError(
            f"{path} is not whole: its last messages are in {beside.name}",
            fix=f'put them together: `sqlite3 {path.name} "PRAGMA wal_checkpoint(TRUNCATE)"`',
        )
    if not start.startswith((b"\x89MCAP", _SQLITE, *_STREAMS)):
        begin = clean(start[:16].decode(errors="replace"), at_most=40)
        raise UsageError(f"{path} is no MCAP file: it begins with {begin!r}", fix="name a log")


@contextmanager
def as_mcap(path: Path) -> Generator[Path]:
    """Give the MCAP file of a log, whatever it lies in; for the time of the context.

    A process of its own reads other files than MCAP, and may read and write nothing else.

    Args:
        path: a file, or the folder of a ROS 2 bag, whose parts are read in their order.

    Raises:
        StoreError: a file is missing or damaged, or unpacks to more than 4 GiB.
        UsageError: it holds no log.
    """
    paths = log_files(path)
    if _starts(paths[0], b"\x89MCAP"):
        yield paths[0]
        return
    with TemporaryDirectory(prefix="nw-eval-log-") as folder:
        target = Path(folder).resolve() / "log.mcap"
        rules = Rules(reads=tuple(path.resolve() for path in paths), writes=(target.parent,))
        call_isolated(
            _convert,
            subject=str(paths[0]),
            rules=rules,
            time_limit=_TIME_LIMIT,
            sources=[str(path.resolve()) for path in paths],
            names=[str(path) for path in paths],
            target=str(target),
        )
        try:
            yield target
        except NwEvalError as error:
            if str(target) not in error.message:
                raise
            message = error.message.replace(str(target), str(path))
            raise type(error)(message, fix=error.fix) from None


def _convert(*, sources: Sequence[str], names: Sequence[str], target: str) -> None:
    out = Path(target)
    bags: list[tuple[Path, str]] = []
    for number, (source, name) in enumerate(zip(sources, names, strict=True)):
        try:
            bags.append((_unpacked(Path(source), name, out.with_name(f"part-{number}")), name))
        except (OSError, EOFError, zstandard.ZstdError, RuntimeError, ValueError) as error:
            if isinstance(error, NwEvalError):
                raise
            if isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT}:
                raise _full(out, error) from None
            raise _damaged(name, error) from None
    (first, name) = bags[0]
    if _starts(first, b"\x89MCAP") and len(bags) == 1:
        first.rename(out)
        return
    for bag, name in bags:
        if not _starts(bag, _SQLITE):
            raise UsageError(
                f"{name} holds neither an MCAP file nor a ROS 2 bag, or only its beginning",
                fix="copy it again, or unpack it first",
            )
    _write(bags, out)


def _write(bags: Sequence[tuple[Path, str]], out: Path) -> None:
    """Write the messages of bags into one MCAP file."""
    try:
        with out.open("wb") as stream:
            writer = Writer(stream, compression=CompressionType.NONE)
            writer.start()
            channels: dict[tuple[str, str], int] = {}
            for bag, name in bags:
                try:
                    _copy(bag, writer, channels, name)
                except _DAMAGE as error:
                    raise _damaged(name, error) from None
            writer.finish()
    except OSError as error:
        raise _full(out, error) from None


def _full(out: Path, error: OSError) -> StoreError:
    return StoreError(
        f"cannot write into {out.parent}: {error.strerror}",
        fix="free some space there, or name another folder in TMPDIR",
    )


def _damaged(name: str, error: Exception) -> StoreError:
    reason = clean(error, at_most=200) or type(error).__name__
    return StoreError(f"{name} is damaged: {reason}", fix="record or copy it again")


def _starts(path: Path, magic: bytes) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(magic)) == magic


def _unpacked(path: Path, name: str, out: Path) -> Path:
    """Return a file without its compression: itself, where it has none."""
    with path.open("rb") as stream:
        start = stream.read(8)
        opened = next((make for magic, make in _STREAMS.items() if start.startswith(magic)), None)
        if opened is None:
            return path
        stream.seek(0)
        total = 0
        with opened(stream) as inner, out.open("wb") as target:
            while block := inner.read(_BLOCK):
                total += len(block)
                if total > _MOST:
                    message = f"{name} unpacks to over {_MOST // 2**30} GiB"
                    raise StoreError(message, fix="cut the log into parts")
                target.write(block)
    return out


def _copy(bag: Path, writer: Writer, channels: dict[tuple[str, str], int], name: str) -> None:
    """Copy the messages of a bag that are read, in the order in which they were written.

    Of each other topic one message without its content is copied, so that it can be named.
    """
    connection = sqlite3.connect(f"{bag.as_uri()}?mode=ro&immutable=1", uri=True)
    with closing(connection):
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2**30)
        # What a bag's views and triggers would call is refused: tables are read, and nothing else.
        connection.set_authorizer(
            lambda action, *_: sqlite3.SQLITE_OK if action in _ALLOWED else sqlite3.SQLITE_DENY
        )
        found = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        tables = {row[0] for row in found}
        if not {"topics", "messages"} <= tables:
            raise ValueError("it has no tables `topics` and `messages`, as a ROS 2 bag has")
        numbers, others = _topics(connection, tables, writer, channels)
        total = 0
        for number, time_ns, data in connection.execute(
            "SELECT topic_id, timestamp, data FROM messages"
        ):
            if number not in numbers:
                continue
            if not isinstance(data, bytes):
                raise TypeError("the data of a message are no bytes")
            if number in others:
                writer.add_message(numbers.pop(number), time_ns, b"", time_ns)
                continue
            total += len(data)
            if total > _MOST:
                message = f"{name} has over {_MOST // 2**30} GiB of messages"
                raise StoreError(message, fix="cut the log into parts")
            writer.add_message(numbers[number], time_ns, data, time_ns)


def _topics(
    connection: sqlite3.Connection,
    tables: set[str],
    writer: Writer,
    channels: dict[tuple[str, str], int],
) -> tuple[dict[int, int], set[int]]:
    """Register the topics of a bag; return their channels, and which of them are not read."""
    own = _own_definitions(connection) if "message_definitions" in tables else {}
    numbers: dict[int, int] = {}
    others: set[int] = set()
    rows = connection.execute("SELECT id, name, type, serialization_format FROM topics")
    for count, (number, *words) in enumerate(rows):
        if count > _MOST_TOPICS:
            raise ValueError(f"it has over {_MOST_TOPICS} topics")
        if not all(isinstance(word, str) for word in words):
            raise TypeError("name, type or format of a topic is no text")
        topic, kind, encoding = words
        if (topic, kind) not in channels:
            text = own.get(kind) or definition_of(kind)
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channels[topic, kind] = writer.register_channel(topic, encoding, schema)
        numbers[number] = channels[topic, kind]
        if kind not in FIELDS:
            others.add(number)
    return numbers, others


def _own_definitions(connection: sqlite3.Connection) -> dict[str, str]:
    """Return the definitions that a bag itself has, of messages that are read."""
    rows = connection.execute(
        "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    )
    return {
        kind: text for kind, encoding, text in rows if encoding == "ros2msg" and type(text) is str
    }


def definition_of(kind: str) -> str:
    """Return the definition of a kind of message that is read, with those of its parts.

    Args:
        kind: such as `sensor_msgs/msg/JointState`.

    Returns:
        In rosbag2's encoding `ros2msg`; empty where the kind is not known.
    """
    if kind not in FIELDS or (short := kind.replace("/msg/", "/")) not in _DEFINITIONS:
        return ""
    needed = [short]
    for name in needed:  # It grows: parts of parts.
        parts = re.findall(r"(\w+/\w+)(?:\[\d*\])? ", _DEFINITIONS[name])
        needed += [part for part in dict.fromkeys(parts) if part not in needed]
    text = partial(_DEFINITIONS.__getitem__)
    own, *rest = ((name, text(name).replace("; ", "\n")) for name in needed)
    return "\n".join([own[1], *(f"{_LINE}\nMSG: {name}\n{fields}" for name, fields in rest)])
