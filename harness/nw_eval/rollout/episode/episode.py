"""One episode: the loop from observation to physics, which can be saved and continued anywhere.

    reset -> [ observe -> policy -> delay queue -> physics -> trail -> termination ] x 50 per second

A policy that acts at less than 50 Hz is asked at every `hold`-th step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nw_eval.arrays import read_only
from nw_eval.errors import DivergedError, TrialError
from nw_eval.policies.policy import all_finite
from nw_eval.rollout.episode.actions import Actions
from nw_eval.rollout.episode.captured import CapturedViews
from nw_eval.rollout.episode.coverage import ImageCoverage
from nw_eval.rollout.episode.digest import ChainDigest
from nw_eval.rollout.episode.observer import Decision, Observer, Step
from nw_eval.rollout.fault import PolicyFailedError, policy_at_fault
from nw_eval.rollout.mcap.content.sim_state import Saved
from nw_eval.rollout.mcap.messages import SimState, StatePart
from nw_eval.sensors.sensor import Moment
from nw_eval.sim import Limits

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from nw_eval.cards import JointControl
    from nw_eval.memory import Memory
    from nw_eval.policies import ActionFilter, Policy
    from nw_eval.rollout.clock import StageClock
    from nw_eval.rollout.episode.pushes import Pushes
    from nw_eval.sensors.sensor import Sensor
    from nw_eval.sim import Termination, TrailProgress, World
    from nw_eval.words import Outcome

Array = NDArray[np.float64]


class Episode:
    """One trial's moving parts, stepped together. A `Memory` of all of them.

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
        pushes: that the trunk gets; None = none.
        cones: (K, 3) waypoints that have a cone, m; None = all.
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
        pushes: Pushes | None = None,
        cones: Array | None = None,
    ) -> None:
        self.world = world
        self.sensors = sensors
        self.policy = policy
        self.progress = progress
        self.step = 0  # control steps done
        self.state_digest = ChainDigest()
        self.action_digest = ChainDigest()
        self.coverage = ImageCoverage()
        self.captured = CapturedViews()
        self._hold = hold
        self._termination = termination
        self._clock = clock
        self._pushes = pushes
        self._cones = None if cones is None else read_only(cones)
        self._actions = actions = Actions(
            control, world.robot.joints, delay_steps=delay_steps, action_filter=action_filter
        )
        # By the names that they have in logs; world and policy have fields of their own there.
        self._parts: dict[str, Memory[bytes]] = {
            "trail": progress,
            "termination": termination,
            "delay": actions.delay,
            "applied": actions.applied,
            "output": actions.output,
            "earlier": actions.earlier,
            "state_digest": self.state_digest,
            "action_digest": self.action_digest,
            "coverage": self.coverage,
        }
        if world.scene.captures is not None:
            self._parts["captured"] = self.captured
        if action_filter is not None:
            self._parts["filter"] = action_filter
        self._parts |= {f"sensor.{name}": sensor for name, sensor in sensors.items()}

    def run(self, *observers: Observer) -> Outcome:
        """Run the trial from where it stands to its end, and return how it ended.

        Raises:
            PolicyFailedError, ServerError, TrialError: as `decide` and `advance`.
        """
        for step in self.steps(*observers):
            if step.outcome is not None:
                return step.outcome
        raise AssertionError("steps go on until there is an outcome")

    def steps(self, *observers: Observer) -> Iterator[Step]:
        """Make control steps until one ends the trial, and yield each.

        Whoever takes them may stop before; the next call goes on from there.

        Raises:
            PolicyFailedError, ServerError, TrialError: as `decide` and `advance`.
        """
        outcome = None
        while outcome is None:
            for observer in observers:
                observer.before()
            decision = self.decide()
            for observer in observers:
                observer.decided(decision)
            step = self.advance(decision)
            for observer in observers:
                observer.advanced(step)
            yield step
            outcome = step.outcome

    def decide(self) -> Decision:
        """Make the first half of a control step: observe, and ask the policy.

        The published evaluation shows its policy nothing before the first control step is done,
        and applies zeros in that step.

        Raises:
            PolicyFailedError: the policy raised, or its action is not twelve finite numbers, or
                huge.
            ServerError: a served policy could not be asked.
        """
        moment: Moment | None = None
        observation: Mapping[str, NDArray[Any]] = {}
        if self.step > 0 or not self.world.protocol.first_step_is_blind:
            with self._clock("sense"):
                moment = self._moment()
                observation = self._sense(moment)
        with self._clock("policy"):
            if self.step % self._hold == 0:
                self._actions.take(self._no_action() if moment is None else self._ask(observation))
            targets = self._actions.targets()
        return Decision(
            observation=observation,
            action=self._actions.output.array,
            applied=self._actions.applied.array,
            targets=targets,
            moment=moment,
        )

    def advance(self, decision: Decision) -> Step:
        """Make the other half: the physics, the trail, and whether the trial ends.

        Raises:
            PolicyFailedError: the physics diverged under the policy's targets.
            TrialError: the physics failed otherwise.
        """
        with self._clock("physics"):
            try:
                push = None if self._pushes is None else self._pushes.at(self.step)
                if push is not None:
                    self.world.push(push)
                self.world.step(decision.targets)
            except DivergedError as error:
                raise PolicyFailedError(str(error), kind="diverged") from error
            self.step += 1
            credited = self.progress.update(self.world.trunk_position)
            outcome = self._termination.check(self.world, self.progress, self.step)
            self.state_digest.update(self.world.data.qpos, self.world.data.qvel)
            self.action_digest.update(decision.applied)
        return Step(decision, outcome, credited)

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

    def state(self) -> Any:
        """Return everything that the rest of the trial depends on, as an `nw.SimState`.

        Taken between two control steps, before the next observation.

        Raises:
            PolicyFailedError: the policy cannot say what it remembers.
        """
        saved = self.saved()
        parts = [StatePart(name=name, data=data) for name, data in saved.parts.items()]
        return SimState(step=saved.step, world=saved.world, policy=saved.policy, parts=parts)

    def saved(self) -> Saved:
        """Return the content of `state`, for which no message is made; raises as that."""
        parts = {name: part.state() for name, part in self._parts.items()}
        with policy_at_fault():
            policy = self.policy.state()
        return Saved(self.step, self.world.state(), policy, parts)

    def restore(self, state: Any) -> None:
        """Go back, or on, to a `state` of the same trial.

        Raises:
            TrialError: the state belongs to another robot, scene or policy, or is damaged.
        """
        recorded = {part.name: part.data for part in state.parts}
        try:
            for name, part in self._parts.items():
                part.restore(recorded[name])
        except (KeyError, ValueError, TypeError) as error:
            raise TrialError(
                f"the recorded state of step {state.step} does not fit this trial: {error!r}",
                fix="replay it with the policy, scene and nw-eval version that made it",
            ) from error
        with policy_at_fault():
            self.policy.restore(state.policy)
        self.world.restore(state.world)
        self.step = state.step

    def _no_action(self) -> Array:
        return np.zeros_like(self._actions.output.array)

    def _moment(self) -> Moment:
        return Moment(
            world=self.world,
            progress=self.progress,
            step=self.step,
            applied_action=self._actions.applied.array,
            last_output=self._actions.output.array,
            earlier_outputs=self._actions.earlier.arrays,
            standing_cones=self._cones,
        )

    def _sense(self, moment: Moment) -> dict[str, NDArray[Any]]:
        """Return what every sensor shows the policy now."""
        observation: dict[str, NDArray[Any]] = {}
        for name, sensor in self.sensors.items():
            if not sensor.is_image:
                observation[name] = sensor.read(moment)
                continue
            with self._clock("render"):
                observation[name] = sensor.read(moment)
            if sensor.fresh and sensor.coverage is not None:
                self.coverage.add(sensor.coverage)
            if sensor.nearness is not None and sensor.coverage is not None:
                self.captured.add(self.step, sensor.nearness, sensor.coverage)
        return observation

    def _ask(self, observation: Mapping[str, NDArray[Any]]) -> Array:
        """Return the policy's action for an observation."""
        with policy_at_fault():
            action = self.policy.act(observation)
        count = len(self.world.robot.joints)
        if action.shape != (count,) or not all_finite(action):
            raise PolicyFailedError(
                f"the policy's action is not {count} finite numbers: {action}",
                kind="action",
                fix="check the checkpoint, and the observations' scales on its card",
            )
        return action
