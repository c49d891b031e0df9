"""One episode: the loop from observation to physics, which can be saved and continued anywhere.

    reset -> [ observe -> policy -> delay queue -> physics -> task ] x 50 per second

A policy whose rate divides 50 Hz is asked at every `hold`-th step; of any other, each control step
is one action long.

Here is also what an episode shows to those who look on: an `Observer` sees each `Decision` and
`Step`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nw_base.errors import DivergedError, TrialError
from nw_base.memory import read_only
from nw_base.words import Outcome
from nw_gate.results.row import VIEW_RATE
from nw_gate.scores import TrialEnd
from nw_policies import ActionDelay
from nw_policies.cards.model import CONTROL_RATE
from nw_policies.cards.terms import EARLIER_OUTPUTS
from nw_policies.policy_process import all_finite
from nw_scenes.scene import Nearness
from nw_sim.rollout.fault import PolicyFailedError, extension_at_fault, policy_at_fault
from nw_sim.rollout.mcap.messages import Saved, SimState, StatePart
from nw_sim.sensors.sensor import StepContext

if TYPE_CHECKING:
    from collections.abc import Iterator

    from nw_base.memory import Memory
    from nw_policies import ActionFilter, Policy
    from nw_policies.cards import JointControl
    from nw_sim.physics import World
    from nw_sim.rollout.job import StageClock
    from nw_sim.rollout.perturbed import Pushes
    from nw_sim.rollout.scored import ScoreMeter
    from nw_sim.sensors.sensor import Sensor
    from nw_sim.tasks import Task, TaskEvent

Array = NDArray[np.float64]
HUGE = 1e6
"""A joint target, rad, or torque, N m, beyond any sense, after the card's own scale and clip.

