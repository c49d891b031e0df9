"""Contact forces on the few geoms that anything asks about."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nw_eval.sim.binding import MjData, MjModel, mujoco

if TYPE_CHECKING:
    from collections.abc import Sequence


class ContactForces:
    """Adds up contact forces on chosen geoms.

    Args:
        model: compiled model.
        names: geom names; the order of every result.
        in_contact_frames: add each contact's force in that contact's own frame, unrotated and
            unsigned, as the published evaluation does. Otherwise forces are rotated to the world,
            where they act on the named geom.
    """

    def __init__(self, model: MjModel, names: Sequence[str], *, in_contact_frames: bool) -> None:
        self._model = model
        self._row = {int(model.geom(name).id): row for row, name in enumerate(names)}
        self._in_contact_frames = in_contact_frames
        self._wrench = np.zeros(6)

    def read(self, data: MjData) -> npt.NDArray[np.float64]:
        """Return the magnitude of the summed force on each geom, (len(names),) in N."""
        forces = np.zeros((len(self._row), 3))
        frames = None
        for index, pair in enumerate(data.contact.geom.tolist()):
            # Force and frame are those of the first geom acting on the second.
            for geom, sign in zip(pair, (-1.0, 1.0), strict=True):
                row = self._row.get(geom)
                if row is None:
                    continue
                mujoco.mj_contactForce(self._model, data, index, self._wrench)
                force = self._wrench[:3]
                if not self._in_contact_frames:
                    if frames is None:
                        frames = data.contact.frame
                    # Rows of the frame are its axes: transposed, it rotates to the world.
                    force = sign * (force @ frames[index].reshape(3, 3))
                forces[row] += force
        return np.linalg.norm(forces, axis=1)
