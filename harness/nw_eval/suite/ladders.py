"""Ladders as a suite's gate names them, and what of them cannot be used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_base.errors import NwEvalError, UsageError
from nw_gate.limits.ladder import Ladder

if TYPE_CHECKING:
    from nw_eval.suite.model import Suite
    from nw_sim.ladders import Ladder as SceneLadder


def gated_ladder(family: SceneLadder) -> Ladder:
    """Return a ladder by the name that a suite's gate has for it."""
    values = tuple(rung.value for rung in family.rungs)
    return Ladder(name=family.name, rungs=values, unit=family.unit)


def ladder_faults(suite: Suite) -> list[tuple[tuple[str | int, ...], NwEvalError]]:
    """Return what of `gate.limits` cannot be used, each with its location in the suite's file."""
    from nw_gate.limits.against import Claims, LimitMargins
    from nw_gate.limits.wealth import fewest_trials
    from nw_sim.ladders import ladder_named
    from nw_sim.tasks import COURSE

    faults: list[tuple[tuple[str | int, ...], NwEvalError]] = []
    for name, asked in suite.gate.limits.items():
        at = ("gate", "limits", name)
        try:
            family = ladder_named(name, suite.base)
            if family.rungs[0].command:
                raise UsageError(
                    f"the rungs of {name} are commands; a gate judges ladders of scenes and of "
                    "perturbations",
                    fix="leave it out",
                )
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
    if suite.gate.limits and suite.task != COURSE:
        error = UsageError(
            "gate.limits judges trials of the task `course`, and the suite has another one",
            fix="remove gate.limits, or put it into a suite of courses",
        )
        faults.append((("gate", "limits"), error))
    return faults
