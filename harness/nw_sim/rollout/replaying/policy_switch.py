"""A trial that goes its recorded way again, while the policy that is to take over looks on.

The robot is moved by what the log says was applied, with the motors of the card that the log holds,
so the first policy's checkpoint is not needed. At every control step the second policy's sensors
measure, and it is asked; what was executed counts as its own action, as far as its card has words
for it. So at any step it knows what it would know had it seen the trial from the start and answered
just that.

A log also says who drove its trial, and whether one policy took over from another: `PolicySwitch`.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from nw_base.clean import clean
from nw_base.errors import PolicyError, StoreError, TrialError, UsageError, is_interrupt
from nw_policies import Bundle
from nw_policies.bundle import NOTHING
from nw_policies.cards import JointControl, motors_follow
from nw_policies.cards.load import CARD_FILE, parse_card
from nw_policies.cards.observations import ProprioObservation
from nw_policies.cards.terms import Target, Term
from nw_sim.rollout.driven import Programs, unpacked_programs
from nw_sim.rollout.episode import Decision
from nw_sim.rollout.job import StageClock, TrialResult
from nw_sim.rollout.library import Library
from nw_sim.rollout.mcap.messages import SimState, StatePart
from nw_sim.rollout.mcap.topics import MOTION, MOTORS
from nw_sim.rollout.opening import OpenTrial, open_trial
from nw_sim.rollout.record import attachments
from nw_sim.rollout.referenced import unpacked_motion
from nw_sim.rollout.trial import ended, failed, so_far

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence
    from pathlib import Path

    from nw_base.words import Collision
    from nw_policies import Policy
    from nw_policies.cards import Card
    from nw_policies.cards.feeding import InputSpec
    from nw_policies.policy import Observation
    from nw_scenes import Scene
    from nw_scenes.rays import RayScene
    from nw_scenes.robots import RobotSpec
    from nw_sim.physics import World
    from nw_sim.rollout.episode import Episode, Observer
    from nw_sim.rollout.job import TrialJob
    from nw_sim.rollout.mcap.reader import LogReader
    from nw_sim.rollout.replaying.logged import LoggedTrial
    from nw_sim.tasks import TaskSettings
    from nw_sim.tasks.reference import Reference

_OF_THE_TRIAL = ("state_digest", "action_digest", "scores")
"""Parts of a state that are the trial's, with the task's; all others are the policy's, its sensors
among them. A score is of the whole trial, whoever acts."""
_WORLD_HEAD = 12
"""Bytes of a world's state that name the model: magic and fingerprint, see `physics.state`."""
_SWITCH_FILE = "takeover.json"
"""The attachment that says when one policy took over from another."""
_SUITE = "suite.yaml"
_POLICY_TOPIC = "/nw/policy"
_DIGEST = "state_digest"  # A part of every recorded state.
Array = NDArray[np.float64]


def lead(
    trial: OpenTrial, logged: LoggedTrial, library: Library, *observers: Observer
) -> Generator[Any]:
    """Lead a trial along its log; yield the states from which its own policy can go on.

    They are those of the control steps 0, 1, 2, ... as far as the recorded trial came, each an
    `nw.SimState` that the trial's episode stands at when it is yielded.

    Args:
        trial: of the policy that looks on, at its first control step.
        logged: the recorded trial.
        library: gives the scene.
        *observers: look on as well.

    Raises:
        StoreError: the log is damaged, or the trial does not go its recorded way here.
        TrialError: the policy that looks on fails, or a state does not fit.
    """
    card, robot = _first_card(logged), trial.robot
    if trial.episode.world.control_rate != logged.control_rate:
        raise TrialError(
            f"the policy has {trial.episode.world.control_rate:g} control steps a second, the "
            f"recorded trial {logged.control_rate:g}",
            fix="let a policy of the same `control.rate` take over",
        )
    in_its_words = translator(card, trial.bundle.card, robot)
    recorded = _recorded_digests(logged.log)
    follower = trial.episode
    shadow = _ShadowPolicy(
        follower.policy, JointControl.from_card(trial.bundle.card, robot).driven.tolist()
    )
    own = trial.job
    job = replace(logged.job, scores=own.scores, allow_code=own.allow_code)
    with _open_replayed(logged, job, _replay_policy_of(card), library) as replayed:
        leader = replayed.episode
        state = _join(follower, leader)
        for decided in decisions(logged.log, joints=len(robot.joints)):
            _check_way(leader, recorded, logged)
            yield state
            for observer in observers:
                observer.before()
            shadow.executed = None if in_its_words is None else in_its_words(decided.action)
            decision = _look_on(follower, shadow, decided)
            for observer in observers:
                observer.decided(decision)
            step = leader.advance(decision)
            state = _join(follower, leader)
            for observer in observers:
                observer.advanced(step)
            if step.outcome is not None:
                return


