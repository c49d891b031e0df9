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
from typing import Any, cast

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from nw_base.clean import clean
from nw_base.errors import PolicyError
from nw_policies.executor import Graph, UnsupportedError
from nw_policies.motions.motion import FRAMES, Array, MotionFile, checked_motion
from nw_policies.safety import FileLimits, check_onnx
from nw_policies.safety.objects import Record, TensorRef, read_index

_LARGEST = 2**28
"""Bytes of all arrays of a file: half an hour of a humanoid with its bodies."""
_COLUMNS = 500
_ROOT = 7
"""Numbers of a root's pose: position and quaternion."""
_OTHERS = {"poses": "AMASS", "pose_body": "AMASS", "qpos": "a log of MuJoCo", "trans": "AMASS"}
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
        motion = _npz(data, where)
    elif data[:1] == b"\x80":
        motion = _pickle(data, where)
    elif data[:1] == b"\x08":
        motion = _onnx(data, where)
    else:
        motion = _csv(data, where)
    return checked_motion(motion, where)


def _npz(data: bytes, where: str) -> MotionFile:
    arrays = _members(data, where)
    _require(arrays, ("fps", "joint_pos", "joint_vel", "body_pos_w", "body_quat_w"), where)
    names = tuple(map(str, arrays["joint_names"].ravel())) if "joint_names" in arrays else ()
    angles, rates = arrays["joint_pos"], arrays["joint_vel"]
    # holosoma writes MuJoCo's coordinates, where the root's stand before the joints'.
    if names and angles.shape[-1:] == (len(names) + _ROOT,):
        angles, rates = angles[..., _ROOT:], rates[..., _ROOT - 1 :]
    bodies = [str(name) for name in arrays["body_names"].ravel()] if "body_names" in arrays else []
    first = int(bodies[:1] == ["world"])  # MuJoCo counts the world as a body.
    return MotionFile(
        rate=float(arrays["fps"].ravel()[0]) if arrays["fps"].size else None,
        joints=names,
        joint_positions=_floats(angles),
        joint_velocities=_floats(rates),
        positions=_floats(arrays["body_pos_w"][:, first:]),
        quats=_floats(arrays["body_quat_w"][:, first:]),
    )


