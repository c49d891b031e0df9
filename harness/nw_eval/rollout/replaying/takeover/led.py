"""A trial that goes its recorded way again, while the policy that is to take over looks on.

The robot is moved by what the log says was applied, with the motors of the card that the log holds,
so the first policy's checkpoint is not needed. At every control step the second policy's sensors
measure, and it is asked; what was executed counts as its own action, as far as its card has words
for it. So at any step it knows what it would know had it seen the trial from the start and answered
just that.
"""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

from nw_eval.errors import StoreError
from nw_eval.rollout.mcap.messages import SimState, StatePart
from nw_eval.rollout.replaying.takeover.decided import decisions, recorded_digests
from nw_eval.rollout.replaying.takeover.handover import first_card
from nw_eval.rollout.replaying.takeover.onlooker import Onlooker
from nw_eval.rollout.replaying.takeover.puppet import open_puppet
from nw_eval.rollout.replaying.takeover.units import translator

if TYPE_CHECKING:
    from collections.abc import Generator

    from nw_eval.rollout.episode import Decision, Episode, Observer
    from nw_eval.rollout.library import Library
    from nw_eval.rollout.prepare import OpenTrial
    from nw_eval.rollout.replaying.logged import LoggedTrial

_OF_THE_TRIAL = ("trail", "termination", "state_digest", "action_digest")
"""Parts of a state that are the trial's; all others are the policy's, its sensors among them."""
_HEAD = 12
"""Bytes of a world's state that name the model: magic and fingerprint, see `sim.state`."""


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
    card, robot = first_card(logged), trial.robot
    in_its_words = translator(card, trial.bundle.card, robot)
    recorded = recorded_digests(logged.log)
    follower = trial.episode
    onlooker = Onlooker(follower.policy)
    with open_puppet(logged.job, card, library) as puppet:
        leader = puppet.episode
        state = _join(follower, leader)
        for decided in decisions(logged.log, joints=len(robot.joints)):
            _check_way(leader, recorded, logged)
            yield state
            for observer in observers:
                observer.before()
            onlooker.executed = None if in_its_words is None else in_its_words(decided.action)
            decision = _look_on(follower, onlooker, decided)
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
        f"{logged.path} does not say what was applied until control step {step}",
        fix="give an earlier time, or run the trial again",
    )


def _look_on(episode: Episode, onlooker: Onlooker, decided: Decision) -> Decision:
    """Let a policy see a control step in which another one acts; return what is executed."""
    policy, episode.policy = episode.policy, onlooker
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
    parts |= {part.name: part.data for part in there.parts if part.name in _OF_THE_TRIAL}
    state = SimState(
        step=there.step,
        world=own.world[:_HEAD] + there.world[_HEAD:],
        policy=own.policy,
        parts=[StatePart(name=name, data=data) for name, data in parts.items()],
    )
    follower.restore(state)
    return state


def _check_way(leader: Episode, recorded: dict[int, bytes], logged: LoggedTrial) -> None:
    known = recorded.get(leader.step)
    if known is not None and known != leader.state_digest.state():
        raise StoreError(
            f"{logged.path}: the trial does not go its recorded way here, its state at "
            f"{leader.world.time:.2f} s is another",
            fix="take over where it was recorded; `nw-eval replay` says which versions differ",
        )
