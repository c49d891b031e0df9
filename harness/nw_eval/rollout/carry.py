"""Goes on with a trial in another cell or place: the robot stands where it stood."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.errors import TrialError
from nw_eval.rollout.mcap.messages import SimState, StatePart

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nw_eval.rollout.episode import Episode

_SENSOR = "sensor."


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
    found = [StatePart(name=name, data=data) for name, data in parts.items()]
    world, policy = after.world.state(), before.saved().policy
    after.restore(SimState(step=before.step, world=world, policy=policy, parts=found))
