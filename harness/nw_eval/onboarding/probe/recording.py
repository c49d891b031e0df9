"""Some seconds of a policy in a scene, and who writes them down."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.inputs import InputSpec
from nw_eval.policies.apart import ApartPolicy
from nw_eval.policies.drawing import DrawingPolicy
from nw_eval.policies.feeding.fed_policy import FedPolicy
from nw_eval.rollout.episode import Episode, Observer, Step
from nw_eval.sim import World
from nw_eval.words import Outcome

Array = NDArray[np.float64]

STUMBLES = 0.3
"""Roll or pitch that a policy on flat ground does not reach under its own card, rad. Measured on
three policies: 0.07 to 0.14 with the right card, 0.28 to 1.3 with any other order of joints."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What happened, by control step: T steps, joints in the robot's order."""

    observations: dict[str, NDArray[Any]]
    """(T, ...) by name."""
    actions: Array
    """(T, 12) raw, in the policy's order."""
    targets: Array
    """(T, 12) what the motors were told, rad or N m."""
    positions: Array
    """(T + 1, 12) rad, before the first step and after each."""
    torques: Array
    """(T, 12) N m."""
    torque_limits: Array
    """(12,) N m."""
    tilt: Array
    """(T,) larger one of roll and pitch, rad."""
    velocity: Array
    """(T, 3) vx, vy in the yaw frame, m/s, and yaw rate, rad/s: what a command is about."""
    period: float
    """Seconds of a control step."""
    travelled: float
    """Metres over ground from start to end."""
    seconds: float
    outcome: Outcome | None
    """How the trial ended before its time; None if it did not."""
    inputs: tuple[InputSpec, ...]
    """What the checkpoint declares to take; empty where its format does not say."""
    sees_images: bool
    """Whether images were rendered for the policy, which takes far longer than all else."""
    fed: dict[str, NDArray[Any]] = field(default_factory=dict[str, NDArray[Any]])
    """(T, ...) what the networks gave that feed the policy, by name."""
    fed_inputs: dict[str, tuple[InputSpec, ...]] = field(
        default_factory=dict[str, tuple[InputSpec, ...]]
    )
    """What the file of each network declares to take."""

    @property
    def stumbles(self) -> bool:
        """Whether it falls, bumps or leans as no policy does under its own card on flat ground."""
        return self.outcome is not None or float(self.tilt.max()) > STUMBLES


class Collector(Observer):
    """Looks on as an episode runs, and collects its steps.

    Args:
        episode: stands at its start.
    """

    def __init__(self, episode: Episode) -> None:
        self.tilt = 0.0
        """Larger one of roll and pitch now, rad."""
        self._episode = episode
        policy = episode.policy
        self._fed = policy if isinstance(policy, FedPolicy | ApartPolicy | DrawingPolicy) else None
        self._start = episode.world.trunk_position
        self._first = episode.world.joint_positions
        self._rows: list[tuple[Array, Array, Array, Array, float, Array]] = []
        self._outcome: Outcome | None = None
        self._seen: dict[str, list[NDArray[Any]]] = {name: [] for name in episode.sensors}
        self._gave: dict[str, list[NDArray[Any]]] = {}

    def advanced(self, step: Step) -> None:
        """Collect a control step."""
        decision, world = step.decision, self._episode.world
        self._outcome = step.outcome
        self.tilt = float(np.abs(world.roll_pitch_yaw[:2]).max())
        body = (world.joint_positions, world.torques, self.tilt, _velocity(world))
        self._rows.append((decision.action, decision.targets, *body))
        for name, value in decision.observation.items():
            self._seen[name].append(np.array(value))
        for name, value in self._fed.held.items() if self._fed else ():
            self._gave.setdefault(name, []).append(value)

    def recording(self) -> Recording:
        """Return what was collected; at least one step."""
        episode, world = self._episode, self._episode.world
        actions, targets, positions, torques, tilts, velocities = zip(*self._rows, strict=True)
        return Recording(
            observations={name: np.stack(values) for name, values in self._seen.items()},
            fed={name: np.stack(values) for name, values in self._gave.items()},
            actions=np.stack(actions),
            targets=np.stack(targets),
            positions=np.stack([self._first, *positions]),
            torques=np.stack(torques),
            torque_limits=world.model.actuator_forcerange[:, 1].copy(),
            tilt=np.array(tilts),
            velocity=np.stack(velocities),
            period=world.control_period,
            travelled=float(np.linalg.norm((world.trunk_position - self._start)[:2])),
            seconds=world.time,
            outcome=None if self._outcome in {"timeout", "completed"} else self._outcome,
            inputs=episode.policy.inputs,
            sees_images=any(sensor.is_image for sensor in episode.sensors.values()),
            fed_inputs=self._fed.network_inputs if self._fed else {},
        )


def _velocity(world: World) -> Array:
    """Return vx, vy in the yaw frame, m/s, and the yaw rate, rad/s."""
    yaw = world.roll_pitch_yaw[2]
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y, _ = world.trunk_linear_velocity
    turning = world.trunk_rotation[2] @ world.trunk_angular_velocity
    return np.array([cos * x + sin * y, cos * y - sin * x, turning])
