"""Contact forces on the few geoms that anything asks about."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nw_eval.sim.binding import MjData, MjModel

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = npt.NDArray[np.float64]


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
        self._row = {int(model.geom(name).id): row for row, name in enumerate(names)}
        self._in_contact_frames = in_contact_frames

    def read(self, data: MjData, solved: Array | None = None) -> Array:
        """Return the magnitude of the summed force on each geom, (len(names),) in N.

        Args:
            data: with its contacts.
            solved: constraint forces by row, as a solver left them; where it has fewer rows than a
                contact asks for, those are 0. None = those of `data`.
        """
        rows = data.efc_force if solved is None else solved
        if len(rows) < data.nefc:
            rows = np.concatenate([rows, np.zeros(data.nefc - len(rows))])
        forces = np.zeros((len(self._row), 3))
        contact = data.contact
        watched = [
            (index, row, sign)
            for index, pair in enumerate(contact.geom.tolist())
            # Force and frame are those of the first geom acting on the second.
            for geom, sign in zip(pair, (-1.0, 1.0), strict=True)
            if (row := self._row.get(geom)) is not None
        ]
        if not watched:
            return np.zeros(len(forces))
        starts, sizes = contact.efc_address.tolist(), contact.dim.tolist()
        friction, frames = contact.friction, contact.frame
        for index, row, sign in watched:
            if starts[index] < 0:  # It lies within the margin and pushes nothing.
                continue
            force = _contact_force(rows, starts[index], sizes[index], friction[index])
            if not self._in_contact_frames:
                # Rows of the frame are its axes: transposed, it rotates to the world.
                force = sign * (force @ frames[index].reshape(3, 3))
            forces[row] += force
        return np.linalg.norm(forces, axis=1)


def _contact_force(rows: Array, start: int, size: int, friction: Array) -> Array:
    """Return a contact's force in its own frame, (3,) N: normal, then tangents.

    What `mj_contactForce` does for pyramidal cones, which every model here has, but from rows that
    need not be the solver's present ones.

    Args:
        rows: constraint forces.
        start: the contact's first row.
        size: its dimensions: 1 without friction, else 3, 4 or 6.
        friction: (5,) its coefficients.
    """
    if size == 1:
        return np.array([rows[start], 0.0, 0.0])
    # Each pair of rows holds the two opposite edges of the pyramid along one axis.
    edges = rows[start : start + 2 * (size - 1)].tolist()
    return np.array(
        [
            sum(edges),
            (edges[0] - edges[1]) * friction[0],
            (edges[2] - edges[3]) * friction[1],
        ]
    )
