"""Progress along a trail: which waypoints the robot has reached, in order."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from nw_eval.arrays import read_only
from nw_eval.errors import SceneError
from nw_eval.protocol import STRICT, EvaluationProtocol

if TYPE_CHECKING:
    from collections.abc import Sequence

REACH_RADIUS = 0.3  # m, in the ground plane; the waypoint's height does not matter
REACH_STEPS = 6  # control steps within the radius


class _Reached(NamedTuple):
    """All that changes in a trial."""

    updates: int  # control steps seen
    waypoint: int  # index of the one to go to
    reached: int  # how many are credited
    timer: int  # steps within reach of it
    times: tuple[float, ...]  # of the credits, s


class TrailProgress:
    """Counts waypoints. Call `update` once after every control step.

    A waypoint is credited on the step after its sixth step within 0.3 m, so a robot that enters at
    step n and stays has it at step n + 6. Waypoints count in order only. The six steps are
    consecutive if the protocol's `reach_timer_forgets`: leaving starts the count again. Otherwise
    it never goes back.

    Args:
        waypoints: (K, 3) world, m; K at least 1.
        protocol: see above.
        control_period: seconds between updates, for `times`.

    Raises:
        SceneError: there is no waypoint.
    """

    def __init__(
        self,
        waypoints: npt.NDArray[np.float64],
        protocol: EvaluationProtocol = STRICT,
        *,
        control_period: float = 0.02,
    ) -> None:
        self.waypoints = read_only(np.array(waypoints, dtype=np.float64).reshape(-1, 3))
        if not len(self.waypoints):
            raise SceneError("a trail without waypoints", fix="give the scene at least one")
        self._forgets = protocol.reach_timer_forgets
        self._control_period = control_period
        self._so_far = _Reached(updates=0, waypoint=0, reached=0, timer=0, times=())

    def update(self, trunk_xy: npt.NDArray[np.float64] | Sequence[float]) -> bool:
        """Take the trunk's position after a control step; say if a waypoint was credited now.

        Args:
            trunk_xy: (2,) or (3,) world, m; only x and y count.
        """
        updates, index, reached, timer, times = self._so_far
        updates += 1
        credited = timer >= REACH_STEPS and reached < self.total
        if timer >= REACH_STEPS:
            index = min(index + 1, self.total - 1)
            timer = 0
        if credited:
            reached += 1
            times = (*times, updates * self._control_period)
        offset = self.waypoints[index, :2] - np.asarray(trunk_xy, dtype=np.float64)[:2]
        if np.hypot(offset[0], offset[1]) < REACH_RADIUS:
            timer += 1
        elif self._forgets:
            timer = 0
        self._so_far = _Reached(updates, index, reached, timer, times)
        return credited

    @property
    def index(self) -> int:
        """Index of the waypoint to go to; stays at the last one when all are reached."""
        return self._so_far.waypoint

    @property
    def reached(self) -> int:
        """How many waypoints have been credited."""
        return self._so_far.reached

    @property
    def total(self) -> int:
        """How many waypoints there are."""
        return len(self.waypoints)

    @property
    def fraction(self) -> float:
        """Share of the waypoints credited, 0 to 1: the success rate of the trial."""
        return self.reached / self.total

    @property
    def target(self) -> npt.NDArray[np.float64]:
        """The waypoint to go to, (3,) world, m."""
        return self.waypoints[self.index].copy()

    @property
    def times(self) -> tuple[float, ...]:
        """When each waypoint was credited, seconds since the reset."""
        return self._so_far.times

    def state(self) -> bytes:
        """Return how far it is, for `restore`."""
        *counts, times = self._so_far
        # The JSON of finite numbers, whose encoder takes ten times as long.
        return repr([*counts, [*times]]).encode()

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of this trail."""
        updates, waypoint, reached, timer, times = json.loads(state)
        self._so_far = _Reached(updates, waypoint, reached, timer, tuple(times))
