"""Ladders as a suite's gate names them, and what of them cannot be used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_base.errors import NwEvalError, UsageError
from nw_gate.limits.ladder import Ladder

if TYPE_CHECKING:
    from nw_eval.suite.model import EpisodeRules, Suite
    from nw_sim.ladders import Ladder as SceneLadder
    from nw_sim.tasks import TaskFault


def gated_ladder(family: SceneLadder) -> Ladder:
    """Return a ladder by the name that a suite's gate has for it."""
    values = tuple(rung.value for rung in family.rungs)
    return Ladder(name=family.name, rungs=values, unit=family.unit)


COMMANDED_DURATION = 8.0
"""Seconds of a trial with a velocity command: the fastest rung ends 13 m from the start."""


def climbed_episode(episode: EpisodeRules, *, is_commanded: bool) -> EpisodeRules:
    """Return the rules of trials on a ladder of a suite's gate: those of the suite.

    Args:
        episode: of the suite.
        is_commanded: whether rungs are velocity commands, whose trials are shorter.
    """
    if not is_commanded:
        return episode
    return episode.model_copy(update={"duration": min(episode.duration, COMMANDED_DURATION)})


def ladder_faults(
    suite: Suite, hears: frozenset[str] | None
) -> list[tuple[tuple[str | int, ...], NwEvalError]]:
    """Return what of `gate.limits` cannot be used, each with its location in the suite's file.

    Args:
        suite: whose gate it is.
        hears: what its policy can be told, as `Task.fault` has it; None if no policy can be read.
    """
    from nw_gate.limits.against import Claims, LimitMargins
    from nw_gate.limits.wealth import fewest_trials
    from nw_sim.ladders import ladder_named
    from nw_sim.tasks import COURSE

    faults: list[tuple[tuple[str | int, ...], NwEvalError]] = []
    for name, asked in suite.gate.limits.items():
        at = ("gate", "limits", name)
        try:
            family = ladder_named(name, suite.base)
            if suite.task != COURSE and not family.is_commanded:
                raise UsageError(
                    f"the trials of {name} have the task `course`, and the suite has another one",
                    fix="leave it out, or put it into a suite of courses",
                )
            if hears is not None and (unheard := _unheard(family, hears)) is not None:
                raise UsageError(f"{name}: {unheard.message}", fix=unheard.fix)
            least = fewest_trials(asked.share, suite.gate.confidence)
            if asked.trials < least:
                raise UsageError(
                    f"{asked.trials} trials cannot decide a limit on {name}: a PASS needs {least} "
                    f"at least, where {100.0 * asked.share:g} % of the trials of a rung are asked",
                    fix="raise `trials`",
                )
            if asked.at_least is not None:
                Claims.of(gated_ladder(family), LimitMargins(at_least=asked.at_least), None)
        except NwEvalError as error:
            faults.append((at, error))
    return faults


def _unheard(family: SceneLadder, hears: frozenset[str]) -> TaskFault | None:
    """Return why a policy cannot be told the commands of a ladder; None for one of other rungs."""
    from nw_sim.axes import COMMANDED
    from nw_sim.tasks import TaskRules, fault_of
    from nw_sim.tasks.commanded import Asked, Command
    from nw_sim.tasks.velocity import VelocitySettings

    if not family.is_commanded:
        return None
    parts = {COMMANDED[axis]: value for axis, value in family.rungs[-1].perturbation}
    settings = VelocitySettings(command=Command(constant=Asked.model_validate(parts)))
    return fault_of(settings, hears=hears, rules=TaskRules())
