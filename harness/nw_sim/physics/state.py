"""A world's state as bytes, and whether the physics can still be trusted.

The bytes are MuJoCo's integration state and a few numbers of our own. Layout, little endian: 4
bytes magic, 8 bytes fingerprint of the model, then float64: the state that `mjSTATE_INTEGRATION`
names (time, positions, velocities, controls, warm start, ...), then the extra arrays one after
another. MuJoCo's warnings become errors.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nw_base.errors import DivergedError, TrialError
from nw_sim.physics.binding import MjData, MjModel, mujoco

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_sim.physics.model import Actuators


_MAGIC = b"NWS1"
_FINGERPRINT_SIZE = 8
_SIGNATURE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_FLOAT = np.dtype("<f8")


def fingerprint(model: MjModel, actuators: Actuators) -> bytes:
    """Return 8 bytes that tell worlds apart whose futures differ: geometry, masses, motors."""
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
    for drive in actuators.drives:  # The model has nothing of their gains.
        digest.update(drive.motor.model_dump_json().encode() + drive.joints.tobytes())
        digest.update(b"" if drive.program is None else drive.program.packed())
        digest.update(actuators.kp.tobytes() + actuators.kd.tobytes())
        digest.update(repr((actuators.follows, actuators.strength)).encode())
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


_FIX = "check the policy's last actions and the scene's geometry near the robot"

_DIVERGED = {
    int(mujoco.mjtWarning.mjWARN_BADQPOS): "a position is NaN, infinite or huge",
    int(mujoco.mjtWarning.mjWARN_BADQVEL): "a velocity is NaN, infinite or huge",
    int(mujoco.mjtWarning.mjWARN_BADQACC): "an acceleration is NaN, infinite or huge",
    int(mujoco.mjtWarning.mjWARN_BADCTRL): "a control is NaN, infinite or huge",
}
_OTHER = {
    int(mujoco.mjtWarning.mjWARN_INERTIA): "the inertia matrix is near singular",
    int(mujoco.mjtWarning.mjWARN_CONTACTFULL): "the contact buffer is full",
    int(mujoco.mjtWarning.mjWARN_CNSTRFULL): "the constraint buffer is full",
}


def keep_warnings_out_of_files() -> None:
    """Stop MuJoCo from writing MUJOCO_LOG.TXT into the working folder; `check` reads the counts."""
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_ignore_warning)


def check(data: MjData, time: float) -> None:
    """Raise if MuJoCo has warned since the last reset.

    Args:
        data: the simulation's.
        time: of the simulation, s; MuJoCo has set its own back to 0 if a number went bad.

    Raises:
        DivergedError: a number of the state is NaN, infinite or beyond MuJoCo's 1e10.
        TrialError: the physics cannot be trusted any more for another reason.
    """
    counts = data.warning.number
    if not counts.any():
        return
    kinds = np.flatnonzero(counts).tolist()
    # What explodes may fill buffers on its way: that it exploded is the news.
    for kind in (kind for kind in kinds if kind in _DIVERGED):
        raise DivergedError(f"physics failed at {time:.3f} s: {_DIVERGED[kind]}", fix=_FIX)
    meaning = _OTHER.get(kinds[0], f"MuJoCo warning {kinds[0]}")
    raise TrialError(f"physics failed at {time:.3f} s: {meaning}", fix=_FIX)


def _ignore_warning(_message: str) -> None:
    """Drop the text: the counters that `check` reads hold what matters."""
