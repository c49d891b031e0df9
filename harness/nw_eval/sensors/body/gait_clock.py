"""The clock that paces the feet, as policies see it that were trained to one.

With `frequency` f, `stance` d and the gait's phase, offset and bound in `offsets`, it is
`clock_inputs` of walk-these-ways (Margolis and Agrawal 2022, `_step_contact_targets`); with one
offset of 0 the sine and cosine of unitree_rl_gym, and with a cosine first and a `standing` phase of
0.5 the `phase` of MuJoCo Playground.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from nw_eval.cards.command import Command
from nw_eval.cards.model import CONTROL_RATE
from nw_eval.cards.terms import GaitClock, term_size
from nw_eval.sensors.body.command import velocity_command
from nw_eval.sensors.sensor import Moment

# Of Python, not of NumPy, whose vectorised ones differ in the last bit from processor to processor.
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "sine": lambda phase: math.sin(2.0 * math.pi * phase),
    "cosine": lambda phase: math.cos(2.0 * math.pi * phase),
    "phase": lambda phase: phase,
}


def gait_clock(term: GaitClock, command: Command) -> Callable[[Moment], list[float]]:
    """Return the function that reads a clock.

    It follows from the number of control steps alone, so a trial continued from its middle reads
    the same.

    Args:
        term: from the card.
        command: the card's, for clocks that rest while it asks for no step.
    """
    functions = [_FUNCTIONS[name] for name in term.values]
    standing = term.standing

    def read(moment: Moment) -> list[float]:
        if standing is not None and math.hypot(*velocity_command(command, moment)) < standing.below:
            if standing.phase is None:
                return [0.0] * term_size(term)
            phases = [standing.phase] * len(term.offsets)
        else:
            cycles = term.frequency * moment.step / CONTROL_RATE
            phases = [_warped((cycles + offset) % 1.0, term.stance) for offset in term.offsets]
        return [function(phase) for function in functions for phase in phases]

    return read


def _warped(phase: float, stance: float) -> float:
    """Return a phase with [0, stance) mapped to [0, 0.5) and the rest to [0.5, 1)."""
    if phase < stance:
        return phase * (0.5 / stance)
    return 0.5 + (phase - stance) * (0.5 / (1.0 - stance))
