"""What the policy sees: the 332 numbers of `policies/go1-parkour`, for many robots at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.observations import ScandotsObservation
from nw_eval.learn.teacher.world.body import Bodies, Robots
from nw_eval.learn.teacher.world.heights import read_scandots
from nw_eval.sensors.heights import grid

Array = NDArray[np.float64]

SPEED = 0.8
"""Commanded, m / s."""
FRAME, SCANDOTS, JOINTS, PAST = 53, 132, 12, 3
_KEPT = np.r_[0:5, 13:53]
"""Of a frame, once it is history: no angle to the waypoint, no speed, no mask."""
OBSERVED = FRAME + SCANDOTS + JOINTS + PAST * len(_KEPT)

_SCANDOTS = ScandotsObservation(sensor="scandots")
_GRID = grid(_SCANDOTS.x, _SCANDOTS.y, _SCANDOTS.order)


class Senses:
    """Builds observations, and remembers what of earlier ones is in them.

    Args:
        count: robots, N.
        pose: (12,) default joint positions, rad.

    Attributes:
        applied: (N, 12) raw actions that were applied last.
        output: (N, 12) raw actions that were taken last and still wait.
        contacts: (N, 4) feet that push now; `previous_contacts` those of the step before.
        history: (N, 3, 45) earlier frames, newest first.
    """

    def __init__(self, count: int, pose: Array) -> None:
        self._pose = pose
        self.applied = np.zeros((count, JOINTS))
        self.output = np.zeros((count, JOINTS))
        self.contacts = np.zeros((count, 4), dtype=np.bool_)
        self.previous_contacts = np.zeros((count, 4), dtype=np.bool_)
        self.history = np.zeros((count, PAST, len(_KEPT)), dtype=np.float32)
        self.is_new = np.ones(count, dtype=np.bool_)

    def begin(self, robots: NDArray[np.intp]) -> None:
        """Forget what some robots have seen and done."""
        for array in (self.applied, self.output, self.contacts, self.previous_contacts):
            array[robots] = 0
        self.is_new[robots] = True

    def take(self, actions: Array) -> None:
        """Take new actions, (N, 12) raw: the ones before are applied now."""
        self.applied = self.output
        self.output = actions

    def feel(self, contacts: NDArray[np.bool_]) -> None:
        """Take which feet push now, (N, 4)."""
        self.previous_contacts = self.contacts
        self.contacts = contacts

    def see(
        self,
        body: Bodies,
        delta_yaw: Array,
        lanes: NDArray[np.intp],
        grids: NDArray[np.float32],
        robots: Robots = slice(None),
    ) -> NDArray[np.float32]:
        """Return observations, (n, 332), and remember their frames.

        Args:
            body: of the robots, n of them.
            delta_yaw: (n,) angle to the next waypoint, rad.
            lanes: (n,) of the robots.
            grids: (L, X, Y) heights of all lanes, m.
            robots: which of all robots they are.
        """
        out = np.zeros((len(delta_yaw), OBSERVED), dtype=np.float32)
        frame = out[:, :FRAME]
        frame[:, 0:3] = body.rates * 0.25
        frame[:, 3], frame[:, 4] = body.roll, body.pitch
        frame[:, 6] = frame[:, 7] = delta_yaw
        frame[:, 10], frame[:, 11] = SPEED, 1.0
        frame[:, 13:25] = body.joints - self._pose
        frame[:, 25:37] = body.joint_rates * 0.05
        frame[:, 37:49] = self.applied[robots]
        frame[:, 49:53] = (self.contacts[robots] | self.previous_contacts[robots]) - 0.5
        dots = np.empty((len(out), SCANDOTS))
        read_scandots(grids, lanes, body.position, body.yaw, _GRID, _SCANDOTS.offset, dots)
        out[:, FRAME : FRAME + SCANDOTS] = dots
        out[:, FRAME + SCANDOTS : FRAME + SCANDOTS + JOINTS] = self.output[robots]
        kept = frame[:, _KEPT]
        history = np.where(self.is_new[robots][:, None, None], kept[:, None], self.history[robots])
        out[:, FRAME + SCANDOTS + JOINTS :] = history.reshape(len(out), -1)
        self.history[robots] = np.concatenate([kept[:, None], history[:, :-1]], axis=1)
        self.is_new[robots] = False
        return out

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return everything that changes, by name."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}
