"""Shows a trial's readings to its scores, some control steps at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import pack, unpack
from nw_eval.clean import clean
from nw_eval.errors import UsageError
from nw_eval.scores import Figures, Score, Stretch, TrialEnd, score_class
from nw_eval.scores.score import STRETCH

if TYPE_CHECKING:
    from nw_eval.sim import World
    from nw_eval.tasks import Task

Array = NDArray[np.float64]


class ScoreMeter:
    """The scores of one trial. A `Memory`: what is shown of it and of which steps.

    Args:
        names: of the scores.
        world: already reset to the trial's start.
        task: already reset.

    Raises:
        UsageError: there is no such score, or its class refuses.
    """

    def __init__(self, names: Sequence[str], world: World, task: Task) -> None:
        self._world, self._task = world, task
        self._physics = world.at_physics_rate()
        self._moving = world.moving()  # Views of the simulation's memory.
        figures = Figures(
            control_period=world.control_period,
            timestep=world.timestep,
            mass=world.mass,
            gravity=world.gravity,
            torque_limits=world.torque_limits,
            joint_ranges=np.array(world.robot.joint_ranges, dtype=np.float64),
        )
        self._scores: dict[str, Score] = {}
        for name in names:
            try:
                self._scores[name] = score_class(name)(figures)
            except Exception as error:
                raise UsageError(
                    f"score {name!r} cannot be opened: {clean(error, at_most=200)}",
                    fix="install its package, or leave it out",
                ) from error
        substeps, joints = self._physics.rates.shape
        feet = len(world.robot.feet)
        self._kept: dict[str, Array] = {
            "servo": np.zeros((STRETCH, substeps, joints)),
            "joint_rates": np.zeros((STRETCH, substeps, joints)),
            "joint_positions": np.zeros((STRETCH, joints)),
            "targets": np.zeros((STRETCH, joints)),
            "position": np.zeros((STRETCH, 3)),
            "quat": np.zeros((STRETCH, 4)),
            "velocity": np.zeros((STRETCH, 6)),
            "foot_positions": np.zeros((STRETCH, feet, 3)),
            "foot_forces": np.zeros((STRETCH, feet)),
            "command": np.full((STRETCH, 3), np.nan),
        }
        self._count = 0

    def take(self, targets: Array) -> None:
        """Take the readings of the control step that was just made.

        Args:
            targets: what the motors were told, (J,).
        """
        kept, now, world = self._kept, self._count, self._world
        kept["servo"][now] = self._physics.servo
        kept["joint_rates"][now] = self._physics.rates
        positions, quats, joints, _, velocity = self._moving
        trunk = world.bodies[0]
        kept["joint_positions"][now] = joints
        kept["targets"][now] = targets
        kept["position"][now] = positions[trunk]
        kept["quat"][now] = quats[trunk]
        kept["velocity"][now] = velocity
        kept["foot_positions"][now] = world.foot_positions
        kept["foot_forces"][now] = world.foot_forces()
        if (command := self._task.command) is not None:
            kept["command"][now] = command
        self._count = now + 1
        if self._count == STRETCH:
            self._show()

    def values(self, end: TrialEnd) -> tuple[tuple[str, float], ...]:
        """Return the scores that are defined, by name."""
        if self._count:
            self._show()
        found = {name: score.value(end) for name, score in self._scores.items()}
        return tuple(
            (name, float(value))
            for name, value in found.items()
            if value is not None and math.isfinite(value)
        )

    def state(self) -> bytes:
        """Return what is not shown yet, and what the scores remember."""
        waiting = {name: array[: self._count].copy() for name, array in self._kept.items()}
        for name, score in self._scores.items():
            waiting |= {f"{name}/{key}": array for key, array in score.state().items()}
        return pack(waiting)

    def restore(self, state: bytes) -> None:
        """Go back, or on, to a `state` of a trial with the same scores."""
        arrays = unpack(state)
        self._count = len(arrays["position"])
        for name, array in self._kept.items():
            array[: self._count] = arrays[name]
        for name, score in self._scores.items():
            own = {key.partition("/"): array for key, array in arrays.items()}
            score.restore({key: array for (of, _, key), array in own.items() if of == name})

    def _show(self) -> None:
        stretch = self._stretch({name: kept[: self._count] for name, kept in self._kept.items()})
        for score in self._scores.values():
            score.update(stretch)
        self._kept["command"][:] = np.nan
        self._count = 0

    def _stretch(self, kept: Mapping[str, Array]) -> Stretch:
        w, x, y, z = kept["quat"].T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        angles = np.stack(
            [
                np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
                yaw,
            ],
            axis=1,
        )
        vx, vy, vz = kept["velocity"][:, :3].T
        cosine, sine = np.cos(yaw), np.sin(yaw)
        velocity = np.stack([cosine * vx + sine * vy, cosine * vy - sine * vx, vz], axis=1)
        return Stretch(
            torques=self._physics.motor_torques(kept["servo"], kept["joint_rates"]),
            joint_rates=kept["joint_rates"],
            joint_positions=kept["joint_positions"],
            targets=kept["targets"],
            position=kept["position"],
            roll_pitch_yaw=angles,
            velocity=velocity,
            rates=kept["velocity"][:, 3:],
            foot_positions=kept["foot_positions"],
            foot_forces=kept["foot_forces"],
            command=kept["command"],
        )