Joints turn by less than 2 pi, and motors of such robots give some hundred N m. Training stacks clip
raw actions at 100 (legged_gym's `clip_actions`), which is some 25 rad; MuJoCo itself gives up at
1e10. A target this large is a network that ran away.
"""
_SENSOR = "sensor."


class Decision(NamedTuple):
    """What the policy saw and answered at one control step, and what is applied in it."""

    observation: Mapping[str, NDArray[Any]]
    action: Array  # (12,) raw output
    applied: Array  # (12,) raw action that this step applies
    targets: Array  # (12,) joint targets of this step, rad; or torques, N m
    moment: StepContext | None = None  # what was observed; None where nothing was


class Step(NamedTuple):
    """One control step that was made."""

    decision: Decision
    outcome: Outcome | None  # how the trial ends with it; None if it goes on
    events: tuple[TaskEvent, ...] = ()  # what it brought to the task


class Observer:
    """Looks on as an episode runs, at three places of each control step, and changes nothing.

    Its own methods look away: a subclass has those that it wants.
    """

    def before(self) -> None:
        """A control step begins: the episode can be saved."""

    def decided(self, decision: Decision) -> None:
        """The policy has decided, and nothing has moved yet."""

    def advanced(self, step: Step) -> None:
        """The world has moved, and the task has seen it."""


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
        task: already reset for the trial.
        clock: where the time goes.
        pushes: that the trunk gets; None = none.
        cones: (K, 3) waypoints that have a cone, m; None = all.
        scores: of the trial, that look on; None = none.
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
        task: Task,
        clock: StageClock,
        pushes: Pushes | None = None,
        cones: Array | None = None,
        scores: ScoreMeter | None = None,
    ) -> None:
        self.world = world
        self.sensors = sensors
        self.policy = policy
        self.task = task
        self.step = 0  # control steps done
        self.state_digest = ChainDigest()
        self.action_digest = ChainDigest()
        self.coverage = _ImageCoverage()
        self.captured = CapturedViews(world.control_rate)
        self._hold = hold
        self._control = control
        self._clock = clock
        self._pushes = pushes
        self._scores = scores
        self._cones = None if cones is None else read_only(cones)
        self._actions = actions = Actions(
            control, world.robot.joints, delay_steps=delay_steps, action_filter=action_filter
        )
        # By the names that they have in logs; world and policy have fields of their own there, and
        # the task's parts come first.
        self._parts: dict[str, Memory[bytes]] = {
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
        if scores is not None:
            self._parts["scores"] = scores
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
        moment: StepContext | None = None
        observation: Mapping[str, NDArray[Any]] = {}
        if self.step > 0 or not self.world.protocol.first_step_is_blind:
            with self._clock("sense"):
                moment = self._moment()
                observation = self._sense(moment)
        with self._clock("policy"):
            if self.step % self._hold == 0:
                self._actions.take(self._no_action() if moment is None else self._ask(observation))
            targets = self._actions.targets()
            if (offsets := self.task.joint_offsets) is not None:
                targets = targets + offsets
        return Decision(
            observation=observation,
            action=self._actions.output.array,
            applied=self._actions.applied.array,
            targets=targets,
            moment=moment,
        )

    def advance(self, decision: Decision) -> Step:
        """Make the other half: the physics, the task, and whether the trial ends.

        Raises:
            PolicyFailedError: the physics diverged under the policy's targets.
            TrialError: the physics failed otherwise.
        """
        with self._clock("physics"):
            try:
                push = None if self._pushes is None else self._pushes.at(self.step)
                if push is not None:
                    self.world.push(push)
                if (force := self.task.force) is not None:
                    self.world.pull(force)
                self.world.step(decision.targets)
            except DivergedError as error:
                raise PolicyFailedError(str(error), kind="diverged") from error
            self.step += 1
            with extension_at_fault():
                events = self.task.update(self.world)
                outcome = self.task.end()
            self.state_digest.update(*self.world.coordinates())
            self.action_digest.update(decision.applied)
            if self._scores is not None:
                with extension_at_fault():
                    self._scores.take(decision.targets)
        return Step(decision, outcome, events)

    def scores(self, outcome: Outcome | None) -> tuple[tuple[str, float], ...]:
        """Return the scores that are defined, by name: the task's own, and those asked for.

        Args:
            outcome: how the trial ended; None if it has no result.
        """
        end = TrialEnd(outcome=outcome, seconds=self.world.time, success=self.task.success)
        with extension_at_fault():
            own = tuple(self.task.scores().items())
            return own if self._scores is None else (*own, *self._scores.values(end))

    def scores_so_far(self) -> dict[str, float]:
        """Return scores of the trial until now, by name: see `ScoreMeter.so_far`."""
        return {} if self._scores is None else self._scores.so_far()

    def limits_passed(self) -> dict[str, float]:
        """Return when limits were first passed, s, by score; after `scores`."""
        return {} if self._scores is None else self._scores.moments()

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
        parts = self.task.state()
        parts |= {name: part.state() for name, part in self._parts.items()}
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
            self.task.restore(recorded)
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

    def _moment(self) -> StepContext:
        return StepContext(
            world=self.world,
            task=self.task,
            step=self.step,
            applied_action=self._actions.applied.array,
            last_output=self._actions.output.array,
            earlier_outputs=self._actions.earlier.arrays,
            standing_cones=self._cones,
        )

    def _sense(self, moment: StepContext) -> dict[str, NDArray[Any]]:
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
        count = len(self._control.driven)
        if action.shape != (count,) or not all_finite(action):
            raise PolicyFailedError(
                f"the policy's action is not {count} finite numbers: {action}",
                kind="action",
                fix="check the checkpoint, and the observations' scales on its card",
            )
        return self._control.whole(action)


class Actions:
    """The actions of one trial, between its policy and its motors.

    Each is applied `delay_steps` actions after it was taken; before the first, zeros are. What is
    applied stays so until the next action is taken.

    Args:
        control: what actions mean.
        joints: names of the robot's, in its own order.
        delay_steps: actions that are applied before a new one is.
        action_filter: that applied actions pass through, at rest; None = none.

    Attributes:
        delay: the actions that wait.
        applied: the raw action that is applied, (12,).
        output: what the policy returned last, (12,).
        earlier: what it returned before that, (12,) each of `EARLIER_OUTPUTS`, the newest first.
        filter: what they pass through.
    """

    def __init__(
        self,
        control: JointControl,
        joints: tuple[str, ...],
        *,
        delay_steps: int,
        action_filter: ActionFilter | None,
    ) -> None:
        count = len(joints)
        self.delay = ActionDelay(delay_steps, count)
        self.applied = Latched(np.zeros(count))
        self.output = Latched(np.zeros(count))
        self.earlier = _HeldRow([np.zeros(count)] * EARLIER_OUTPUTS)
        self.filter = action_filter
        self._control = control
        self._joints = joints

    def take(self, action: Array) -> None:
        """Take a new action of the policy, (12,) raw."""
        self.earlier.arrays = (self.output.array, *self.earlier.arrays[:-1])
        # A policy may write into what it has returned, and a sensor into what it is shown.
        self.output.array = read_only(action.copy())
        self.applied.array = read_only(self.delay.push(action))
        if self.filter is not None:
            self.filter.push(self.applied.array)

    def targets(self) -> Array:
        """Return what the motors are told, (12,) rad or N m, as long as there is sense in it.

        Raises:
            PolicyFailedError: a target is huge.
        """
        applied = self.applied.array if self.filter is None else self.filter.output
        targets = self._control.targets(applied)
        # No square is larger than the sum of all, which one call gives.
        if not targets.dot(targets) < HUGE * HUGE and (index := _first_huge(targets)) is not None:
            raise PolicyFailedError(
                f"the policy's action makes a target of {targets[index]:.3g} for joint "
                f"{self._joints[index]}",
                kind="action",
                fix="check the checkpoint, and `scale` and `clip` on its card",
            )
        return targets


class Latched:
    """An array of float64 that is replaced as a whole, never written into."""

    def __init__(self, array: Array) -> None:
        self.array = read_only(array)

    def state(self) -> bytes:
        """Return its numbers."""
        return self.array.tobytes()

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of an array of the same shape."""
        self.array = np.frombuffer(state).reshape(self.array.shape)  # bytes: read-only, too


class _HeldRow:
    """Several arrays of float64 of one shape, as above."""

    def __init__(self, arrays: Sequence[Array]) -> None:
        self.arrays = tuple(map(read_only, arrays))

    def state(self) -> bytes:
        """Return their numbers."""
        return b"".join(map(np.ndarray.tobytes, self.arrays))

    def restore(self, state: bytes) -> None:
        """Go back to a `state` of as many arrays of the same shape."""
        rows = np.frombuffer(state).reshape(len(self.arrays), *self.arrays[0].shape)
        self.arrays = tuple(rows)


def _first_huge(targets: Array) -> int | None:
    """Return which target is the largest, if there is no sense in it."""
    index = int(np.abs(targets).argmax())
    return None if abs(targets[index]) < HUGE else index


class CapturedViews:
    """The worst camera image of the splat in each tenth of a second, of all that were up to date.

    An image is up to date from when it is taken until the next one of its camera: a slow camera's
    counts in each tenth that it lasts.

    Args:
        control_rate: control steps per second, Hz.

    Attributes:
        distance: m from the nearest capture camera, the largest of each tenth.
        angle: between the optical axes of both, rad, as above.
        alpha: share of the image that the splat covers, 0 to 1, the smallest of each tenth.
    """

    def __init__(self, control_rate: float = CONTROL_RATE) -> None:
        self._share = VIEW_RATE / control_rate
        self.distance: list[float] = []
        self.angle: list[float] = []
        self.alpha: list[float] = []

    def add(self, step: int, nearness: Nearness, alpha: float) -> None:
        """Add one camera's newest image at a control step; steps only go on."""
        tenth = int(step * self._share + 1e-6)
        while len(self.alpha) <= tenth:
            self.distance.append(0.0)
            self.angle.append(0.0)
            self.alpha.append(1.0)
        self.distance[tenth] = max(self.distance[tenth], nearness.distance)
        self.angle[tenth] = max(self.angle[tenth], nearness.angle)
        self.alpha[tenth] = min(self.alpha[tenth], alpha)

    def state(self) -> bytes:
        """Return all three, in single precision, as a row has them."""
        return np.array([self.distance, self.angle, self.alpha], dtype="<f4").tobytes()

    def restore(self, state: bytes) -> None:
        """Go back, or on, to a `state`."""
        numbers: NDArray[np.float32] = np.frombuffer(state, dtype="<f4").reshape(3, -1)
        self.distance, self.angle, self.alpha = (line.tolist() for line in numbers)


class _ImageCoverage:
    """Smallest and mean splat coverage of the images that the policy was shown."""

    def __init__(self) -> None:
        self._count, self._smallest, self._total = 0, 1.0, 0.0

    def add(self, share: float) -> None:
        """Add one image's coverage, 0..1."""
        self._count += 1
        self._smallest = min(self._smallest, share)
        self._total += share

    @property
    def smallest(self) -> float | None:
        """The least covered image; None without images."""
        return self._smallest if self._count else None

    @property
    def mean(self) -> float | None:
        """None without images."""
        return self._total / self._count if self._count else None

    def state(self) -> bytes:
        """Return count, smallest and sum."""
        numbers = [self._count, self._smallest, self._total]
        return repr(numbers).encode()  # the JSON of finite numbers, as in `tasks.course`

    def restore(self, state: bytes) -> None:
        """Go back to a `state`."""
        self._count, self._smallest, self._total = json.loads(state)


class ChainDigest:
    """SHA-256 of (previous digest, new bytes), over and over.

    hashlib cannot save a hash half way; a chain of 32-byte values can, so a trial that is restored
    from a state in its middle ends with the same digest as the one that ran through.
    """

    def __init__(self) -> None:
        self._value = bytes(32)

    def update(self, *arrays: np.ndarray) -> None:
        """Append arrays; each is hashed as little-endian float64."""
        parts = [array.astype("<f8", copy=False).tobytes() for array in arrays]
        self._value = sha256(b"".join((self._value, *parts))).digest()

    @property
    def hex(self) -> str:
        """The digest so far, 64 hexadecimal digits."""
        return self._value.hex()

    def state(self) -> bytes:
        """Return the digest so far, 32 bytes."""
        return self._value

    def restore(self, state: bytes) -> None:
        """Go on from a `state`."""
        self._value = state


def carry_over(before: Episode, after: Episode) -> bool:
    """Let an episode go on from where another one of the same robot and policy stands.

    Args:
        before: between two control steps.
        after: in another cell of the perturbations, or another place; at its first control step.

    Returns:
        Whether its sensors go on too. They begin anew where a perturbation makes them remember more
        or less, as a latency does.

    Raises:
        TrialError: the state is of another policy.
    """
    own, theirs = after.saved().parts, before.saved().parts
    parts = {name: theirs.get(name, data) for name, data in own.items()}
    goes_on = True
    try:
        _restore(before, after, parts)
    except TrialError:
        goes_on = False
        fresh = {name: data for name, data in own.items() if name.startswith(_SENSOR)}
        _restore(before, after, parts | fresh)
    after.world.adopt(before.world)
    return goes_on


def _restore(before: Episode, after: Episode, parts: Mapping[str, bytes]) -> None:
    states = [StatePart(name=name, data=data) for name, data in parts.items()]
    world, policy = after.world.state(), before.saved().policy
    after.restore(SimState(step=before.step, world=world, policy=policy, parts=states))
