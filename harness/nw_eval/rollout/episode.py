"""One episode: the loop from observation to physics, which can be saved and continued anywhere.

    reset -> [ observe -> policy -> delay queue -> physics -> trail -> termination ] x 50 per second

The action computed at step k is applied at step k + delay_steps of the card; before that, zeros.
A policy that acts at less than 50 Hz is asked at every `hold`-th step, and its delay counts those.
"""

from __future__ import annotations

import json
from hashlib import sha256
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_eval.cards.terms import EARLIER_OUTPUTS
from nw_eval.errors import DivergedError, TrialError
from nw_eval.policies import ActionDelay
from nw_eval.policies.policy import all_finite
from nw_eval.rollout.digest import ChainDigest
from nw_eval.rollout.fault import PolicyFailedError, policy_at_fault
from nw_eval.rollout.mcap.messages import Part, SimState
from nw_eval.sensors.sensor import Moment
from nw_eval.sim import Limits
from nw_eval.sim.termination import TerminationSnapshot
from nw_eval.sim.trail import TrailSnapshot

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_eval.cards import JointControl
    from nw_eval.policies import ActionFilter, Policy
    from nw_eval.rollout.clock import StageClock
    from nw_eval.sensors.sensor import Sensor
    from nw_eval.sim import Termination, TrailProgress, World
    from nw_eval.words import Outcome

Array = NDArray[np.float64]

HUGE = 1e6
"""A joint target, rad, or torque, N m, beyond any sense, after the card's own scale and clip.

Joints turn by less than 2 pi, and motors of such robots give some hundred N m. Training stacks clip
raw actions at 100 (legged_gym's `clip_actions`), which is some 25 rad; MuJoCo itself gives up at
1e10. A target this large is a network that ran away.
"""


class Decision(NamedTuple):
    """What the policy saw and said at one control step, and what is applied in it."""

    observation: Mapping[str, NDArray[Any]]
    action: Array  # (12,) raw output
    applied: Array  # (12,) raw action that this step applies
    targets: Array  # (12,) joint targets of this step, rad; or torques, N m
    moment: Moment | None = None  # what was observed; None where nothing was


