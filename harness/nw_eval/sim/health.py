"""Turns MuJoCo's warnings into errors."""

from __future__ import annotations

import numpy as np

from nw_eval.errors import TrialError
from nw_eval.sim.binding import MjData, mujoco

_MEANING = {
    int(mujoco.mjtWarning.mjWARN_INERTIA): "the inertia matrix is near singular",
    int(mujoco.mjtWarning.mjWARN_CONTACTFULL): "the contact buffer is full",
    int(mujoco.mjtWarning.mjWARN_CNSTRFULL): "the constraint buffer is full",
    int(mujoco.mjtWarning.mjWARN_BADQPOS): "a position is NaN, infinite or huge",
    int(mujoco.mjtWarning.mjWARN_BADQVEL): "a velocity is NaN, infinite or huge",
    int(mujoco.mjtWarning.mjWARN_BADQACC): "an acceleration is NaN, infinite or huge",
    int(mujoco.mjtWarning.mjWARN_BADCTRL): "a control is NaN, infinite or huge",
}


def keep_warnings_out_of_files() -> None:
    """Stop MuJoCo from writing MUJOCO_LOG.TXT into the working folder; `check` reads the counts."""
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_ignore)


def check(data: MjData) -> None:
    """Raise if MuJoCo has warned since the last reset.

    Raises:
        TrialError: the physics cannot be trusted any more.
    """
    counts = data.warning.number
    if not counts.any():
        return
    kind = int(np.flatnonzero(counts)[0])
    raise TrialError(
        f"physics failed at {data.time:.3f} s: {_MEANING.get(kind, f'MuJoCo warning {kind}')}",
        fix="look at the policy's last actions and the scene's geometry near the robot",
    )


def _ignore(_message: str) -> None:
    """Drop the text: the counters that `check` reads hold what matters."""