def lead_to(
    step: int, trial: OpenTrial, logged: LoggedTrial, library: Library, *observers: Observer
) -> None:
    """Lead a trial to a control step, from which its own policy then goes on; as `lead`.

    Raises:
        StoreError, TrialError: as `lead`; or the log does not lead that far.
    """
    with closing(lead(trial, logged, library, *observers)) as states:
        if any(state.step == step for state in states):
            return
    raise StoreError(
        f"{logged.path} does not record what was applied until control step {step}",
        fix="give an earlier time, or run the trial again",
    )


def _look_on(episode: Episode, shadow: _ShadowPolicy, decided: Decision) -> Decision:
    """Let a policy see a control step in which another one acts; return what is executed."""
    policy, episode.policy = episode.policy, shadow
    try:
        seen = episode.decide()
    finally:
        episode.policy = policy
    return decided._replace(observation=seen.observation, moment=seen.moment)


def _join(follower: Episode, leader: Episode) -> Any:
    """Put one episode where another one is, with what it remembers itself; return that state.

    Both worlds hold one robot in one scene, but each has the motors of its own card.
    """
    own, there = follower.state(), leader.state()
    parts = {part.name: part.data for part in own.parts}
    of_the_trial = (*_OF_THE_TRIAL, *leader.task.state())
    parts |= {part.name: part.data for part in there.parts if part.name in of_the_trial}
    ends = [len(s.world) - e.world.motor_bytes for s, e in ((own, follower), (there, leader))]
    state = SimState(
        step=there.step,
        world=own.world[:_WORLD_HEAD] + there.world[_WORLD_HEAD : ends[1]] + own.world[ends[0] :],
        policy=own.policy,
        parts=[StatePart(name=name, data=data) for name, data in parts.items()],
    )
    follower.restore(state)
    if follower.world.drives or leader.world.drives:
        follower.world.adopt(leader.world)
        return follower.state()
    return state


def _check_way(leader: Episode, recorded: dict[int, bytes], logged: LoggedTrial) -> None:
    known = recorded.get(leader.step)
    if known is not None and known != leader.state_digest.state():
        raise StoreError(
            f"{logged.path}: the trial does not go its recorded way here, its state at "
            f"{leader.world.time:.2f} s is another",
            fix="use the machine that recorded it; `nw-eval replay` shows which versions differ",
        )


@dataclass(frozen=True, kw_only=True)
class PolicySwitch:
    """One policy's place taken by another, in the middle of a trial."""

    step: int
    """The control step that is the second one's first."""
    policy: str
    """Which the first one was, as `driver` says it."""
    card: str
    """The text of the first one's card."""
    motors: str = ""
    """The networks of the first one's motors, as the log has them, in base 64."""


def driver(job: TrialJob) -> str:
    """Return what the policy of a job is called among others: its name, and which weights."""
    name, digest = job.policy_name or job.policy, job.checkpoint_digest
    return name if digest in {"", NOTHING} else f"{name} ({digest[:8]})"


def switch_of(logged: LoggedTrial) -> PolicySwitch | None:
    """Return when the trial of a log was taken over, and from whom; None if it was not.

    Raises:
        StoreError: the log is damaged.
    """
    text = logged.log.attachments().get(_SWITCH_FILE)
    if text is None:
        return None
    try:
        return TypeAdapter(PolicySwitch).validate_json(text)
    except ValidationError as error:
        reason = clean(error.errors()[0]["msg"], at_most=200)
        raise StoreError(
            f"{logged.path}: its attachment {_SWITCH_FILE} is damaged: {reason}",
            fix="make the log again",
        ) from None