class Episode:
    """One trial's moving parts, stepped together.

    Args:
        world: already reset to the trial's start.
        sensors: by observation name, already reset.
        policy: already reset.
        control: what actions mean.
        delay_steps: actions that are applied before a new one is.
        hold: control steps for which an action is applied.
        action_filter: that applied actions pass through, at rest; None = none.
        progress: along the trial's own waypoints.
        termination: for the same waypoints.
        clock: where the time goes.
    """

    def __init__(
        self,
        *,
        world: World,
        sensors: Mapping[str, Sensor],
        policy: Policy,
        control: JointControl,
        delay_steps: int,
        hold: int = 1,
        action_filter: ActionFilter | None = None,
        progress: TrailProgress,
        termination: Termination,
        clock: StageClock,
    ) -> None:
        self.world = world
        self.sensors = sensors
        self.policy = policy
        self.progress = progress
        self.step = 0  # control steps done
        self.states = ChainDigest()
        self.actions = ChainDigest()
        self.coverage = Coverage()
        self._control = control
        self._delay = ActionDelay(delay_steps)
        self._hold = hold
        self._filter = action_filter
        self._termination = termination
        self._clock = clock
        self._applied = np.zeros(len(world.robot.joints))
        self._output = self._applied.copy()
        self._earlier = (self._output,) * EARLIER_OUTPUTS  # Outputs before it, the newest first.

    def decide(self) -> Decision:
        """Observe, and ask the policy.

        The published evaluation shows its policy nothing before the first control step is done,
        and applies zeros in that step.

        Raises:
            PolicyFailedError: the policy raised, or its action is not twelve finite numbers, or
                huge.
            ServerError: a served policy could not be asked.
        """
        if self.step == 0 and self.world.protocol.first_step_is_blind:
            nothing = np.zeros_like(self._output)
            applied = self._delay.push(nothing)
            return Decision(
                observation={},
                action=nothing,
                applied=applied,
                targets=self._control.targets(self._filtered(applied)),
            )
        moment = Moment(
            world=self.world,
            progress=self.progress,
            step=self.step,
            applied_action=self._applied,
            last_output=self._output,
            earlier_outputs=self._earlier,
        )
        observation: dict[str, NDArray[Any]] = {}
        with self._clock("sense"):
            for name, sensor in self.sensors.items():
                if not sensor.is_image:
                    observation[name] = sensor.read(moment)
                    continue
                with self._clock("render"):
                    observation[name] = sensor.read(moment)
                if sensor.fresh and sensor.coverage is not None:
                    self.coverage.add(sensor.coverage)
        if self._is_asked:
            with self._clock("policy"):
                action = self._ask(observation)
            applied = self._delay.push(action)
        else:
            action, applied = self._output, self._applied
        return Decision(
            observation=observation,
            action=action,
            applied=applied,
            targets=self._targets(self._filtered(applied)),
            moment=moment,
        )

    def advance(self, decision: Decision) -> tuple[Outcome | None, bool]:
        """Run one control step; return how the trial ends now, and if a waypoint was credited.

        Raises:
            PolicyFailedError: the physics diverged under the policy's targets.
            TrialError: the physics failed otherwise.
        """
        with self._clock("physics"):
            try:
                self.world.step(decision.targets)
            except DivergedError as error:
                raise PolicyFailedError(str(error), kind="diverged") from error
            if self._is_asked:
                self._earlier = (self._output, *self._earlier[:-1])
            self._applied, self._output = decision.applied, decision.action
            self.step += 1
            credited = self.progress.update(self.world.trunk_position)
            outcome = self._termination.check(self.world, self.progress, self.step)
            self.states.update(self.world.data.qpos, self.world.data.qvel)
            self.actions.update(decision.applied)
        return outcome, credited

    @property
    def contact_seconds(self) -> float:
        """Simulated time so far during which head or trunk collided, s."""
        return self._termination.contact_seconds

    def end_reason(self, outcome: Outcome) -> str:
        """Say what decided an outcome: the angle, the geom, the clock."""
        if outcome == "fell":
            roll, pitch, _ = np.abs(self.world.roll_pitch_yaw)
            return "roll" if roll > Limits().tilt and roll >= pitch else "pitch"
        if outcome == "collided":
            forces = self.world.monitored_forces()
            return f"contact {max(forces, key=forces.__getitem__)}"
        reasons: dict[Outcome, str] = {
            "completed": "all waypoints",
            "timeout": "time",
            "stuck": "no progress",
            "off_course": "distance to the trail",
        }
        return reasons[outcome]

    def snapshot(self) -> Any:
        """Return everything that the rest of the trial depends on, as an `nw.SimState`.

        Taken between two control steps, before the next observation.

        Raises:
            PolicyFailedError: the policy cannot say what it remembers.
        """
        parts: dict[str, bytes] = {
            "trail": json.dumps(self.progress.snapshot()).encode(),
            "termination": json.dumps(self._termination.snapshot()).encode(),
            "delay": self._delay.state(),
            "applied": self._applied.tobytes(),
            "output": self._output.tobytes(),
            "earlier": np.stack(self._earlier).tobytes(),
            "state_digest": self.states.value,
            "action_digest": self.actions.value,
            "coverage": json.dumps(self.coverage.values).encode(),
        }
        if self._filter is not None:
            parts["filter"] = self._filter.state()
        parts |= {f"sensor.{name}": sensor.state() for name, sensor in self.sensors.items()}
        with policy_at_fault():
            memory = self.policy.state()
        return SimState(
            step=self.step,
            world=self.world.state(),
            policy=memory,
            parts=[Part(name=name, data=data) for name, data in parts.items()],
        )

    def restore(self, state: Any) -> None:
        """Go back, or on, to a `snapshot` of the same trial.

        Raises:
            TrialError: the state belongs to another robot, scene or policy, or is damaged.
        """
        parts = {part.name: part.data for part in state.parts}
        try:
            updates, index, reached, timer, times = json.loads(parts["trail"])
            self.progress.restore(TrailSnapshot(updates, index, reached, timer, tuple(times)))
            self._termination.restore(TerminationSnapshot(*json.loads(parts["termination"])))
            self._delay.restore(parts["delay"])
            self._applied = np.frombuffer(parts["applied"]).copy()
            self._output = np.frombuffer(parts["output"]).copy()
            earlier = np.frombuffer(parts["earlier"]).reshape(EARLIER_OUTPUTS, -1)
            self._earlier = tuple(output.copy() for output in earlier)
            if self._filter is not None:
                self._filter.restore(parts["filter"])
            self.states = ChainDigest(parts["state_digest"])
            self.actions = ChainDigest(parts["action_digest"])
            self.coverage = Coverage(*json.loads(parts["coverage"]))
            for name, sensor in self.sensors.items():
                sensor.restore(parts[f"sensor.{name}"])
        except (KeyError, ValueError, TypeError) as error:
            raise TrialError(
                f"the recorded state of step {state.step} does not fit this trial: {error!r}",
                fix="replay it with the policy, scene and nw-eval version that made it",
            ) from error
        with policy_at_fault():
            self.policy.restore(state.policy)
        self.world.restore(state.world)
        self.step = state.step

    def _ask(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        with policy_at_fault():
            action = self.policy.act(observation)
        if action.shape != self._applied.shape or not all_finite(action):
            raise PolicyFailedError(
                f"the policy's action is not {self._applied.size} finite numbers: {action}",
                kind="action",
                fix="check the checkpoint, and the observations' scales on its card",
            )
        return action

    @property
    def _is_asked(self) -> bool:
        """Whether the policy acts at this step, rather than hold its action."""
        return self.step % self._hold == 0

    def _filtered(self, applied: Array) -> Array:
        """Return what the card's filter makes of an applied action; once for each new one."""
        if self._filter is None:
            return applied
        return self._filter.push(applied) if self._is_asked else self._filter.output

    def _targets(self, applied: Array) -> Array:
        """Return what the motors are told, as long as there is sense in it."""
        targets = self._control.targets(applied)
        index = int(np.abs(targets).argmax())
        if not abs(targets[index]) < HUGE:
            joint = self.world.robot.joints[index]
            raise PolicyFailedError(
                f"the policy's action makes a target of {targets[index]:.3g} for joint {joint}",
                kind="action",
                fix="check the checkpoint, and `scale` and `clip` on its card",
            )
        return targets


class Coverage:
    """Smallest and mean splat coverage of the images that the policy was shown."""

    def __init__(self, count: int = 0, smallest: float = 1.0, total: float = 0.0) -> None:
        self.values = (count, smallest, total)

    def add(self, share: float) -> None:
        """Add one image's coverage, 0..1."""
        count, smallest, total = self.values
        self.values = (count + 1, min(smallest, share), total + share)

    @property
    def smallest(self) -> float | None:
        """The least covered image; None without images."""
        return self.values[1] if self.values[0] else None

    @property
    def mean(self) -> float | None:
        """None without images."""
        count, _, total = self.values
        return total / count if count else None


def observation_digest(observation: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the SHA-256 of observations: names in order, types, shapes and bytes."""
    total = sha256()
    for name in sorted(observation):
        array = np.ascontiguousarray(observation[name])
        total.update(f"{name} {array.dtype.str} {array.shape}".encode())
        total.update(array.tobytes())
    return total.digest()
