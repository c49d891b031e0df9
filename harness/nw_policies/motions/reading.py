"""Reads files of reference motions, as data: nothing of a pickle or a graph is run.

Layouts are from the code that writes them: HybridRobotics/whole_body_tracking
(`scripts/csv_to_npz.py`, `utils/exporter.py`), mujocolab/mjlab, amazon-far/holosoma
(`inference_helpers.py`), LeCAR-Lab/ASAP and TeleHuman/PBHC (`motion_lib`), YanjieZe/GMR,
xbpeng/MimicKit (`anim/motion.py`), and the README of the LAFAN1 set that Unitree has retargeted.
"""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import IO, Any, cast

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import NwEvalError, PolicyError
from nw_policies.executor import Graph, UnsupportedError
from nw_policies.motions.motion import BODIES, FRAMES, LARGEST, Array, MotionFile, checked_motion
from nw_policies.safety import FileLimits, check_onnx
from nw_policies.safety.objects import Opaque, Record, TensorRef, read_index

_COLUMNS = 500
_AXES = 3
"""Of an array of a pickle at most."""
_ROOT = 7
"""Numbers of a root's pose: position and quaternion."""
_OTHERS = {"poses": "AMASS", "pose_body": "AMASS", "qpos": "a log of MuJoCo", "trans": "AMASS"}
_NPZ = {"fps": -1, "joint_pos": 2, "joint_vel": 2, "body_pos_w": 3, "body_quat_w": 3}
"""Numbers of an .npz, and how many axes they have; -1 = any."""
_NAMES = ("joint_names", "body_names")
_LETTERS = 1024
"""Bytes of a name in an .npz at most."""
_AGAIN = "copy or write the file again"
_FIX = "convert it to an .npz of whole_body_tracking, or to a .csv of root and joints"


def read_motion(data: bytes, where: str) -> MotionFile:
    """Return the motion of a file, whose kind is told by how it begins.

    Args:
        data: the whole file.
        where: its path, for errors.

    Raises:
        PolicyError: it is no motion of a robot, is damaged or too large, or asks to run code.

    Example:
        >>> motion = read_motion(Path("dance.npz").read_bytes(), "dance.npz")
    """
    if data[:4] == b"PK\x03\x04":
        read = _npz
    elif data[:1] == b"\x80":
        read = _pickle
    elif data[:1] == b"\x08":
        read = _onnx
    else:
        read = _csv
    try:
        return checked_motion(read(data, where), where)
    except NwEvalError:
        raise
    except Exception as error:  # noqa: BLE001 - whatever a damaged file brings about.
        raise PolicyError(
            f"{where}: the motion in it cannot be read: {type(error).__name__}", fix=_AGAIN
        ) from None


def _npz(data: bytes, where: str) -> MotionFile:
    arrays = _members(data, where)
    _require(arrays, tuple(_NPZ), where)
    names = tuple(map(str, arrays["joint_names"].ravel())) if "joint_names" in arrays else ()
    angles, rates = arrays["joint_pos"], arrays["joint_vel"]
    # holosoma writes MuJoCo's coordinates, where the root's stand before the joints'.
    if names and angles.shape[1] == len(names) + _ROOT:
        angles, rates = angles[:, _ROOT:], rates[:, _ROOT - 1 :]
    bodies = [str(name) for name in arrays["body_names"].ravel()] if "body_names" in arrays else []
    first = int(bodies[:1] == ["world"])  # MuJoCo counts the world as a body.
    return MotionFile(
        rate=_rate(arrays["fps"], where),
        joints=names,
        joint_positions=angles,
        joint_velocities=rates,
        positions=arrays["body_pos_w"][:, first:],
        quats=arrays["body_quat_w"][:, first:],
    )