def _members(data: bytes, where: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of an .npz file: numbers and texts, no larger than their members."""
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [one for one in archive.infolist() if one.filename.endswith(".npy")]
            if sum(one.file_size for one in members) > _LARGEST:
                raise PolicyError(
                    f"{where}: its arrays have more than {_LARGEST >> 20} MiB",
                    fix="cut the motion into pieces",
                )
            for member in members:
                content = archive.read(member)
                arrays[member.filename.removesuffix(".npy")] = _array(content)
    except (zipfile.BadZipFile, ValueError, EOFError, NotImplementedError, RuntimeError) as error:
        raise PolicyError(
            f"{where}: not a usable .npz file: {clean(error, at_most=200)}",
            fix="copy or write the file again",
        ) from None
    return arrays


def _array(content: bytes) -> NDArray[Any]:
    """Return the array of an .npy file.

    Raises:
        ValueError: it is damaged, or holds Python objects.
    """
    stream = io.BytesIO(content)
    version = npy.read_magic(stream)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, is_fortran, dtype = read(stream)
    if dtype.kind not in "biufUS":
        raise ValueError(f"an array of {dtype}")
    numbers = np.frombuffer(content, dtype, math.prod(shape), stream.tell())
    return numbers.reshape(shape, order="F" if is_fortran else "C")


def _csv(data: bytes, where: str) -> MotionFile:
    try:
        lines = [line for line in data.decode("utf-8-sig").splitlines() if line.strip()]
    except UnicodeDecodeError:
        raise PolicyError(
            f"{where}: the file is no motion that is known here: .npz, .csv, .pkl or .onnx",
            fix=_FIX,
        ) from None
    if lines and not _is_numeric(lines[0]):
        lines = lines[1:]  # A header.
    if len(lines) > FRAMES:
        raise PolicyError(f"{where}: more than {FRAMES} frames", fix="cut the motion into pieces")
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        try:
            rows.append([float(cell) for cell in line.split(",")])
        except ValueError:
            raise PolicyError(
                f"{where}: line {number} of its numbers cannot be read: "
                f"{clean(line, at_most=60)!r}",
                fix="write numbers with commas between, a line a frame",
            ) from None
        if len(rows[-1]) != len(rows[0]):
            raise PolicyError(
                f"{where}: line {number} has {len(rows[-1])} numbers, the first {len(rows[0])}",
                fix="write as many numbers in every line",
            )
    columns = len(rows[0]) if rows else 0
    if not _ROOT < columns <= _COLUMNS:
        raise PolicyError(
            f"{where}: it has {columns} numbers a line; the root's position, its quaternion "
            "x, y, z, w and the joints are more than 7",
            fix=_FIX,
        )
    frames = np.array(rows)
    return _of_root(None, frames[:, :3], frames[:, 3:7], frames[:, 7:])


def _is_numeric(line: str) -> bool:
    try:
        float(line.split(",", maxsplit=1)[0])
    except ValueError:
        return False
    return True


def _of_root(rate: float | None, position: Array, xyzw: Array, angles: Array) -> MotionFile:
    """Return a motion of which the root's pose is known, its quaternion x, y, z, w."""
    return MotionFile(
        rate=rate,
        joint_positions=angles,
        positions=position[:, np.newaxis],
        quats=xyzw[:, np.newaxis, [3, 0, 1, 2]] if xyzw.shape[-1:] == (4,) else xyzw[:, np.newaxis],
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
    fps = fields.get("fps")
    rate = float(fps) if isinstance(fps, int | float) else None
    if "frames" in fields and "dof" not in fields:  # MimicKit: position, rotation vector, joints.
        frames = _numbers_of(fields["frames"], "frames", where)
        if frames.ndim != 2 or frames.shape[1] < _ROOT:
            raise PolicyError(f"{where}: frames have the shape {frames.shape}", fix=_FIX)
        return _of_root(rate, frames[:, :3], _xyzw_of(frames[:, 3:6]), frames[:, 6:])
    named = [
        next((key for key in keys if key in fields), keys[0])
        for keys in (("root_trans_offset", "root_pos"), ("root_rot",), ("dof", "dof_pos"))
    ]
    _require(fields, named, where)
    position, xyzw, angles = (_numbers_of(fields[name], name, where) for name in named)
    if angles.ndim == 3 and angles.shape[2] == 1:
        angles = angles[:, :, 0]
    return _of_root(rate, position, xyzw, angles)


def _numbers_of(value: Any, name: str, where: str) -> Array:
    """Return what a pickle has under a name, as numbers."""
    value = value.state if isinstance(value, Record) else value
    if isinstance(value, TensorRef) and value.storage.raw is not None:
        flat = np.frombuffer(value.storage.raw, value.storage.dtype)
        strides = [stride * flat.itemsize for stride in value.strides]
        return _floats(np.lib.stride_tricks.as_strided(flat, value.shape, strides))
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise PolicyError(f"{where}: {name} is no array of numbers", fix=_FIX) from None


def _xyzw_of(vectors: Array) -> Array:
    """Return the quaternions of rotation vectors, (T, 3) rad."""
    rows: list[list[float]] = []
    for x, y, z in vectors.tolist():
        angle = math.sqrt(x * x + y * y + z * z)
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
    tables = {name: table for name in graph.outputs if (table := _table(graph, name)) is not None}
    if "ref_pos_xyz" in tables:  # holosoma: of the anchor alone.
        _require(tables, ("joint_pos", "joint_vel", "ref_quat_xyzw"), where)
        motion = _of_root(None, tables["ref_pos_xyz"], tables["ref_quat_xyzw"], tables["joint_pos"])
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


def _table(graph: Graph, name: str) -> Array | None:
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
            return None if value is None else _floats(value)
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


def _floats(array: NDArray[Any]) -> Array:
    return np.array(array, dtype=np.float64)
