"""Cameras that sit elsewhere than the robot's own do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nw_eval.robots.spec import CameraMount


def remounted(mount: CameraMount, *, pitch: float, height: float, factor: float) -> CameraMount:
    """Return a camera that looks farther down, sits higher and sees more or less.

    The same values as the robot's own change no bit.

    Args:
        mount: the robot's own.
        pitch: angle by which it looks farther down, rad.
        height: length by which it sits higher on the trunk, m.
        factor: of its vertical field of view.
    """
    if (pitch, height, factor) == (0.0, 0.0, 1.0):
        return mount
    x, y, z = mount.position
    cosine, sine = math.cos(pitch), math.sin(pitch)
    # About the camera's x axis, to the right: its optical axis goes down.
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])
    rows = (np.array(mount.R_trunk_camera) @ turn).tolist()
    return replace(
        mount,
        position=(x, y, z + height),
        R_trunk_camera=tuple((a, b, c) for a, b, c in rows),
        fovy=mount.fovy * factor,
    )
