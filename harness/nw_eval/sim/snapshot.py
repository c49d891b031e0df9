"""A world's state as bytes: MuJoCo's integration state and a few numbers of our own.

Layout, little endian: 4 bytes magic, 8 bytes fingerprint of the model, then float64: the state that
`mjSTATE_INTEGRATION` names (time, positions, velocities, controls, warm start, ...), then the extra
arrays one after another.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nw_eval.errors import TrialError
from nw_eval.sim.binding import MjData, MjModel, mujoco

if TYPE_CHECKING:
    from collections.abc import Mapping

_MAGIC = b"NWS1"
_FINGERPRINT_SIZE = 8
_SIGNATURE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_FLOAT = np.dtype("<f8")


def fingerprint(model: MjModel) -> bytes:
    """Return 8 bytes that tell models apart whose futures differ: geometry, masses, servos."""
    option = model.opt
    parts = (
        np.array([option.timestep, *option.gravity, option.iterations, model.ngeom, model.nbody]),
        model.geom_type,
        model.geom_pos,
        model.geom_quat,
        model.geom_size,
        model.geom_friction,
        model.body_mass,
        model.dof_damping,
        model.dof_armature,
        model.dof_frictionloss,
        model.actuator_gainprm,
        model.actuator_forcerange,
    )
    digest = hashlib.sha256()
    for part in parts:
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.digest()[:_FINGERPRINT_SIZE]


def pack(
    model: MjModel,
    data: MjData,
    numbers: Mapping[str, npt.NDArray[np.float64]],
    model_print: bytes,
) -> bytes:
    """Return the state of `data` and `numbers` as bytes; `model_print` is `fingerprint(model)`."""
    physics = np.zeros(mujoco.mj_stateSize(model, _SIGNATURE))
    mujoco.mj_getState(model, data, physics, _SIGNATURE)
    values = np.concatenate([physics, *numbers.values()]).astype(_FLOAT, copy=False)
    return _MAGIC + model_print + values.tobytes()


def unpack(
    model: MjModel,
    data: MjData,
    numbers: Mapping[str, npt.NDArray[np.float64]],
    model_print: bytes,
    state: bytes,
) -> None:
    """Write `state` into `data` and, in place, into `numbers`, which gives names and sizes.

    Raises:
        TrialError: `state` is damaged, or belongs to another model.
    """
    header = _MAGIC + model_print
    size = mujoco.mj_stateSize(model, _SIGNATURE)
    expected = len(header) + _FLOAT.itemsize * (size + sum(map(len, numbers.values())))
    if state[: len(_MAGIC)] != _MAGIC or len(state) != expected:
        raise TrialError(
            f"cannot restore a state of {len(state)} bytes where {expected} are needed",
            fix="pass on unchanged what World.state returned",
        )
    if state[: len(header)] != header:
        raise TrialError(
            "cannot restore a state of another model",
            fix="make the World with the same robot, scene, protocol, servos and perturbations",
        )
    values = np.frombuffer(state, dtype=_FLOAT, offset=len(header)).astype(np.float64)
    # A reset first clears warnings and everything that the state does not hold.
    mujoco.mj_resetData(model, data)
    mujoco.mj_setState(model, data, values[:size], _SIGNATURE)
    start = size
    for array in numbers.values():
        array[:] = values[start : start + len(array)]
        start += len(array)
