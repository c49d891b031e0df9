"""Turns MuJoCo's warnings into errors."""

from __future__ import annotations

import numpy as np

from nw_eval.errors import DivergedError, TrialError
from nw_eval.sim.binding import MjData, mujoco

_FIX = "look at the policy's last actions and the scene's geometry near the robot"

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
        mujoco.set_mju_user_warning(_ignore)


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


def _ignore(_message: str) -> None:
    """Drop the text: the counters that `check` reads hold what matters."""