def new_switch(recorded: LoggedTrial, step: int) -> PolicySwitch:
    """Return a policy switch from the policy that a recorded trial began with.

    Raises:
        StoreError: the log is damaged.
        UsageError: the trial was taken over before that step already: its log leads no further
            with one card.
    """
    earlier = switch_of(recorded)
    if earlier is None or earlier.step == 0:  # Then the first policy never acted.
        text = recorded.log.attachments().get(CARD_FILE, b"").decode(errors="replace")
        motors = b64encode(recorded.log.attachments().get(MOTORS, b"")).decode()
        return PolicySwitch(step=step, policy=driver(recorded.job), card=text, motors=motors)
    if step > earlier.step:
        raise UsageError(
            f"{recorded.path} was switched to another policy in control step {earlier.step} "
            "already",
            fix="give an earlier --from, or the log of the trial before",
        )
    return replace(earlier, step=step)


def _first_card(recorded: LoggedTrial) -> Card:
    """Return the card of the policy that a recorded trial began with, as its log has it.

    Raises:
        StoreError: the log holds none that can be read.
    """
    try:
        return parse_card(new_switch(recorded, 0).card, file=CARD_FILE)
    except PolicyError as error:
        raise StoreError(
            f"{recorded.path} holds no card of the policy that made it: {clean(error.message)}",
            fix="re-run the trial with `nw-eval run`",
        ) from None


def carried(
    recorded: LoggedTrial, bundle: Bundle, switch: PolicySwitch
) -> tuple[tuple[str, str], ...]:
    """Return what the log of a trial carries along that a bundle takes over.

    Raises:
        StoreError: the recorded trial's log is damaged.
    """
    suite = recorded.log.attachments().get(_SUITE, b"").decode(errors="replace")
    own = _SWITCH_FILE, TypeAdapter(PolicySwitch).dump_json(switch).decode()
    return (*attachments(bundle.card_text, suite), own)


def decisions(log: LogReader, *, joints: int) -> Iterator[Decision]:
    """Yield what was answered and applied in the control steps 0, 1, 2, ... of a log.

    Logs hold it in double precision, so a world that is told the same moves in the same bits.

    Raises:
        StoreError: the log is damaged, or a step is missing.
    """
    for count, (_, _, message) in enumerate(log.messages(_POLICY_TOPIC)):
        numbers = [np.array(each) for each in (message.action, message.applied, message.targets)]
        if message.step != count or any(
            each.shape != (joints,) or not np.isfinite(each).all() for each in numbers
        ):
            raise StoreError(
                f"{log.path} does not record what was applied in control step {count}",
                fix="run the trial again",
            )
        action, applied, targets = numbers
        yield Decision(observation={}, action=action, applied=applied, targets=targets)


def _recorded_digests(log: LogReader) -> dict[int, bytes]:
    """Return the digest of all states so far, by the control steps of which the log has a state.

    Raises:
        StoreError: the log is damaged.
    """
    return {
        state.step: part.data
        for state in log.states()
        for part in state.parts
        if part.name == _DIGEST
    }


class _ShadowPolicy:
    """Stands in a trial for a policy that looks on. A `Policy`.

    It is asked at every step at which the policy would be, so whatever that remembers is of this
    trial; but what it answers is what is executed, and becomes its own past.

    Args:
        policy: already reset.
        driven: places of the joints that it drives, in its order of all joints.
    """

    def __init__(self, policy: Policy, driven: Sequence[int]) -> None:
        self.executed: Array | None = None
        """(12,) the action of this step, in the policy's words; None = there are none for it."""
        self._policy, self._driven = policy, list(driven)

    @property
    def inputs(self) -> tuple[InputSpec, ...]:
        """What the checkpoint declares to take."""
        return self._policy.inputs

    def reset(self, seed: int) -> None:
        """Begin a trial."""
        self._policy.reset(seed)

    def act(self, observation: Observation) -> Array:
        """Let the policy see an observation, and return what is executed; else its own answer."""
        answer = self._policy.act(observation)
        return answer if self.executed is None else self.executed[self._driven]

    def state(self) -> bytes:
        """Return what the policy remembers."""
        return self._policy.state()

    def restore(self, state: bytes) -> None:
        """Let the policy go back to a `state`."""
        self._policy.restore(state)

    def close(self) -> None:
        """Close the policy."""
        self._policy.close()


def replay_bundle(logged: LoggedTrial) -> Bundle:
    """Return a policy that says nothing, with the motors of the card that a trial began with.

    Raises:
        StoreError: the log holds no card that can be read.
    """
    return _replay_policy_of(_first_card(logged))