def _members(data: bytes, where: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz that belong to a motion, and empty ones in place of others."""
    arrays: dict[str, NDArray[Any]] = {}
    name, left = "the archive", LARGEST
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for member in archive.infolist():
                name = clean(member.filename.removesuffix(".npy"), at_most=40)
                arrays[name] = np.empty(0)
                if name in _NPZ or name in _NAMES:
                    with archive.open(member) as stream:
                        arrays[name] = _array(stream, name, left, where)
                    left -= arrays[name].nbytes
    except PolicyError:
        raise
    except Exception as error:  # noqa: BLE001 - each kind of compression has its own errors.
        why = error if isinstance(error, zipfile.BadZipFile) else type(error).__name__
        raise PolicyError(
            f"{where}: not a usable .npz file: {name} cannot be read: {clean(why, at_most=200)}",
            fix=_AGAIN,
        ) from None
    return arrays


def _array(stream: IO[bytes], name: str, most: int, where: str) -> NDArray[Any]:
    """Return the array of an .npy file, numbers in double precision, of at most so many bytes.

    All that its header says is checked before its numbers are read.

    Raises:
        PolicyError: its shape or type is not what the name is for, or it is too large.
    """
    version = npy.read_magic(stream)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, is_fortran, dtype = read(stream)
    if not all(type(size) is int and size >= 0 for size in shape):
        raise PolicyError(f"{where}: {name} has the shape {clean(shape, at_most=60)}", fix=_AGAIN)
    count = math.prod(shape)
    if name in _NAMES:
        if dtype.kind not in "US" or dtype.itemsize > _LETTERS or count > BODIES:
            raise PolicyError(
                f"{where}: {name} is no array of at most {BODIES} names",
                fix="write the names as text",
            )
    else:
        _check_numbers(shape, dtype, name, where, axes=_NPZ[name], most=most)
    content = stream.read(count * dtype.itemsize + 1)  # To the end: only there is its sum checked.
    if len(content) != count * dtype.itemsize:
        raise PolicyError(
            f"{where}: {name} has more or fewer bytes than its shape {shape} says", fix=_AGAIN
        )
    array = np.frombuffer(content, dtype).reshape(shape, order="F" if is_fortran else "C")
    return array if name in _NAMES else _double(array)


def _check_numbers(
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    name: str,
    where: str,
    *,
    axes: int = -1,
    most: int = LARGEST,
) -> None:
    """Refuse what is no array of numbers, before memory is taken for it."""
    if dtype.kind not in "iuf":
        raise PolicyError(f"{where}: {name} has {dtype} in place of numbers", fix=_FIX)
    if axes >= 0 and len(shape) != axes:
        raise PolicyError(
            f"{where}: {name} has the shape {shape}, and not {axes} axes",
            fix="write the motion again: a row for each frame",
        )
    if math.prod(shape) * 8 > most:
        raise PolicyError(
            f"{where}: its arrays have more than {LARGEST >> 20} MiB in double precision, "
            f"{name} with the shape {clean(shape, at_most=60)} among them",
            fix="cut the motion into pieces",
        )


def _rate(value: object, where: str) -> float | None:
    """Return the frames a second that a file has as `fps`; None where it has none."""
    if isinstance(value, Opaque) and value.number is not None:
        value = _array_of(value.number)
    if value is None:
        return None
    if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "iuf":
        return float(value.ravel()[0])
    if isinstance(value, float) or (type(value) is int and abs(value) < 2**63):
        return float(value)
    raise PolicyError(
        f"{where}: fps is {clean(value, at_most=60)}, and not one number of frames a second",
        fix="write fps as one number",
    )


def _csv(data: bytes, where: str) -> MotionFile:
    try:
        text = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig")
        # One more for a header, and one that is too much.
        lines = list(islice((line for line in text if line.strip()), FRAMES + 2))
    except UnicodeDecodeError:
        raise PolicyError(
            f"{where}: the file is no motion that is known here: .npz, .csv, .pkl or .onnx",
            fix=_FIX,
        ) from None
    if lines and not _is_numeric(lines[0]):
        lines = lines[1:]  # A header.
    if len(lines) > FRAMES:
        raise PolicyError(f"{where}: more than {FRAMES} frames", fix="cut the motion into pieces")
    columns = lines[0].count(",") + 1 if lines else 0
    if not _ROOT < columns <= _COLUMNS:
        raise PolicyError(
            f"{where}: it has {columns} numbers a line; the root's position, its quaternion "
            f"x, y, z, w and the joints are more than {_ROOT} and at most {_COLUMNS}",
            fix=f"write numbers with commas between, a line a frame; or {_FIX}",
        )
    _check_numbers((len(lines), columns), np.dtype(float), "the table", where)
    frames = np.empty((len(lines), columns))
    for number, line in enumerate(lines, start=1):
        try:
            row = [float(cell) for cell in line.split(",", maxsplit=_COLUMNS)]
        except ValueError:
            raise PolicyError(
                f"{where}: line {number} of its numbers cannot be read: "
                f"{clean(line, at_most=60)!r}",
                fix="write numbers with commas between, a line a frame",
            ) from None
        if len(row) != columns:
            raise PolicyError(
                f"{where}: line {number} has {len(row)} numbers, the first {columns}",
                fix="write as many numbers in every line",
            )
        frames[number - 1] = row
    return _of_root(None, frames[:, :3], frames[:, 3:7], frames[:, 7:], where)


def _is_numeric(line: str) -> bool:
    try:
        float(line.split(",", maxsplit=1)[0])
    except ValueError:
        return False
    return True


def _of_root(
    rate: float | None, position: Array, xyzw: Array, angles: Array, where: str
) -> MotionFile:
    """Return a motion of which the root's pose is known, its quaternion x, y, z, w.

    Raises:
        PolicyError: one of the arrays has not two axes, or the quaternion not four columns.
    """
    for name, array, columns in (
        *(("the root's position", position, 3), ("the root's quaternion", xyzw, 4)),
        ("the joints' angles", angles, None),
    ):
        if array.ndim != 2 or array.shape[1] != (columns or array.shape[1]):
            raise PolicyError(
                f"{where}: the shape of {name} is {array.shape}, and not "
                f"(frames, {columns or 'joints'})",
                fix="write the motion again: a row for each frame",
            )
    return MotionFile(
        rate=rate,
        joint_positions=angles,
        positions=position[:, np.newaxis],
        quats=xyzw[:, np.newaxis, [3, 0, 1, 2]],
    )


def _pickle(data: bytes, where: str) -> MotionFile:
    tree = read_index(data, where, FileLimits(), pickled=True).tree
    fields = cast("dict[Any, Any]", tree) if isinstance(tree, dict) else {}
    if len(fields) > 1 and all(isinstance(value, dict) for value in fields.values()):
        listed = ", ".join(clean(key, at_most=60) for key in list(fields)[:3])
        raise PolicyError(
            f"{where}: the file has {len(fields)} motions: {listed}, ...",
            fix="write the one that is meant to a file of its own",
        )
    if len(fields) == 1:  # ASAP and PBHC: by the motion's name.
        inner = next(iter(fields.values()))
        fields = cast("dict[Any, Any]", inner) if isinstance(inner, dict) else fields
    rate = _rate(fields.get("fps"), where)
    if "frames" in fields and "dof" not in fields:  # MimicKit: position, rotation vector, joints.
        frames = _numbers_of(fields["frames"], "frames", where)
        if frames.ndim != 2 or frames.shape[1] < _ROOT:
            raise PolicyError(f"{where}: frames have the shape {frames.shape}", fix=_FIX)
        return _of_root(rate, frames[:, :3], _xyzw_of(frames[:, 3:6]), frames[:, 6:], where)
    named = [
        next((key for key in keys if key in fields), keys[0])
        for keys in (("root_trans_offset", "root_pos"), ("root_rot",), ("dof", "dof_pos"))
    ]
    _require(fields, named, where)
    position, xyzw, angles = (_numbers_of(fields[name], name, where) for name in named)
    if angles.ndim == 3 and angles.shape[2] == 1:
        angles = angles[:, :, 0]
    return _of_root(rate, position, xyzw, angles, where)


def _numbers_of(value: Any, name: str, where: str) -> Array:
    """Return what a pickle has under a name, as numbers."""
    value = value.state if isinstance(value, Record) else value
    if isinstance(value, TensorRef) and value.storage.raw is not None:
        _check_numbers(value.shape, np.dtype(value.storage.dtype), name, where)
        return _double(_array_of(value))
    # A list that stands in itself many times is far larger than its file.
    shape, inner = [], value
    while isinstance(inner, list | tuple) and len(shape) < _AXES:
        shape.append(len(inner))
        inner = inner[0] if inner else None
    _check_numbers(tuple(shape), np.dtype(float), name, where)
    try:
        if not shape or isinstance(inner, list | tuple):
            raise TypeError  # noqa: TRY301
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise PolicyError(f"{where}: {name} is no array of numbers", fix=_FIX) from None


def _array_of(value: TensorRef) -> NDArray[Any]:
    """Return an array whose numbers stand in the pickle."""
    flat = np.frombuffer(value.storage.raw or b"", value.storage.dtype)
    strides = [stride * flat.itemsize for stride in value.strides]
    return np.lib.stride_tricks.as_strided(flat, value.shape, strides)


def _xyzw_of(vectors: Array) -> Array:
    """Return the quaternions of rotation vectors, (T, 3) rad."""
    rows: list[list[float]] = []
    for x, y, z in vectors.tolist():
        angle = math.sqrt(x * x + y * y + z * z)
        if not math.isfinite(angle):  # It has no sine; `checked_motion` says the frame.
            rows.append([math.nan] * 4)
            continue
        share = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
        rows.append([x * share, y * share, z * share, math.cos(angle / 2)])
    return np.array(rows).reshape(-1, 4)


def _onnx(data: bytes, where: str) -> MotionFile:
    """Read the motion that a policy holds: tables of which `time_step` picks a row."""
    from nw_policies.networks.onnx_reading import read_declared, read_graph

    check_onnx(data, where)
    try:
        graph, metadata = read_graph(data), read_declared(data).metadata
    except (ValueError, UnsupportedError) as error:
        raise PolicyError(
            f"{where}: no motion can be read in it: {clean(error, at_most=200)}", fix=_FIX
        ) from None
    tables: dict[str, Array] = {}
    for name in graph.outputs:
        if (table := _table(graph, name)) is not None:
            _check_numbers(table.shape, table.dtype, clean(name, at_most=40), where)
            tables[name] = _double(table)
    if "ref_pos_xyz" in tables:  # holosoma: of the anchor alone.
        _require(tables, ("joint_pos", "joint_vel", "ref_quat_xyzw"), where)
        root, xyzw = tables["ref_pos_xyz"], tables["ref_quat_xyzw"]
        motion = _of_root(None, root, xyzw, tables["joint_pos"], where)
    else:
        _require(tables, ("joint_pos", "joint_vel", "body_pos_w", "body_quat_w"), where)
        motion = MotionFile(
            rate=None,
            joint_positions=tables["joint_pos"],
            positions=tables["body_pos_w"],
            quats=tables["body_quat_w"],
        )
    return replace(
        motion,
        joints=_listed(metadata.get("joint_names") or metadata.get("dof_names") or ""),
        joint_velocities=tables["joint_vel"],
        is_of_anchor="ref_pos_xyz" in tables,
    )


def _table(graph: Graph, name: str) -> NDArray[Any] | None:
    """Return the numbers of which an output is a row; None where it is none."""
    nodes = {output: node for node in graph.nodes for output in node.outputs}
    for _ in range(8):  # Behind copies and casts.
        node = nodes.get(name)
        if node is None or not node.inputs:
            return None
        name = node.inputs[0]
        if node.operator in {"Gather", "GatherND"}:
            source = nodes.get(name)
            value = graph.constants.get(name)
            if value is None and source is not None and source.operator == "Constant":
                value = source.attributes.get("value")
            return None if value is None else np.asarray(value)
    return None


def _listed(text: str) -> tuple[str, ...]:
    """Return names that metadata have, joined by commas or as JSON."""
    try:
        names = json.loads(text)
    except ValueError:
        names = [name.strip() for name in text.split(",")]
    return tuple(map(str, names)) if isinstance(names, list) and text else ()


def _require(fields: Mapping[Any, Any], names: Sequence[str], where: str) -> None:
    absent = [name for name in names if name not in fields]
    if absent:
        has = ", ".join(clean(key, at_most=40) for key in list(fields)[:12]) or "nothing"
        other = next((f": that is {kind}" for key, kind in _OTHERS.items() if key in fields), "")
        raise PolicyError(
            f"{where}: the motion has no {', '.join(absent)}; it has {has}{other}", fix=_FIX
        )


def _double(array: NDArray[Any]) -> Array:
    with np.errstate(over="ignore"):  # Of long doubles; `checked_motion` refuses infinity.
        return np.array(array, dtype=np.float64)
