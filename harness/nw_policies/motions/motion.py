"""What a file of a reference motion holds, and the checks that every such file passes.

| file | written by | joints | poses |
|---|---|---|---|
| `.npz` | whole_body_tracking (BeyondMimic), mjlab, unitree_rl_lab | angles, rates | bodies |
| `.csv` | LAFAN1 retargeted by Unitree, and sets in that layout | angles | root |
| `.pkl` | ASAP, PBHC, PHC (joblib); GMR, TWIST, MimicKit (pickle) | angles | root |
| `.onnx` | whole_body_tracking, mjlab, holosoma, in policies | angles, rates | bodies |

A file in the first row names no joints: Isaac Lab has them breadth first, mjlab as the MJCF has
them. Which of the orders it is follows from the poses of its bodies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import PolicyError

Array = NDArray[np.float64]

FRAMES = 200_000
"""Most frames of a motion: more than an hour at 50 Hz."""
BODIES = 512
"""Most bodies of a motion, and most names."""
LARGEST = 2**28
"""Bytes of all arrays of a file in double precision: half an hour of a humanoid with its bodies."""
_MOST = 1e4
"""Largest number of a motion: m of a position, rad of a joint, rad/s of its rate."""
_MOST_RATE = 1e4
_UNIT = 0.02
"""By how much the norm of a quaternion may differ from 1; files are rounded."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionFile:
    """A motion of T frames, as its file has it. Quaternions are w, x, y, z; the world's z is up."""

    rate: float | None
    """Frames a second; None where the file does not say."""
    joints: tuple[str, ...] = ()
    """Names of the J joints, in their order; empty where the file does not say."""
    joint_positions: Array
    """(T, J) rad."""
    joint_velocities: Array | None = None
    """(T, J) rad/s; None where the file has none."""
    positions: Array
    """(T, B, 3) m, of the origins of bodies in the world; the first is the robot's root."""
    quats: Array
    """(T, B, 4), of the same."""
    is_of_anchor: bool = False
    """Whether the one body that it has is the anchor, and not the root."""


def checked_motion(motion: MotionFile, where: str) -> MotionFile:
    """Return a motion whose numbers have the right shapes and sizes, with unit quaternions.

    Raises:
        PolicyError: they have not; says which field, and at which frame.
    """
    count = len(np.atleast_1d(motion.joint_positions))
    if not 2 <= count <= FRAMES:
        raise PolicyError(
            f"{where}: the motion has {count} frames, and not 2 to {FRAMES}",
            fix="give a motion with at least two frames, or cut it into pieces",
        )
    joints = motion.joint_positions.shape[1] if motion.joint_positions.ndim == 2 else 0
    bodies = motion.positions.shape[1] if motion.positions.ndim == 3 else 0
    if bodies > BODIES:
        raise PolicyError(
            f"{where}: the motion has {bodies} bodies, and at most {BODIES} are read",
            fix="write the motion again with the bodies of the robot alone",
        )
    wanted: dict[str, tuple[Array | None, tuple[int, ...]]] = {
        "joint angles": (motion.joint_positions, (count, joints or 1)),
        "joint velocities": (motion.joint_velocities, (count, joints)),
        "positions of bodies": (motion.positions, (count, bodies or 1, 3)),
        "orientations of bodies": (motion.quats, (count, bodies, 4)),
    }
    for name, (array, shape) in wanted.items():
        if array is not None:
            _check(name, array, shape, where)
    if motion.joints and len(motion.joints) != joints:
        raise PolicyError(
            f"{where}: it names {len(motion.joints)} joints, and has angles of {joints}",
            fix="write the motion again with a name for each column",
        )
    if motion.rate is not None and not 0.0 < motion.rate <= _MOST_RATE:
        raise PolicyError(
            f"{where}: fps is {motion.rate:g}",
            fix=f"give more than 0 and at most {_MOST_RATE:g} frames a second",
        )
    norms = np.sqrt((motion.quats**2).sum(axis=-1))
    if (off := np.argwhere(np.abs(norms - 1.0) > _UNIT)).size:
        frame, body = off[0].tolist()
        raise PolicyError(
            f"{where}: the orientation of body {body} at frame {frame} has the norm "
            f"{norms[frame, body]:.3g}, and a quaternion has 1",
            fix="check which columns hold the quaternion",
        )
    return replace(motion, quats=motion.quats / norms[..., np.newaxis])


def _check(name: str, array: Array, shape: tuple[int, ...], where: str) -> None:
    """Refuse numbers of another shape, and such as no motion has."""
    if array.shape != shape:
        raise PolicyError(
            f"{where}: {name} have the shape {array.shape}, and not {shape}",
            fix="write the motion again: all fields have one row for each frame",
        )
    for bad, words, fix in (
        (~np.isfinite(array), "not finite", "repair or cut the motion"),
        (np.abs(array) > _MOST, f"over {_MOST:g}", "write the motion in m and rad, or repair it"),
    ):
        if bad.any():
            frame = int(bad.argmax()) * len(bad) // bad.size
            raise PolicyError(f"{where}: {name} are {words} at frame {frame}", fix=fix)