def open_replayed(logged: LoggedTrial, library: Library) -> OpenTrial:
    """Return a recorded trial at its start, to be moved by what its log says was decided.

    Raises:
        StoreError: as `replay_bundle`.
        SceneError, UsageError, PolicyError: as `open_trial`.
    """
    return _open_replayed(logged, logged.job, replay_bundle(logged), library)


def _replay_policy_of(card: Card) -> Bundle:
    """Return a policy with the motors of a card, which sees what its task may ask for alone."""
    terms: list[Term] = [
        term
        for seen in card.observations.values()
        for term in (seen.frame_terms if isinstance(seen, ProprioObservation) else ())
        if isinstance(term, Target)
    ]
    asked = {"asked": ProprioObservation(sensor="proprio", terms=terms)} if terms else {}
    changed = {"adapter": "zero", "checkpoint": None, "observations": asked, "networks": {}}
    moved = card.model_copy(update={**changed, "inputs": None, "options": {}})
    return Bundle(card=moved, card_path=None, checkpoint=None, checkpoint_sha256=NOTHING)


def _open_replayed(
    logged: LoggedTrial, job: TrialJob, bundle: Bundle, library: Library
) -> OpenTrial:
    """Return a trial at its start whose policy is that of `_replay_policy_of`.

    Its checkpoint need not be there: `Episode.advance` takes what the log says was decided.

    Raises:
        SceneError, UsageError, PolicyError: as `open_trial`.
    """
    job = replace(
        job,
        policy=bundle.reference,
        checkpoint=None,
        checkpoint_digest=bundle.checkpoint_digest,
        operator="",
        mcap=None,
    )
    return open_trial(job, _WithReplayPolicy(library, bundle, logged), StageClock())


class _WithReplayPolicy(Library):
    """The scenes of another library, one bundle, and the motion of a log."""

    def __init__(self, library: Library, bundle: Bundle, logged: LoggedTrial) -> None:
        super().__init__()
        self._library, self._logged = library, logged
        self._bundle = bundle

    def scene(self, reference: str, collision: Collision = "terrain") -> Scene:
        return self._library.scene(reference, collision)

    def rays(self, reference: str, collision: Collision = "terrain") -> RayScene:
        return self._library.rays(reference, collision)

    def bundle(self, reference: str, checkpoint: Path | None) -> Bundle:  # noqa: ARG002 - it has one.
        return self._bundle

    def motion(
        self,
        bundle: Bundle,  # noqa: ARG002 - the log has the motion, whoever named it.
        world: World,
        card: Card,
        task: TaskSettings,  # noqa: ARG002
    ) -> Reference | None:
        if card.reference is None:
            return None
        data = self._logged.log.attachments().get(MOTION, b"")
        return unpacked_motion(data, world, card, str(self._logged.path))

    def motors(self, bundle: Bundle) -> Programs:  # noqa: ARG002 - the log has its own.
        switch = new_switch(self._logged, 0)
        return unpacked_programs(b64decode(switch.motors), str(self._logged.path))


def translator(first: Card, second: Card, robot: RobotSpec) -> Callable[[Array], Array] | None:
    """Return what makes raw actions of one policy, (12,), into those of another.

    An action becomes the one that has the same joint targets. Between policies whose actions mean
    the same it stays what it is, bit for bit.

    Args:
        first: the card of the policy that acts.
        second: the card of the one that is to understand it.
        robot: that both drive.

    Returns:
        None where there is no such action: one of them answers torques, the other one positions
        or velocities.
    """
    if motors_follow(first, robot) != motors_follow(second, robot):
        return None
    own, other = JointControl.from_card(first, robot), JointControl.from_card(second, robot)
    meanings = ((own.order, other.order), (own.base, other.base), (own.scale, other.scale))
    if all(np.array_equal(a, b) for a, b in meanings):
        return lambda action: action

    def translated(action: Array) -> Array:
        wanted = own.targets(action)[other.order] - other.base
        moves = other.scale != 0.0
        return np.divide(wanted, other.scale, out=np.zeros_like(wanted), where=moves)

    return translated


def run_on(trial: OpenTrial, *observers: Observer) -> TrialResult:
    """Run a trial from where it stands to its end; whatever a policy throws is its result."""
    try:
        outcome = trial.episode.run(*observers)
    except BaseException as error:
        if is_interrupt(error):
            raise
        return failed(so_far(trial.episode), error)  # As in a run, it is the result.
    return ended(trial, outcome)
