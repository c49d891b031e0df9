"""What a sensor is, and what it is asked about."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import read_only
from nw_eval.cards import Action
from nw_eval.memory import Memory
from nw_eval.scenes.scene import Nearness
from nw_eval.sim import TrailProgress, World

Array = NDArray[np.float64]


@dataclass(kw_only=True)
class Moment:
    """One instant of a trial: after a control step, after the trail's update for it.

    The rollout makes one for each control step and shows it to every sensor; what nearly all of
    them need is computed once, at the start.
    """

    world: World
    progress: TrailProgress
    step: int
    """Control steps done: 0 at the start of the trial."""
    applied_action: Action
    """(12,) the raw action of the last control step, in the policy's order; zeros first."""
    last_output: Action
    """(12,) what the policy returned last, before any delay; zeros first."""
    earlier_outputs: tuple[Action, ...] = ()
    """What it returned before that, (12,) each, the newest first; zeros where there is no more."""
    standing_cones: Array | None = None
    """(K, 3) waypoints that have a cone, m; None = all of the trail's."""
    position: Array = field(init=False)
    """Trunk origin in the world, (3,) m."""
    roll_pitch_yaw: tuple[float, float, float] = field(init=False)
    """Euler angles of the trunk, rad; as `World.roll_pitch_yaw`, on plain numbers for speed."""
    shared: dict[str, Any] = field(default_factory=dict[str, Any], init=False)
    """What one sensor has worked out and another one can use, by a key of their own."""

    def __post_init__(self) -> None:
        self.position = read_only(self.world.trunk_position)
        w, x, y, z = self.world.trunk_quat.tolist()
        self.roll_pitch_yaw = (
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)),
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        )

    @property
    def cones(self) -> Array:
        """Where cones stand, (K, 3) m, world."""
        return self.progress.waypoints if self.standing_cones is None else self.standing_cones

    @property
    def rotation(self) -> Array:
        """R_world_trunk, (3, 3)."""
        return self.world.trunk_rotation

    @cached_property
    def delta_yaw(self) -> float:
        """Angle from the heading to the next waypoint, rad in [-pi, pi), positive to the left."""
        goal_x, goal_y, _ = self.progress.target.tolist()
        x, y, _ = self.position.tolist()
        bearing = math.atan2(goal_y - y, goal_x - x)
        return (bearing - self.roll_pitch_yaw[2] + math.pi) % (2.0 * math.pi) - math.pi


class Sensor(Memory[bytes], Protocol):
    """One observation of a card in one trial.

    `read` is called once at every control step, from step 0 on. It computes a new sample only at
    the sensor's own rate and returns the last one between.
    """

    @property
    def name(self) -> str:
        """The observation's name on the card."""
        ...

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of what `read` returns."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of what `read` returns."""
        ...

    @property
    def unit(self) -> str:
        """What the numbers are, for logs: "m", "rgb", or "mixed"."""
        ...

    @property
    def rate(self) -> int:
        """Samples per second, Hz."""
        ...

    @property
    def is_image(self) -> bool:
        """Whether this is a rendered image, which costs far more than numbers do."""
        ...

    @property
    def fresh(self) -> bool:
        """Whether the last `read` returned another sample than the one before it."""
        ...

    @property
    def coverage(self) -> float | None:
        """Share of the newest camera image that the splat covers, 0..1; None without an image."""
        ...

    @property
    def nearness(self) -> Nearness | None:
        """How far the newest camera image was taken from the nearest capture camera of the scene.

        None without an image of the splat, or without such cameras.
        """
        ...

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        ...

    def read(self, moment: Moment) -> NDArray[Any]:
        """Return the observation that the policy sees now. Do not change the array."""
        ...
